"""HTML page of a run in one file, with heat map, curves, example pictures and tables."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from sightline.corruptions.suites import CLEAN
from sightline.robustness.charts import (
    LINE_STYLES,
    Line,
    bar_chart,
    curve_charts,
    heat_legend,
    heat_map,
)
from sightline.robustness.examples import example_cases, list_examples
from sightline.robustness.measured import Measures
from sightline.robustness.page_frame import metric_picker, metric_section, whole_page
from sightline.robustness.record import Record
from sightline.robustness.scoring import BenchMetric
from sightline.robustness.texts import (
    NOTHING,
    TextTable,
    case_text,
    metrics_table,
    ratio_text,
    score_text,
    setting_text,
)
from sightline.structures.sample import Sensor

Measured = Sequence[tuple[BenchMetric, Measures | None]]
Compared = Sequence[tuple[BenchMetric, Sequence[Measures | None]]]

_NOTHING_TO_SHOW = "<p>There is nothing to score by this metric, or nothing is broken.</p>"

_READING = """<p class="soft reading">mPC: mean over the kinds of the mean over their severities.
RR: share of the clean performance that is left, 1 where nothing is lost; mRR its mean. CE: errors
by those of the baseline, below 1 is better; mCE its mean. Gap: lead over the best healthy sensor
alone, negative where fusion does worse than leaving the broken sensor out. Formulas and sources:
<code>docs/robustness.md</code>.</p>"""


def run_page(
    record: Record,
    measured: Measured,
    baseline: Record | None,
    healthy: Mapping[Sensor, Record],
    out: Path,
    *,
    notes: Sequence[str] = (),
) -> str:
    """Make the page of a run.

    Args:
        record: Record of the run.
        measured: All of its metrics with their measures.
        baseline: Record for comparison in the charts.
        healthy: Single-sensor methods; the charts show the best.
        out: Folder of the run, where its pictures are.
        notes: Notes on the interpretation of the scores.
    """
    lines = [Line(record.method, "ours", record)]
    if baseline is not None:
        lines.append(Line(f"{baseline.method} (baseline)", "other", baseline))
    parts = [
        f'<p class="soft">{escape(setting_text(record))}.</p>',
        *(f"<p>{escape(note)}</p>" for note in notes),
        _picker([metric for metric, _ in measured]),
    ]
    for metric, measures in measured:
        if measures is None:
            content = _NOTHING_TO_SHOW
        else:
            content = _metric_part(lines, metric, measures, healthy)
        parts.append(metric_section(metric.name, content))
    parts += [_READING, _examples(record, out)]
    parts.append(f"<h2>All metrics</h2>{plain_table(metrics_table(record, measured))}")
    return whole_page(f"Robustness of {record.method}", "\n".join(parts))


def compare_page(
    records: Sequence[Record], table: TextTable, measured: Compared, *, notes: Sequence[str] = ()
) -> str:
    """Make the page of several runs.

    Args:
        records: The runs, of the same cases and of different names.
        table: All metrics of all runs.
        measured: Every metric with the measures of all runs.
        notes: Notes on the interpretation of the scores.
    """
    lines = [
        Line(record.method, LINE_STYLES[number % len(LINE_STYLES)], record)
        for number, record in enumerate(records)
    ]
    first, *others = records
    names = ", ".join(record.method for record in others)
    parts = [
        f'<p class="soft">{escape(setting_text(first))}; and by {escape(names)}.</p>',
        *(f"<p>{escape(note)}</p>" for note in notes),
        _picker([metric for metric, _ in measured]),
    ]
    for metric, each in measured:
        scored = [measures for measures in each if measures is not None]
        content = _NOTHING_TO_SHOW
        if len(scored) == len(records):
            content = "".join(
                f"<h2>{escape(record.method)}</h2>{_tiles(record, metric, measures)}"
                f"{heat_map(record, metric, measures)}"
                for record, measures in zip(records, scored, strict=True)
            )
            content += heat_legend() + _charts(lines, metric, None)
        parts.append(metric_section(metric.name, content))
    parts += [_READING, f"<h2>All metrics</h2>{plain_table(table)}"]
    return whole_page(f"{first.method} and {names}", "\n".join(parts))


def _picker(metrics: Sequence[BenchMetric]) -> str:
    return metric_picker({metric.name: f"{metric.title}, {metric.unit}" for metric in metrics})


def _metric_part(
    lines: Sequence[Line], metric: BenchMetric, measures: Measures, healthy: Mapping[Sensor, Record]
) -> str:
    record = lines[0].record
    scores = [
        score for each in healthy.values() if (score := each.score(CLEAN, metric)) is not None
    ]
    best = (min(scores) if metric.highest is None else max(scores)) if scores else None
    return (
        f"{_tiles(record, metric, measures)}<h2>Kinds and severities</h2>"
        f"{heat_map(record, metric, measures)}{heat_legend()}{_charts(lines, metric, best)}"
    )


def _tiles(record: Record, metric: BenchMetric, measures: Measures) -> str:
    worst, gap = measures.worst, measures.gap
    tiles = [
        ("clean", score_text(measures.clean, metric), metric.unit),
        ("mPC", score_text(measures.mpc, metric), metric.unit),
        ("mRR", ratio_text(measures.mrr), "of clean is left"),
        ("mCE", ratio_text(measures.mce), _baseline_note(measures)),
        ("worst case", score_text(worst.score, metric), _case(record, worst.case)),
        (
            "smallest gap",
            NOTHING if gap is None else score_text(gap.score, metric, signed=True),
            "no healthy sensor given" if gap is None else _case(record, gap.case),
        ),
    ]
    return '<div class="tiles">' + "".join(
        f'<div class="tile">{escape(name)}<b>{escape(value)}</b><small>{escape(note)}</small></div>'
        for name, value, note in tiles
    ) + "</div>"  # fmt: skip


def _case(record: Record, name: str) -> str:
    return case_text(name, record.cases[name])


def _baseline_note(measures: Measures) -> str:
    return (
        "no baseline, or one without errors" if measures.mce is None else "of the baseline's errors"
    )


def _charts(lines: Sequence[Line], metric: BenchMetric, best_single: float | None) -> str:
    curves, bars = curve_charts(lines, metric, best_single), bar_chart(lines, metric)
    names = [(line.style, line.name) for line in lines]
    if best_single is not None and curves:
        names.append(("alone", "best healthy sensor alone, clean"))
    key = "".join(f'<span><i class="{style}"></i>{escape(name)}</span>' for style, name in names)
    unit = f"{escape(metric.title)}, {escape(metric.unit)}"
    better = "lower" if metric.highest is None else "higher"
    heading = f'<h2>{unit}; {better} is better</h2><div class="key">{key}</div>'
    return heading + curves + bars


def _examples(record: Record, out: Path) -> str:
    parts = []
    for name in example_cases(record.cases):
        pictures = "".join(
            f'<figure><img alt="{escape(example.caption)}" src="{_embedded(example.path)}">'
            f"<figcaption>{escape(example.caption)}</figcaption></figure>"
            for example in list_examples(out, name)
        )
        if pictures:
            title = escape(_case(record, name))
            parts.append(
                f'<div class="example"><b>{title}</b><div class="pictures">{pictures}</div></div>'
            )
    return "<h2>One frame, and the predictions for it</h2>" + "".join(parts) if parts else ""


def _embedded(path: Path) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(path.read_bytes()).decode()}"


def plain_table(table: TextTable) -> str:
    """Make an HTML table of text cells."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.header)
    rows = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td>{escape(text)}</td>" for text in row[1:])
        + "</tr>"
        for row in table.rows
    )
    return (
        f'<div class="scroll"><table class="plain"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )

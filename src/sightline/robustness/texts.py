"""Text tables of a run, shared by the terminal, Markdown and the page."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from sightline.corruptions.suites import CLEAN
from sightline.files.problem import markdown_text
from sightline.robustness.measured import Measures
from sightline.robustness.record import CaseInfo, Record
from sightline.robustness.scoring import BenchMetric

NOTHING: Final = "-"


@dataclass(frozen=True, kw_only=True, slots=True)
class TextTable:
    """Table of text cells; the first column names the rows."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Format the table as Markdown, under its title."""
        lines = [
            _markdown_row(self.header),
            f"|{'---|' * len(self.header)}",
            *map(_markdown_row, self.rows),
        ]
        return f"**{markdown_text(self.title)}**\n\n" + "\n".join(lines) + "\n"


def _markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(markdown_text, cells))} |"


def score_text(value: float | None, metric: BenchMetric, *, signed: bool = False) -> str:
    """Format a score, or a difference of two, without its unit."""
    if value is None:
        return NOTHING
    digits = 0 if metric.highest is None and abs(value) >= 100 else 1
    return f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"


def ratio_text(value: float | None) -> str:
    """Format RR or CE."""
    return NOTHING if value is None else f"{value:.2f}"


def case_text(name: str, case: CaseInfo) -> str:
    """Format a case for display."""
    if name == CLEAN:
        return "sound sensors"
    words = case.kind.replace("_", " ")
    return words if case.severity is None else f"{words}, severity {case.severity}"


def setting_text(record: Record) -> str:
    """Describe the setting of the scores in one line."""
    setting = record.setting
    frames = f"{setting.frames:,} frame{'' if setting.frames == 1 else 's'}"
    return (
        f"{setting.task} by {record.method}, {frames} of {setting.data}, suite {setting.suite}, "
        f"seed {setting.seed}, scored by {setting.scoring}"
    )


def severities(record: Record) -> tuple[int, ...]:
    """List the severities of all kinds, in order."""
    return tuple(sorted({case.severity for case in record.cases.values() if case.severity}))


def kind_cells(record: Record, kind: str) -> tuple[str | None, ...]:
    """Find the case in each column of scores, one for each severity; None if there is none.

    A kind without levels is in the last column, which is the only one if no kind has levels.
    """
    levels = severities(record)
    by_level = {record.cases[name].severity: name for name in record.kinds[kind]}
    columns: list[str | None] = [by_level.get(level) for level in levels]
    if any(record.cases[name].severity is None for name in record.cases if name != CLEAN):
        columns.append(by_level.get(None))
    return tuple(columns)


def score_columns(record: Record) -> tuple[str, ...]:
    """Make the headers of the columns of `kind_cells`."""
    levels = tuple(map(str, severities(record)))
    has_plain = any(record.cases[name].severity is None for name in record.cases if name != CLEAN)
    only = "one level" if levels else "score"
    return (*levels, only) if has_plain else levels


def kinds_table(record: Record, metric: BenchMetric, measures: Measures) -> TextTable:
    """Make a table with one row per kind: the scores of its severities, and its measures."""
    clean = score_text(measures.clean, metric)
    columns = score_columns(record)
    rows = [("sound sensors", *(("",) * len(columns)), clean, "", "",
             score_text(measures.gaps[CLEAN], metric, signed=True))]  # fmt: skip
    for kind, each in measures.kinds.items():
        scores = (
            "" if name is None else score_text(record.score(name, metric), metric)
            for name in kind_cells(record, kind)
        )
        rows.append(
            (
                kind.replace("_", " "),
                *scores,
                score_text(each.mean, metric),
                ratio_text(each.rr),
                ratio_text(each.ce),
                score_text(each.gap, metric, signed=True),
            )
        )
    rows.append(
        (
            "mean of kinds",
            *(("",) * len(columns)),
            score_text(measures.mpc, metric),
            ratio_text(measures.mrr),
            ratio_text(measures.mce),
            "",
        )
    )
    return TextTable(
        title=f"{metric.title}, {metric.unit}, by kind and severity",
        header=("kind", *columns, "mean", "RR", "CE", "gap"),
        rows=tuple(rows),
    )


def leading_metrics(metrics: Sequence[BenchMetric]) -> tuple[BenchMetric, ...]:
    """Select the first metric and, for an average over recall positions, that over all points."""
    first = metrics[0]
    all_points = first.name.removesuffix("_R40") + "_all_points"
    return (first, *(each for each in metrics if each.name == all_points))


def metrics_table(
    record: Record, measured: Sequence[tuple[BenchMetric, Measures | None]]
) -> TextTable:
    """Make a table with one row per metric: the measures over all kinds."""
    rows = []
    for metric, measures in measured:
        name = f"{metric.title}, {metric.unit}"
        if measures is None:
            clean = score_text(record.score(CLEAN, metric), metric)
            rows.append((name, clean, *((NOTHING,) * 5)))
            continue
        gap = measures.gap
        worst = measures.worst
        rows.append(
            (
                name,
                score_text(measures.clean, metric),
                score_text(measures.mpc, metric),
                ratio_text(measures.mrr),
                ratio_text(measures.mce),
                f"{score_text(worst.score, metric)} {worst.case}",
                NOTHING
                if gap is None
                else f"{score_text(gap.score, metric, signed=True)} {gap.case}",
            )
        )
    return TextTable(
        title="All metrics",
        header=("metric", "clean", "mPC", "mRR", "mCE", "worst case", "smallest gap"),
        rows=tuple(rows),
    )

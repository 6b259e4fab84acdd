"""Charts of a run in HTML and SVG: heat map of kinds and severities, curves, bars."""

import itertools
import math
from collections.abc import Sequence
from html import escape
from typing import Final, NamedTuple

from sightline.corruptions.suites import CLEAN
from sightline.robustness.measured import Measures
from sightline.robustness.record import Record
from sightline.robustness.scoring import BenchMetric
from sightline.robustness.texts import (
    kind_cells,
    ratio_text,
    score_columns,
    score_text,
    severities,
)

_HEAT: Final = (  # remaining share of the clean performance, and its colour
    (0.0, (122, 28, 48)),
    (0.25, (190, 60, 60)),
    (0.5, (230, 126, 84)),
    (0.75, (248, 200, 140)),
    (0.9, (252, 236, 200)),
    (1.0, (222, 240, 230)),
)
_DARK: Final = 0.55  # maximum share with white text
_CHART_PX: Final = (260, 150)
_PLOT_PX: Final = (38, 10, 250, 124)  # left, top, right, bottom of the plot area


LINE_STYLES: Final = ("ours", "other", "third", "fourth")
"""CSS classes of methods in one chart; they repeat if there are more methods."""


class Line(NamedTuple):
    """Method in a chart."""

    name: str
    style: str
    """CSS class: one of `LINE_STYLES`, or "alone"."""
    record: Record


def remaining_share(score: float | None, clean: float | None, metric: BenchMetric) -> float | None:
    """Compute the remaining share of the clean performance, from 0 to 1, for the colours.

    It is None without a score, or if there is no clean performance to lose.
    """
    if score is None or clean is None:
        return None
    above, below = (clean, score) if metric.highest is None else (score, clean)
    if metric.highest is None and score == 0:
        return 1.0  # without any error, independent of the clean one
    return min(max(above / below, 0.0), 1.0) if below > 0 else None


def heat_color(share: float) -> tuple[str, str]:
    """Choose background and text of a cell, as CSS colours."""
    for (low, first), (high, second) in itertools.pairwise(_HEAT):
        if share <= high:
            part = (share - low) / (high - low)
            mixed = [round(a + part * (b - a)) for a, b in zip(first, second, strict=True)]
            return f"#{mixed[0]:02x}{mixed[1]:02x}{mixed[2]:02x}", (
                "#ffffff" if share < _DARK else "#1c2530"
            )
    raise AssertionError(f"shares are at most 1, got {share}")


def heat_map(record: Record, metric: BenchMetric, measures: Measures) -> str:
    """Draw kinds by severities; colours show the remaining share of the clean score."""
    head = "".join(
        f'<th scope="col">{escape(name)}</th>'
        for name in (*score_columns(record), "mean", "RR", "CE", "gap")
    )
    rows = []
    for kind, each in measures.kinds.items():
        cells = "".join(
            _heat_cell(None if name is None else record.score(name, metric), metric, measures.clean)
            for name in kind_cells(record, kind)
        )
        sums = (
            score_text(each.mean, metric),
            ratio_text(each.rr),
            ratio_text(each.ce),
            score_text(each.gap, metric, signed=True),
        )
        cells += "".join(f'<td class="sum">{escape(text)}</td>' for text in sums)
        rows.append(f'<tr><th scope="row">{escape(kind.replace("_", " "))}</th>{cells}</tr>')
    return (
        f'<div class="scroll"><table class="heat"><thead><tr><th scope="col">kind</th>{head}</tr>'
        f"</thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _heat_cell(score: float | None, metric: BenchMetric, clean: float) -> str:
    if score is None:
        return "<td></td>"
    share = remaining_share(score, clean, metric)
    if share is None:
        return f'<td class="cell">{score_text(score, metric)}</td>'
    background, letters = heat_color(share)
    return (
        f'<td class="cell" style="background:{background};color:{letters}" '
        f'title="{100 * share:.0f} % left">{score_text(score, metric)}</td>'
    )


def heat_legend() -> str:
    """Draw the legend of the colours."""
    steps = "".join(
        f'<i style="background:{heat_color(share)[0]};color:{heat_color(share)[1]}">'
        f"{100 * share:.0f}</i>"
        for share in (1.0, 0.9, 0.75, 0.5, 0.25, 0.0)
    )
    return f'<p class="scale">of the clean performance is left, %: <span>{steps}</span></p>'


def nice_top(value: float) -> float:
    """Round up the end of an axis to 1, 2, 2.5 or 5 times a power of 10."""
    if value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 2.5, 5, 10) if step * power >= value * (1 - 1e-9))


def curve_charts(lines: Sequence[Line], metric: BenchMetric, best_single: float | None) -> str:
    """Draw a small chart for each kind with several severities; empty if none has.

    Args:
        lines: The methods; kinds and severities are the first one's.
        metric: The metric to draw.
        best_single: The best clean score of a single sensor's method, or None.
    """
    record = lines[0].record
    kinds = [kind for kind, names in record.kinds.items() if len(names) > 1]
    points = {kind: [_points(line.record, record, kind, metric) for line in lines]
              for kind in kinds}  # fmt: skip
    values = {kind: [score for each in points[kind] for _, score in each] for kind in kinds}
    highest = max((max(each) for each in values.values() if each), default=0.0)
    charts = []
    for kind in kinds:
        # Scores share an axis, but errors of one kind can be a hundred times another's.
        top = highest if metric.highest is not None else max(values[kind], default=0.0)
        drawn = [(line, some) for line, some in zip(lines, points[kind], strict=True)]
        charts.append(
            _curve_chart(kind, drawn, metric, nice_top(max(top, best_single or 0.0)), best_single)
        )
    return f'<div class="charts">{"".join(charts)}</div>' if charts else ""


def _points(
    record: Record, reference: Record, kind: str, metric: BenchMetric
) -> list[tuple[int, float]]:
    """List severities with scores, 0 for sound sensors; kinds and severities of `reference`."""
    names = [(0, CLEAN)]
    names += [(reference.cases[name].severity or 0, name) for name in reference.kinds[kind]]
    scores = [(level, record.score(name, metric)) for level, name in names if name in record.cases]
    return [(level, score) for level, score in scores if score is not None]


class _Plot(NamedTuple):
    """Plot positions of severities and scores."""

    last: int
    """Highest severity, at the right end."""
    top: float
    """Score at the upper end; 0 is at the lower end."""

    def place(self, level: int, score: float) -> str:
        """Compute column and row [px]."""
        left, above, right, bottom = _PLOT_PX
        x = left + (right - left) * level / self.last
        y = bottom - (bottom - above) * score / self.top
        return f"{x:.1f},{y:.1f}"

    def axes(self, metric: BenchMetric) -> str:
        """Draw lines at the maximum, middle and zero scores, and the severities' labels."""
        left, _, _, bottom = _PLOT_PX
        parts = []
        for share in (0.0, 0.5, 1.0):
            score = share * self.top
            start, end = self.place(0, score), self.place(self.last, score)
            text, y = score_text(score, metric) if share else "0", float(start.split(",")[1]) + 3
            parts.append(
                f'<path class="grid" d="M{start}L{end}"/><text class="tick" x="{left - 4}" '
                f'y="{y:.1f}" text-anchor="end">{text}</text>'
            )
        for level in range(self.last + 1):
            x = self.place(level, 0.0).split(",")[0]
            parts.append(
                f'<text class="tick" x="{x}" y="{bottom + 13}" text-anchor="middle">'
                f"{level or 'clean'}</text>"
            )
        return "".join(parts)


def _curve_chart(
    kind: str,
    lines: Sequence[tuple[Line, Sequence[tuple[int, float]]]],
    metric: BenchMetric,
    top: float,
    best_single: float | None,
) -> str:
    plot = _Plot(max(severities(lines[0][0].record), default=1), top)
    parts = [plot.axes(metric)]
    if best_single is not None:
        ends = f"M{plot.place(0, best_single)}L{plot.place(plot.last, best_single)}"
        parts.append(f'<path class="alone" d="{ends}"/>')
    for line, points in reversed(lines):
        path = "L".join(plot.place(level, score) for level, score in points)
        parts.append(f'<path class="{line.style}" d="M{path}"/>')
        for level, score in points:
            x, y = plot.place(level, score).split(",")
            parts.append(
                f'<circle class="{line.style}" cx="{x}" cy="{y}" r="2.4"><title>'
                f"{escape(line.name)}: {score_text(score, metric)}</title></circle>"
            )
    title = escape(kind.replace("_", " "))
    width, height = _CHART_PX
    return (
        f'<figure><figcaption>{title}</figcaption><svg viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="{title}">{"".join(parts)}</svg></figure>'
    )


def bar_chart(lines: Sequence[Line], metric: BenchMetric) -> str:
    """Draw a bar for each kind with a single level, and for sound sensors; empty without any."""
    record = lines[0].record
    names = [names[0] for names in record.kinds.values() if len(names) == 1]
    if not names:
        return ""
    cases = [CLEAN, *names]
    scores = {
        name: [
            (line, line.record.score(name, metric)) for line in lines if name in line.record.cases
        ]
        for name in cases
    }
    known = [score for row in scores.values() for _, score in row if score is not None]
    top = nice_top(max(known, default=0.0))
    rows = []
    for name in cases:
        label = "sound sensors" if name == CLEAN else record.cases[name].kind.replace("_", " ")
        bars = "".join(
            f'<div class="bar {line.style}" style="width:{100 * (score or 0.0) / top:.2f}%" '
            f'title="{escape(line.name)}"></div><span>{score_text(score, metric)}</span>'
            for line, score in scores[name]
        )
        rows.append(f'<div class="label">{escape(label)}</div><div class="track">{bars}</div>')
    return f'<div class="bars">{"".join(rows)}</div>'

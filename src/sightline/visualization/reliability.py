"""Reliability diagrams: scores against the share of true detections."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8

from sightline.structures.score_curves import Reliability
from sightline.visualization.canvas import put_lines
from sightline.visualization.cells import MUTED
from sightline.visualization.chart import (
    AXIS_TEXT_PX,
    BACKGROUND,
    Plot,
    put_axes,
    put_title,
)
from sightline.visualization.colors import RGB
from sightline.visualization.lettering import put_text, text_width

_SIZE = (300, 330)  # height, width [px] of one diagram
_BAR: RGB = (86, 180, 233)
_GAP: RGB = (230, 120, 40)
_DIAGONAL: RGB = (222, 225, 230)
_COUNT: RGB = (120, 126, 136)
_COUNT_ROWS_PX = 34
_MARGINS_PX = (46, 16, 28, 30 + _COUNT_ROWS_PX)


def draw_reliability_sheet(
    rows: Sequence[Sequence[tuple[str, Reliability]]],
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw rows of titled diagrams; all rows have the same length."""
    pictures = [
        np.concatenate([draw_reliability(title, each) for title, each in row], axis=1)
        for row in rows
    ]
    return np.concatenate(pictures)


def draw_reliability(
    title: str, reliability: Reliability, *, size: tuple[int, int] = _SIZE
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a diagram after DeGroot and Fienberg 1983, with gaps as in Guo et al. 2017.

    Bars show the mean target of each bin, orange lines the difference to its mean score; on the
    diagonal both are equal. Below are the numbers of detections, as bars on a logarithmic scale.

    Args:
        title: Title above the diagram.
        reliability: Data of the diagram.
        size: Height, width [px].
    """
    height, width = size
    canvas = np.full((height, width, 3), BACKGROUND, np.uint8)
    left, right, above, below = _MARGINS_PX
    plot = Plot(left=left, right=width - right, top=above, bottom=height - below)
    put_axes(canvas, plot)
    _put_bars(canvas, plot, reliability)
    ends = [[[plot.left, plot.bottom], [plot.right, plot.top]]]
    put_lines(canvas, np.array(ends, dtype=np.float64), _DIAGONAL, opacity=0.6)
    _put_counts(canvas, plot, reliability)
    put_title(canvas, plot, title)
    if reliability.error is not None:
        text = f"error {100 * reliability.error:.1f} %"
        text_left = plot.right - text_width(text, AXIS_TEXT_PX)
        put_text(canvas, text, text_left, above - 9, height_px=AXIS_TEXT_PX, color=_GAP)
    return canvas


def _put_bars(
    canvas: UInt8[np.ndarray, "height width 3"], plot: Plot, reliability: Reliability
) -> None:
    for number in np.flatnonzero(reliability.counts):
        start, end = _columns(plot, reliability, int(number))
        top = round(plot.row(float(reliability.mean_target[number])))
        area = canvas[top : plot.bottom, start + 1 : end]
        area[:] = np.rint(0.65 * np.array(_BAR) + 0.35 * area)
        score = float(reliability.mean_score[number])
        column, middle = plot.column(score), plot.row(score)
        segment = np.array([[[column, top], [column, middle]]], dtype=np.float64)
        put_lines(canvas, segment, _GAP, width_px=2)


def _put_counts(
    canvas: UInt8[np.ndarray, "height width 3"], plot: Plot, reliability: Reliability
) -> None:
    foot = plot.bottom + 24 + _COUNT_ROWS_PX
    max_count = max(int(reliability.counts.max(initial=0)), 1)
    for number in np.flatnonzero(reliability.counts):
        start, end = _columns(plot, reliability, int(number))
        share = np.log1p(reliability.counts[number]) / np.log1p(max_count)
        canvas[foot - max(round(share * _COUNT_ROWS_PX), 1) : foot, start + 1 : end] = _COUNT
    text = f"{max_count:,}"
    text_left = plot.left - text_width(text, AXIS_TEXT_PX - 1) - 5
    baseline = foot - _COUNT_ROWS_PX + AXIS_TEXT_PX
    put_text(canvas, text, text_left, baseline, height_px=AXIS_TEXT_PX - 1, color=MUTED)


def _columns(plot: Plot, reliability: Reliability, number: int) -> tuple[int, int]:
    """First and last column of a bin [px]."""
    edges = number / reliability.num_bins, (number + 1) / reliability.num_bins
    return round(plot.column(edges[0])), round(plot.column(edges[1]))

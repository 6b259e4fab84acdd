"""Precision-recall charts with the recall positions of average precision."""

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from sightline.structures.score_curves import NUM_SLOTS, PrecisionRecall
from sightline.visualization.canvas import put_lines
from sightline.visualization.cells import MUTED
from sightline.visualization.chart import BACKGROUND, TEXT, Plot, put_axes, put_title
from sightline.visualization.colors import CURVE_COLORS, RGB
from sightline.visualization.lettering import put_text, text_width

_WIDTH = 760
_PLOT_HEIGHT = 410
_MARGINS_PX = (64, 24, 44, 42)  # left, right, above, below to the legend
_TEXT_PX = 12
_LINE_PX = 24  # from one line of the legend to the next
_SAMPLE_PX = 34  # length of a line in the legend
_R40_RADIUS_PX, _R11_RADIUS_PX = 2, 5
_MEASURED_OPACITY = 0.45
_SHARES = tuple(number / 10 for number in range(0, 11, 2))
_COLUMNS = tuple((share, f"{share:g}") for share in _SHARES)
_ROWS = tuple((share, f"{100 * share:.0f} %") for share in _SHARES)


def draw_precision_recall(
    title: str, curves: Mapping[str, PrecisionRecall]
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw up to four curves in one chart, with their average precision below.

    The strong line joins the slots. Dots mark the recall positions of AP R40, rings those of R11;
    slots that were never reached count as 0 and are not drawn. The faint line has each measured
    precision at its own recall.

    Args:
        title: Title above the chart.
        curves: Curves by their name in the legend.

    Raises:
        ValueError: There are more curves than colours.
    """
    if len(curves) > len(CURVE_COLORS):
        raise ValueError(
            f"a chart shows up to {len(CURVE_COLORS)} curves, got {len(curves)}; draw several "
            "charts"
        )
    lines = len(curves) + 1
    canvas = np.full((_PLOT_HEIGHT + lines * _LINE_PX + 12, _WIDTH, 3), BACKGROUND, np.uint8)
    left, right, above, below = _MARGINS_PX
    plot = Plot(
        left=left,
        right=_WIDTH - right,
        top=above,
        bottom=_PLOT_HEIGHT - below,
        text_px=_TEXT_PX,
    )
    put_axes(canvas, plot, columns=_COLUMNS, rows=_ROWS)
    put_title(canvas, plot, f"{title}: precision over recall")
    named = list(zip(curves.items(), CURVE_COLORS, strict=False))
    for (_, curve), color in reversed(named):  # so that the first one is on top
        measured = np.stack((curve.recall, curve.precision), axis=1)
        _put_line(canvas, plot, measured, color, opacity=_MEASURED_OPACITY)
        reached = len(curve.recall)
        places = np.arange(NUM_SLOTS)[:reached] / (NUM_SLOTS - 1)
        _put_line(
            canvas, plot, np.stack((places, curve.slots[:reached]), axis=1), color, width_px=2
        )
        _put_marks(canvas, plot, curve, color)
    for number, ((name, curve), color) in enumerate(named):
        _put_entry(canvas, _PLOT_HEIGHT + number * _LINE_PX, name, curve, color)
    _put_key(canvas, _PLOT_HEIGHT + len(curves) * _LINE_PX)
    return canvas


def _put_line(
    canvas: UInt8[np.ndarray, "height width 3"],
    plot: Plot,
    shares: Float64[np.ndarray, "num_points 2"],
    color: RGB,
    *,
    width_px: int = 1,
    opacity: float = 1.0,
) -> None:
    """Draw a line through points (recall, precision)."""
    if len(shares) < 2:
        return
    pixels = np.array([[plot.column(float(x)), plot.row(float(y))] for x, y in shares])
    segments = np.stack((pixels[:-1], pixels[1:]), axis=1)
    put_lines(canvas, segments, color, width_px=width_px, opacity=opacity)


def _put_marks(
    canvas: UInt8[np.ndarray, "height width 3"], plot: Plot, curve: PrecisionRecall, color: RGB
) -> None:
    for slot in range(len(curve.recall)):
        share = slot / (NUM_SLOTS - 1)
        center = (round(plot.column(share)), round(plot.row(float(curve.slots[slot]))))
        if slot > 0:
            cv2.circle(canvas, center, _R40_RADIUS_PX, color, -1, cv2.LINE_AA)
        if slot % 4 == 0:
            cv2.circle(canvas, center, _R11_RADIUS_PX, color, 1, cv2.LINE_AA)


def _put_entry(
    canvas: UInt8[np.ndarray, "height width 3"],
    top: int,
    name: str,
    curve: PrecisionRecall,
    color: RGB,
) -> None:
    """Write a line of the legend: name, average precision, number of objects."""
    left, baseline = _MARGINS_PX[0], top + _TEXT_PX
    middle = baseline - _TEXT_PX // 2
    ends = np.array([[[left, middle], [left + _SAMPLE_PX, middle]]], dtype=np.float64)
    put_lines(canvas, ends, color, width_px=2)
    cells = (
        (left + _SAMPLE_PX + 10, name, TEXT),
        (left + 180, f"AP R40 {curve.ap_r40:.2f}", TEXT),
        (left + 340, f"AP R11 {curve.ap_r11:.2f}", TEXT),
        (left + 500, f"{curve.num_objects:,} objects", MUTED),
    )
    for column, text, shade in cells:
        put_text(canvas, text, column, baseline, height_px=_TEXT_PX, color=shade)


def _put_key(canvas: UInt8[np.ndarray, "height width 3"], top: int) -> None:
    """Draw the key of dots, rings and the faint line."""
    column, baseline = _MARGINS_PX[0], top + _TEXT_PX
    middle = baseline - _TEXT_PX // 2
    cv2.circle(canvas, (column + 6, middle), _R40_RADIUS_PX, MUTED, -1, cv2.LINE_AA)
    column = _put_word(canvas, "recall positions of R40", column + 16, baseline)
    cv2.circle(canvas, (column + 6, middle), _R11_RADIUS_PX, MUTED, 1, cv2.LINE_AA)
    column = _put_word(canvas, "of R11", column + 16, baseline)
    ends = np.array([[[column, middle], [column + _SAMPLE_PX, middle]]], dtype=np.float64)
    put_lines(canvas, ends, MUTED, opacity=_MEASURED_OPACITY)
    _put_word(canvas, "measured, at its own recall", column + _SAMPLE_PX + 8, baseline)


def _put_word(
    canvas: UInt8[np.ndarray, "height width 3"], text: str, left: int, baseline: int
) -> int:
    """Write a text, and return the column for the next one."""
    put_text(canvas, text, left, baseline, height_px=_TEXT_PX - 1, color=MUTED)
    return left + text_width(text, _TEXT_PX - 1) + 22

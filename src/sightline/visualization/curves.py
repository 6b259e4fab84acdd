"""Charts of values over training steps."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64, UInt8

from sightline.visualization.canvas import put_lines, put_points
from sightline.visualization.cells import MUTED
from sightline.visualization.chart import BACKGROUND, TEXT, Plot, put_axes, put_title
from sightline.visualization.colors import CURVE_COLORS, RGB
from sightline.visualization.lettering import put_text, text_width

_SIZE = (430, 616)  # height, width [px]
_MARGINS_PX = (58, 20, 40, 84)  # left, right, above, below
_TEXT_PX = 12
_LINE_PX = 20
_SAMPLE_PX = 26
_SPANS = 40  # of a smoothed curve
_FAINT = 0.35
_TICKS = 5
_DOT_PX = 6.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Curve:
    """Values over training steps."""

    name: str
    """Name in the legend."""
    steps: Int64[np.ndarray, " num_values"]
    """Training steps, ascending."""
    values: Float[np.ndarray, " num_values"]


def draw_curves(
    title: str, curves: Sequence[Curve], *, highest: float | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw up to four curves from zero on, with the last value of each in the legend.

    Curves with many values have a strong line, the mean of each fortieth of the steps, over the
    faint line of all values; curves with few have dots.

    Args:
        title: Title above the chart.
        curves: Curves with values of 0 or more; empty ones are left out.
        highest: Value at the upper end. None: a round number above 98 % of the values.

    Raises:
        ValueError: There are more curves than colours.
    """
    if len(curves) > len(CURVE_COLORS):
        raise ValueError(
            f"a chart shows up to {len(CURVE_COLORS)} curves, got {len(curves)}; draw several "
            "charts"
        )
    named = [
        (curve, color)
        for curve, color in zip(curves, CURVE_COLORS, strict=False)
        if len(curve.values)
    ]
    canvas = np.full((*_SIZE, 3), BACKGROUND, np.uint8)
    left, right, above, below = _MARGINS_PX
    height, width = _SIZE
    plot = Plot(left=left, right=width - right, top=above, bottom=height - below, text_px=_TEXT_PX)
    put_title(canvas, plot, title)
    if not named:
        put_axes(canvas, plot, columns=(), rows=())
        put_text(canvas, "nothing was logged", left + 12, above + 30, color=MUTED)
        return canvas
    last_step = max(int(curve.steps[-1]) for curve, _ in named)
    if highest is None:
        highest = _round_up(max(float(np.quantile(curve.values, 0.98)) for curve, _ in named))
    put_axes(canvas, plot, columns=_labels(float(last_step)), rows=_labels(highest))
    for curve, color in reversed(named):  # the first one is on top
        places = np.stack(
            (curve.steps / max(last_step, 1), np.clip(curve.values / highest, 0, 1)), axis=1
        )
        is_dense = len(places) > 2 * _SPANS
        if is_dense:
            _put_line(canvas, plot, places, color, opacity=_FAINT)
            places = _means(places)
        _put_line(canvas, plot, places, color, width_px=2)
        if not is_dense:
            pixels = _pixels(plot, places)
            colors = np.broadcast_to(np.array(color, np.uint8), (len(pixels), 3)).copy()
            put_points(canvas, pixels, colors, diameter_px=_DOT_PX)
    put_text(
        canvas,
        "training steps",
        plot.right - text_width("training steps", _TEXT_PX - 1),
        plot.bottom + 34,
        height_px=_TEXT_PX - 1,
        color=MUTED,
    )
    _put_legend(canvas, plot, named)
    return canvas


def _round_up(value: float) -> float:
    """Round up to 1, 2, 2.5 or 5 times a power of ten."""
    if value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(each * power for each in (1, 2, 2.5, 5, 10) if each * power >= value)


def _labels(highest: float) -> list[tuple[float, str]]:
    """Positions and texts of grid lines at even steps from 0 to `highest`."""
    step = _round_up(highest / _TICKS)
    count = int(highest / step + 1e-9)
    return [(number * step / highest, f"{number * step:,g}") for number in range(count + 1)]


def _means(places: Float[np.ndarray, "num_values 2"]) -> Float[np.ndarray, "num_spans 2"]:
    return np.array([part.mean(axis=0) for part in np.array_split(places, _SPANS)])


def _pixels(plot: Plot, places: Float[np.ndarray, "num_values 2"]) -> np.ndarray:
    return np.array([[plot.column(float(x)), plot.row(float(y))] for x, y in places])


def _put_line(
    canvas: UInt8[np.ndarray, "height width 3"],
    plot: Plot,
    places: Float[np.ndarray, "num_values 2"],
    color: RGB,
    *,
    width_px: int = 1,
    opacity: float = 1.0,
) -> None:
    if len(places) > 1:
        pixels = _pixels(plot, places)
        segments = np.stack((pixels[:-1], pixels[1:]), axis=1)
        put_lines(canvas, segments, color, width_px=width_px, opacity=opacity)


def _put_legend(
    canvas: UInt8[np.ndarray, "height width 3"], plot: Plot, named: Sequence[tuple[Curve, RGB]]
) -> None:
    """Write names and last values below the axes, two a line."""
    half = (plot.right - plot.left) // 2
    for number, (curve, color) in enumerate(named):
        left = plot.left + number % 2 * half
        baseline = plot.bottom + 54 + number // 2 * _LINE_PX
        middle = baseline - _TEXT_PX // 2
        ends = np.array([[[left, middle], [left + _SAMPLE_PX, middle]]], dtype=np.float64)
        put_lines(canvas, ends, color, width_px=2)
        text = f"{curve.name}: {curve.values[-1]:.3g}"
        put_text(canvas, text, left + _SAMPLE_PX + 8, baseline, height_px=_TEXT_PX - 1, color=TEXT)

"""Maps of shares from 0 to 1, gates say, laid over a picture; and how often shares occur."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from sightline.visualization.canvas import put_lines
from sightline.visualization.chart import AXIS_TEXT_PX, BACKGROUND, Plot, put_axes, put_title
from sightline.visualization.colors import RGB
from sightline.visualization.lettering import put_text, text_width

_DARKEST = 0.6  # what black leaves of a colour
_BINS = 25
_MARGINS_PX = (46, 14, 26, 22)  # left, right, above and below what is drawn in
_FILL = 0.55


def lay_shares(
    picture: UInt8[np.ndarray, "height width 3"], shares: Float[np.ndarray, "rows columns"]
) -> UInt8[np.ndarray, "height width 3"]:
    """The colours of a map, shaded by the RGB picture: violet is 0, green a half, yellow 1.

    The map is stretched to the picture's size; values beyond 0 and 1 take the colour of that end.
    """
    height, width = picture.shape[:2]
    levels = np.rint(255 * np.clip(shares, 0, 1)).astype(np.uint8)
    stretched = cv2.resize(levels, (width, height), interpolation=cv2.INTER_LINEAR)
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)[..., None]
    shade = _DARKEST + (1 - _DARKEST) * grey / 255
    laid: UInt8[np.ndarray, "height width 3"]
    laid = np.rint(_share_colors()[stretched] * shade).astype(np.uint8)
    return laid


@lru_cache(maxsize=1)
def _share_colors() -> UInt8[np.ndarray, "256 3"]:
    """Viridis (Smith and van der Walt 2015), which is even to colour-blind eyes as well."""
    ramp = np.arange(256, dtype=np.uint8)[:, None]
    return np.ascontiguousarray(cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1])


def put_share_legend(
    canvas: UInt8[np.ndarray, "height width 3"],
    low: str,
    high: str,
    *,
    right: int,
    top: int,
    color: RGB,
    width_px: int = 120,
) -> None:
    """Writes the bar of `lay_shares` between words for its ends, the last at column `right`."""
    end = right - text_width(high, AXIS_TEXT_PX) - 6
    start = end - width_px
    canvas[top : top + AXIS_TEXT_PX, start:end] = _share_colors()[
        np.linspace(0, 255, width_px).astype(np.int64)
    ]
    baseline = top + AXIS_TEXT_PX
    left = start - text_width(low, AXIS_TEXT_PX) - 4
    put_text(canvas, low, left, baseline, height_px=AXIS_TEXT_PX, color=color)
    put_text(canvas, high, end + 4, baseline, height_px=AXIS_TEXT_PX, color=color)


@dataclass(frozen=True, kw_only=True, slots=True)
class ShareSeries:
    """Shares that a histogram counts."""

    name: str
    values: Float[np.ndarray, " num_values"]
    """From 0 to 1."""
    color: RGB


def draw_histogram(
    title: str, series: Sequence[ShareSeries], *, size: tuple[int, int]
) -> UInt8[np.ndarray, "height width 3"]:
    """How often shares occur, in percent of each series, in 25 bins from 0 to 1.

    Args:
        title: Above it.
        series: Drawn one over the other.
        size: Height, width [px] of the picture.
    """
    height, width = size
    canvas = np.full((height, width, 3), BACKGROUND, np.uint8)
    left, right, above, below = _MARGINS_PX
    plot = Plot(left=left, right=width - right, top=above, bottom=height - below)
    put_axes(canvas, plot)
    for each in series:
        counts, _ = np.histogram(np.clip(each.values, 0, 1), bins=_BINS, range=(0, 1))
        _put_steps(canvas, plot, counts / max(len(each.values), 1), each.color)
    put_title(canvas, plot, title)
    at = width - right
    for each in reversed(series):
        at -= text_width(each.name, AXIS_TEXT_PX)
        put_text(canvas, each.name, at, above - 9, height_px=AXIS_TEXT_PX, color=each.color)
        at -= 14
    return canvas


def _put_steps(
    canvas: UInt8[np.ndarray, "height width 3"],
    plot: Plot,
    heights: Float[np.ndarray, " num_bins"],
    color: RGB,
) -> None:
    """Bars, transparent enough for another series to show through, and their outline."""
    edges = [plot.column(edge) for edge in np.linspace(0, 1, len(heights) + 1)]
    tops = [plot.row(float(share)) for share in heights]
    for start, end, top in zip(edges[:-1], edges[1:], tops, strict=True):
        area = canvas[round(top) : plot.bottom, round(start) : round(end)]
        area[:] = np.rint(_FILL * np.array(color) + (1 - _FILL) * area)
    outline = [[edges[0], plot.bottom]]
    for start, end, top in zip(edges[:-1], edges[1:], tops, strict=True):
        outline += [[start, top], [end, top]]
    outline.append([edges[-1], plot.bottom])
    points = np.array(outline, dtype=np.float64)
    put_lines(canvas, np.stack((points[:-1], points[1:]), axis=1), color)

"""Maps of shares from 0 to 1, such as gates, over a picture, and histograms of shares."""

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

_DARKEST = 0.6  # brightness of a colour over black
_BINS = 25
_MARGINS_PX = (46, 14, 26, 22)  # left, right, above, below
_FILL = 0.55


def lay_shares(
    picture: UInt8[np.ndarray, "height width 3"], shares: Float[np.ndarray, "rows columns"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Colour a map, shaded by an RGB picture: violet is 0, green 0.5, yellow 1.

    The map is stretched to the picture's size; values beyond 0 and 1 have the colour of that end.
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
    """Colour map Viridis (Smith and van der Walt 2015), also even for colour-blind people."""
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
    """Draw the colour bar of `lay_shares` between labels of its ends, up to column `right`."""
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
    """Series of shares in a histogram."""

    name: str
    values: Float[np.ndarray, " num_values"]
    """Values from 0 to 1."""
    color: RGB


def draw_histogram(
    title: str, series: Sequence[ShareSeries], *, size: tuple[int, int]
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a histogram of shares, in percent of each series, in 25 bins from 0 to 1.

    Args:
        title: Title above the histogram.
        series: Series, drawn one over the other.
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
    name_left = width - right
    for each in reversed(series):
        name_left -= text_width(each.name, AXIS_TEXT_PX)
        put_text(canvas, each.name, name_left, above - 9, height_px=AXIS_TEXT_PX, color=each.color)
        name_left -= 14
    return canvas


def _put_steps(
    canvas: UInt8[np.ndarray, "height width 3"],
    plot: Plot,
    heights: Float[np.ndarray, " num_bins"],
    color: RGB,
) -> None:
    """Draw transparent bars and their outline."""
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

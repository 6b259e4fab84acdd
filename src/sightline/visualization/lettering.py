"""Text on pictures: anti-aliased, measured in pixels, kept within the picture.

`put_...` functions change the given picture.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from sightline.visualization.colors import RGB

_OVERSAMPLING = 4
_CAP_HEIGHT = 21  # px, of OpenCV's font at scale 1
_ASCENT, _DESCENT = 1.4, 0.5  # of a line, in heights of capitals


@dataclass(frozen=True, kw_only=True)
class Tag:
    """Short text at a box."""

    text: str
    color: RGB
    box: tuple[float, float, float, float]
    """x_min, y_min, x_max, y_max [px] of the tagged object."""


def text_width(text: str, height_px: int) -> int:
    """Width [px] of a text whose capitals are `height_px` high."""
    return int(_text_mask(text, height_px).shape[1])


def put_text(
    canvas: UInt8[np.ndarray, "height width 3"],
    text: str,
    left: int,
    baseline: int,
    *,
    height_px: int = 11,
    color: RGB = (225, 228, 232),
) -> None:
    """Write a text that starts at column `left` and stands on row `baseline`."""
    mask = _text_mask(text, height_px)
    top = baseline - round(_ASCENT * height_px)
    rows = slice(max(top, 0), max(min(top + mask.shape[0], canvas.shape[0]), 0))
    columns = slice(max(left, 0), max(min(left + mask.shape[1], canvas.shape[1]), 0))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return
    weight = mask[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    region = canvas[rows, columns]
    region[:] = np.rint(region + weight[..., None] * (np.array(color) - region.astype(np.float32)))


def with_title(
    picture: UInt8[np.ndarray, "height width 3"], title: str, *, height_px: int = 11
) -> UInt8[np.ndarray, "new_height width 3"]:
    """Put a dark bar with a title above a picture; too long a title is cut off."""
    bar = np.full((2 * height_px, picture.shape[1], 3), 24, np.uint8)
    put_text(bar, title, height_px // 2, round(1.5 * height_px), height_px=height_px)
    return np.concatenate((bar, picture))


def put_tags(
    canvas: UInt8[np.ndarray, "height width 3"], tags: Sequence[Tag], *, height_px: int
) -> None:
    """Write tags on plates beside their boxes, without overlaps.

    Positions are tried in this order: above the box's top left corner, within it, below the box,
    and the same from the right edge. A tag without a free position is left out: the box has its
    class's colour.
    """
    taken: list[tuple[int, int, int, int]] = []
    for tag in tags:
        width = text_width(tag.text, height_px) + height_px
        height = round(1.8 * height_px)
        plate = _free_place(canvas.shape, tag.box, width, height, taken)
        if plate is None:
            continue
        taken.append(plate)
        left, top, right, bottom = plate
        canvas[top:bottom, left:right] = tag.color
        put_text(
            canvas,
            tag.text,
            left + height_px // 2,
            top + round(1.4 * height_px),
            height_px=height_px,
            color=(12, 12, 16) if _luminance(tag.color) > 105 else (255, 255, 255),
        )


def _free_place(
    shape: tuple[int, ...],
    box: tuple[float, float, float, float],
    width: int,
    height: int,
    taken: Sequence[tuple[int, int, int, int]],
) -> tuple[int, int, int, int] | None:
    x_min, y_min, x_max, y_max = box
    for anchor in (x_min, x_max + 1 - width):
        left = round(min(max(anchor, 0), max(shape[1] - width, 0)))
        for edge in (y_min - height, y_min, y_max + 1):
            top = round(edge)
            plate = (left, top, left + width, top + height)
            inside = top >= 0 and plate[3] <= shape[0]
            if inside and not any(_overlap(plate, other) for other in taken):
                return plate
    return None


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _luminance(color: RGB) -> float:
    return 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2]


@lru_cache(maxsize=1024)
def _text_mask(text: str, height_px: int) -> Float32[np.ndarray, "rows columns"]:
    """Coverage of each pixel of a line of text, drawn large and averaged down."""
    font, scale = cv2.FONT_HERSHEY_SIMPLEX, height_px * _OVERSAMPLING / _CAP_HEIGHT
    stroke = max(round(0.1 * height_px * _OVERSAMPLING), 1)
    (width, _), _ = cv2.getTextSize(text, font, scale, stroke)
    columns = -(-(width + stroke) // _OVERSAMPLING)
    rows = round((_ASCENT + _DESCENT) * height_px)
    large = np.zeros((rows * _OVERSAMPLING, columns * _OVERSAMPLING), np.uint8)
    baseline = round(_ASCENT * height_px * _OVERSAMPLING)
    cv2.putText(large, text, (0, baseline), font, scale, 255, stroke, cv2.LINE_AA)
    small = cv2.resize(large, (columns, rows), interpolation=cv2.INTER_AREA)
    return small.astype(np.float32) / 255

"""Other conventions in which 2D boxes are written, and when one is believed."""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64

FEWEST_RESULTS: Final = 5
"""Smallest number of objects whose medians and scores tell anything."""
MET_IOU: Final = 0.5
"""IoU from which a box meets another one."""
_MARGIN_IOU: Final = 0.1
"""Difference of IoU from which one reading fits better than another one."""
_LEAST_SHARE: Final = 0.2

Boxes = Float64[np.ndarray, "num_boxes 4"]


def _from_corner_and_size(boxes: Boxes) -> Boxes:
    return np.concatenate((boxes[:, :2], boxes[:, :2] + boxes[:, 2:]), axis=1)


def _from_centre_and_size(boxes: Boxes) -> Boxes:
    half = boxes[:, 2:] / 2
    return np.concatenate((boxes[:, :2] - half, boxes[:, :2] + half), axis=1)


READINGS: Final[Mapping[str, Callable[[Boxes], Boxes]]] = {
    "y_min, x_min, y_max, x_max": lambda boxes: boxes[:, [1, 0, 3, 2]],
    "x_min, y_min, width, height": _from_corner_and_size,
    "centre x, centre y, width, height": _from_centre_and_size,
    "pixels of an image of half the size": lambda boxes: 2 * boxes,
    "pixels of an image of twice the size": lambda boxes: boxes / 2,
}
"""Conversions to x_min, y_min, x_max, y_max [px], by the convention of the boxes."""


def image_ious(
    boxes: Float64[np.ndarray, "*shape 4"], others: Float64[np.ndarray, "*other_shape 4"]
) -> Float64[np.ndarray, "*result"]:
    """Compute the IoU of boxes, broadcast; 0 for boxes that are NaN, empty or inside out."""
    shared = np.minimum(boxes[..., 2:], others[..., 2:])
    shared = np.clip(shared - np.maximum(boxes[..., :2], others[..., :2]), 0, None).prod(axis=-1)
    areas = [
        np.clip(each[..., 2:] - each[..., :2], 0, None).prod(axis=-1) for each in (boxes, others)
    ]
    union = areas[0] + areas[1] - shared
    return np.where(union > 0, np.nan_to_num(shared) / np.where(union > 0, union, 1.0), 0.0)


def fits_better(
    ious: Float64[np.ndarray, " num"], than: Float64[np.ndarray, " num"]
) -> Bool[np.ndarray, " num"]:
    """Mask of the boxes that meet theirs, clearly more so than as they are written."""
    return np.asarray((ious >= MET_IOU) & (ious > than + _MARGIN_IOU))


def is_clear(num_better: int, num_worse: int, total: int) -> bool:
    """Whether another convention is believed: it serves many more boxes than it spoils.

    Boxes at random, as of a detector that finds nothing, are served and spoiled equally often: the
    rule holds by chance once in 30 times for 5 objects, and once in 300 for 15.
    """
    return num_better >= 4 * num_worse + 5 and num_better >= _LEAST_SHARE * total

"""Boxes of results and labels as arrays, and tests of the convention in which they are written."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from sightline.data.formats.kitti_labels import NO_LOCATION, KittiObjects

MIN_RESULTS: Final = 5
"""Minimum number of objects for a median or a comparison."""
MATCH_IOU: Final = 0.5
"""Minimum IoU of two 2D boxes of one object."""
_IOU_MARGIN: Final = 0.1
"""Difference of IoU from which one convention fits a box better than another one."""
_MIN_SHARE: Final = 0.2
"""Minimum share of the boxes that another convention must fit better."""
SCORED_CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
"""Classes that KITTI scores; they stand on the road."""

Boxes = Float64[np.ndarray, "num_boxes 4"]
Angles = Float64[np.ndarray, " num"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ScoredBoxes:
    """Boxes of the classes that KITTI scores, of one frame or of all."""

    names: Shaped[np.ndarray, " num_boxes"]
    """Class names, capitalised."""
    scores: Float64[np.ndarray, " num_boxes"]
    """Scores; zeros for labels."""
    boxes2d: Float64[np.ndarray, "num_boxes 4"]
    sizes_hwl: Float64[np.ndarray, "num_boxes 3"]
    """Height, width, length [m]; NaN without a 3D part, as the locations."""
    locations: Float64[np.ndarray, "num_boxes 3"]
    rotations_y: Float64[np.ndarray, " num_boxes"]
    alphas: Float64[np.ndarray, " num_boxes"]
    """Angles as in the file, with KITTI's placeholders."""

    @property
    def has_3d(self) -> Bool[np.ndarray, " num_boxes"]:
        """Mask of the boxes with a 3D part."""
        return np.asarray(np.isfinite(self.locations).all(axis=1))

    def select(self, kept: Bool[np.ndarray, " num_boxes"]) -> "ScoredBoxes":
        """Select boxes by a mask."""
        columns = {field.name: getattr(self, field.name)[kept] for field in fields(self)}
        return ScoredBoxes(**columns)

    def num_repeated(self) -> int:
        """Count the boxes equal to an earlier one, if they are of one frame."""
        rows = np.column_stack((self.scores, self.boxes2d, self.locations))
        named = zip(self.names.tolist(), rows, strict=True)
        return len(rows) - len({(name, row.tobytes()) for name, row in named})


def scored_boxes(objects: KittiObjects) -> ScoredBoxes:
    """Select the objects of scored classes."""
    names = np.array([name.capitalize() for name in objects.class_names], dtype=object)
    kept = np.isin(names, SCORED_CLASSES)
    lacks_3d = (objects.dimensions_hwl <= 0).any(axis=1)
    lacks_3d |= (objects.locations == NO_LOCATION).any(axis=1)
    scores = np.zeros(len(names)) if objects.scores is None else objects.scores
    return ScoredBoxes(
        names=names[kept],
        scores=scores[kept],
        boxes2d=objects.boxes2d[kept],
        sizes_hwl=np.where(lacks_3d[:, None], np.nan, objects.dimensions_hwl)[kept],
        locations=np.where(lacks_3d[:, None], np.nan, objects.locations)[kept],
        rotations_y=objects.rotation_y[kept],
        alphas=objects.alpha[kept],
    )


def join_boxes(frames: Sequence[ScoredBoxes]) -> ScoredBoxes:
    """Concatenate the boxes of frames, at least one."""
    return ScoredBoxes(
        **{
            field.name: np.concatenate([getattr(each, field.name) for each in frames])
            for field in fields(ScoredBoxes)
        }
    )


def _from_corner_and_size(boxes: Boxes) -> Boxes:
    return np.concatenate((boxes[:, :2], boxes[:, :2] + boxes[:, 2:]), axis=1)


def _from_centre_and_size(boxes: Boxes) -> Boxes:
    half = boxes[:, 2:] / 2
    return np.concatenate((boxes[:, :2] - half, boxes[:, :2] + half), axis=1)


BOX2D_CONVENTIONS: Final[Mapping[str, Callable[[Boxes], Boxes]]] = {
    "y_min, x_min, y_max, x_max": lambda boxes: boxes[:, [1, 0, 3, 2]],
    "x_min, y_min, width, height": _from_corner_and_size,
    "centre x, centre y, width, height": _from_centre_and_size,
    "pixels of an image of half the size": lambda boxes: 2 * boxes,
    "pixels of an image of twice the size": lambda boxes: boxes / 2,
}
"""Conversions to x_min, y_min, x_max, y_max [px], by the convention of the boxes."""

ROTATIONS: Final[Mapping[str, Callable[[Angles], Angles]]] = {
    "negated": lambda angles: -angles,
    "the LiDAR frame's yaw": lambda angles: -np.pi / 2 - angles,
    "a quarter turn too large": lambda angles: angles - np.pi / 2,
    "a quarter turn too small": lambda angles: angles + np.pi / 2,
}
"""Conversions to rotation_y, by what is written in its place."""
ROTATION_CONVENTION: Final = (
    "KITTI's is 0 towards x and positive from z to x, clockwise from above."
)


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


def angle_between(
    angles: Float64[np.ndarray, " num"],
    others: Float64[np.ndarray, " num"],
    *,
    period: float = 2 * np.pi,
) -> Float64[np.ndarray, " num"]:
    """Compute the absolute difference [rad] of angles that repeat after `period`."""
    apart = (angles - others + period / 2) % period - period / 2
    return np.asarray(np.abs(apart))


def matches_better(
    ious: Float64[np.ndarray, " num"], other_ious: Float64[np.ndarray, " num"]
) -> Bool[np.ndarray, " num"]:
    """Mask of the boxes with `MATCH_IOU` in one convention and clearly less in another one."""
    return np.asarray((ious >= MATCH_IOU) & (ious > other_ious + _IOU_MARGIN))


def is_clearly_better(num_better: int, num_worse: int, total: int) -> bool:
    """Check if boxes match labels, or each other, much more often in another convention.

    Random boxes, as of a detector that finds nothing, fit better and worse equally often: the rule
    holds by chance once in 30 times for 5 objects, and once in 300 for 15.
    """
    return num_better >= 4 * num_worse + 5 and num_better >= _MIN_SHARE * total


def best_reading(
    written: Float64[np.ndarray, " num"], readings: Mapping[str, Float64[np.ndarray, " num"]]
) -> str | None:
    """Choose the first convention that fits clearly better than the boxes as they are written.

    A later one is taken in its place if it fits clearly better again.

    Args:
        written: IoU of each box with what it is compared with, as it is written.
        readings: These IoUs by convention.
    """
    best, ious = None, written
    for name, others in readings.items():
        better = int(matches_better(others, ious).sum())
        if is_clearly_better(better, int(matches_better(ious, others).sum()), len(ious)):
            best, ious = name, others
    return best

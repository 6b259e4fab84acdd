"""Doubt about truncations of labels that are no shares of the object outside the image."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.kitti_labels import CLASS_NAMES, UNKNOWN, KittiObjects

TRUNCATION_REMEDY: Final = (
    "write the share of each object outside the image, 0 to 1, or 0 where it is not known"
)

_MIN_TRUNCATED: Final = 5
_BORDER_SHARE: Final = 0.02
"""Distance from the image's border, as a share of the image, within which boxes may be cut off."""
_SIZE_QUANTILE: Final = 0.98
"""Quantile of the boxes' ends that counts as the image's size: few boxes reach beyond the image."""


@dataclass(slots=True)
class TruncationTally:
    """Counts of the truncations in label files.

    KITTI's are shares: 5,003 of its 40,570 training objects have fractions, 388 have a 1. Flags (of
    moving objects in View-of-Delft), levels and track numbers in this column are whole numbers, and
    objects with them lie anywhere in the image.
    """

    num_objects: int = 0
    has_fraction: bool = False
    truncated_boxes: list[Float64[np.ndarray, "num_objects 4"]] = field(default_factory=list)
    """2D boxes [px] with a truncation of 1 or more."""
    ends: list[Float64[np.ndarray, "num_objects 2"]] = field(default_factory=list)
    """x_max, y_max [px] of all boxes, which hardly exceed the image's size."""

    def add(self, objects: KittiObjects) -> None:
        """Count a frame."""
        is_known = np.isin(np.array(objects.class_names, dtype=object), CLASS_NAMES)
        is_known &= objects.truncation != UNKNOWN
        truncations, boxes = objects.truncation[is_known], objects.boxes2d[is_known]
        self.num_objects += len(truncations)
        self.has_fraction |= bool((truncations % 1).any())
        self.truncated_boxes.append(boxes[truncations >= 1])
        self.ends.append(boxes[:, 2:])

    def doubt(self) -> str | None:
        """Describe whole numbers in place of shares, after "labels"; None: there is no doubt."""
        if self.has_fraction or not self.num_objects:
            return None
        boxes = np.concatenate(self.truncated_boxes)
        size = np.quantile(np.concatenate(self.ends), _SIZE_QUANTILE, axis=0, method="higher")
        border = _BORDER_SHARE * size
        is_inside = (boxes[:, :2] > border).all(axis=1)
        is_inside &= (boxes[:, 2:] < size - border).all(axis=1)
        num_inside = int(is_inside.sum())
        if len(boxes) < _MIN_TRUNCATED or 2 * num_inside < len(boxes):
            return None
        return (
            f"give {len(boxes):,} of {self.num_objects:,} objects a truncation of 1 or more and "
            f"none a fraction, though {num_inside:,} of these end inside the image: they are "
            "probably flags, levels or track numbers"
        )

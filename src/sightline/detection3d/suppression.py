"""Suppression of refined boxes: score threshold and NMS."""

import math
from dataclasses import dataclass

from jaxtyping import Float, Int64
from torch import Tensor

from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.nms import nms_bev


@dataclass(frozen=True, kw_only=True)
class SuppressionConfig:
    """Settings that turn the second stage's boxes into detections."""

    min_score: float = 0.3
    """Boxes with a lower score are removed."""
    iou: float = 0.1
    """IoU from above from which a box with a lower score is removed."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0 <= self.min_score <= 1:
            raise ValueError(f"min_score must be from 0 to 1, got {self.min_score}")
        if not 0 < self.iou <= 1:
            raise ValueError(f"iou must be above 0 and at most 1, got {self.iou}")


def suppress_boxes(
    boxes: Float[Tensor, "num_boxes 7"],
    scores: Float[Tensor, " num_boxes"],
    config: SuppressionConfig = SuppressionConfig(),
    *,
    labels: Int64[Tensor, " num_boxes"] | None = None,
) -> Int64[Tensor, " kept"]:
    """Select the boxes that stay: indices by descending score; equal scores in their order.

    The IoU is computed from above: two road users do not stand over each other, and a wrong height
    must not save a duplicate.

    Args:
        boxes: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        scores: Confidence from 0 to 1.
        config: Thresholds.
        labels: Boxes with different labels do not suppress each other. None: one label for all.

    Raises:
        ValueError: A score is NaN, or a box is not finite or has a negative size.
    """
    is_unsure = scores < config.min_score  # False for NaN, which `nms_bev` refuses
    sure = (~is_unsure).nonzero()[:, 0]
    kept = nms_bev(
        Boxes3D(boxes[sure]).bev,
        scores[sure],
        math.nextafter(config.iou, 0.0),  # `nms_bev` keeps an equal IoU
        labels=None if labels is None else labels[sure],
    )
    return sure[kept]

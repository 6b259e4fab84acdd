"""Suppression of overlapping boxes, and their alignment to other sensors' labels."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.checks import check_numbers
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.ranges import check_range
from sightline.ops.nms import nms_bev
from sightline.structures.predictions import Detections3D


@dataclass(frozen=True, kw_only=True)
class SuppressionConfig:
    """Settings that turn the second stage's boxes into detections."""

    min_score: float = 0.05
    """Boxes with a lower score are removed."""
    iou: float = 0.1
    """IoU from above from which a box with a lower score is removed."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "from 0 to 1", "min_score")
        check_numbers(self, "above 0 and at most 1", "iou")


def suppress_boxes(
    boxes: Float[Tensor, "num_boxes 7"],
    scores: Float[Tensor, " num_boxes"],
    config: SuppressionConfig = SuppressionConfig(),
    *,
    labels: Int64[Tensor, " num_boxes"] | None = None,
) -> Int64[Tensor, " kept"]:
    """Select the boxes that stay: indices by descending score; equal scores in their order.

    The IoU is computed from above: two road users do not stand over each other, and a wrong height
    must not save a duplicate. Boxes with different labels do not suppress each other.

    Raises:
        ValueError: A score is NaN, or a box is not finite or has a negative size.
    """
    is_below = scores < config.min_score  # False for NaN, which `nms_bev` refuses
    candidates = (~is_below).nonzero()[:, 0]
    kept = nms_bev(
        Boxes3D(boxes[candidates]).bev,
        scores[candidates],
        math.nextafter(config.iou, 0.0),  # `nms_bev` keeps an equal IoU
        labels=None if labels is None else labels[candidates],
    )
    return candidates[kept]


_LONGEST_M, _SHORTEST_BOX_M = 10.0, 0.1


@dataclass(frozen=True, kw_only=True)
class ClassAlignment:
    """Correction of one class's boxes towards the target labels."""

    name: str
    """Name of the class, such as Car."""
    length_m: float = 0.0
    """Length added to each box."""
    towards_m: float = 0.0
    """Distance that the centre moves towards the LiDAR along the box's own axis, times the absolute
    cosine of the angle between that axis and the direction to the LiDAR."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in (("length_m", self.length_m), ("towards_m", self.towards_m)):
            check_range(f"alignment.{name}", value, -_LONGEST_M, _LONGEST_M)


def align(found: Detections3D, alignments: Sequence[ClassAlignment]) -> Detections3D:
    """Move and resize detections (LiDAR frame), with one correction for each class.

    Wang et al. 2020 (Train in Germany, Test in the USA) add the mean size difference of two data
    sets to a detector's boxes. Here boxes are also moved along their axes.
    """
    boxes = found.boxes.tensor.clone()
    for alignment in alignments:
        chosen = torch.tensor(
            [name == alignment.name for name in found.class_names], dtype=torch.bool
        )
        each = boxes[chosen]
        each[:, 3] = (each[:, 3] + alignment.length_m).clamp(min=_SHORTEST_BOX_M)
        ahead = torch.stack((each[:, 6].cos(), each[:, 6].sin()), dim=1)
        away = torch.nn.functional.normalize(each[:, :2], dim=1)
        along = (ahead * away).sum(dim=1, keepdim=True)
        each[:, :2] -= alignment.towards_m * along * ahead
        boxes[chosen] = each
    return Detections3D(class_names=found.class_names, boxes=Boxes3D(boxes), scores=found.scores)

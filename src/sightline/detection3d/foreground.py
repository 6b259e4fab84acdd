"""Which points lie on objects: the first stage's segmentation, its truth and its loss."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from sightline.ops.points_in_boxes import first_box_of_points

BACKGROUND = -1
"""Class of points on no object."""
IGNORED = -2
"""Class of points so close to an object that they may or may not be of it."""


class PointTargets(NamedTuple):
    """What each point is to be."""

    point_class: Int64[Tensor, "batch num_points"]
    """Of the object that the point lies on, or BACKGROUND, or IGNORED."""
    box: Int64[Tensor, "batch num_points"]
    """Place of that object among the frame's boxes; -1 where there is none."""


def point_targets(
    points: Float[Tensor, "batch num_points 3"],
    boxes: Float[Tensor, "batch num_boxes 7"],
    box_classes: Int64[Tensor, "batch num_boxes"],
    *,
    ignored_margin_m: float = 0.2,
) -> PointTargets:
    """Objects of the points: Shi et al. 2019 (PointRCNN), section 3.1.

    A point in several boxes is of the first. Points outside all boxes, but within the margin of
    one, are ignored: labels are no more exact than that. Rows of zeros, which fill up frames with
    fewer objects, hold nothing.

    Args:
        points: LiDAR frame [m].
        boxes: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        box_classes: Numbers from 0, or IGNORED for boxes whose points count nowhere.
        ignored_margin_m: How far around boxes points are ignored.

    Raises:
        ValueError: A value is not finite or a size negative.
    """
    box = first_box_of_points(points, boxes)
    exists = (boxes[..., 3:6] > 0).all(dim=-1, keepdim=True)
    sizes = torch.where(exists, boxes[..., 3:6] + 2 * ignored_margin_m, 0.0)
    around = first_box_of_points(points, torch.cat((boxes[..., :3], sizes, boxes[..., 6:]), dim=-1))
    nothing = torch.where(around >= 0, IGNORED, BACKGROUND)
    if boxes.shape[1] == 0:
        return PointTargets(nothing, box)
    point_class = torch.where(box >= 0, box_classes.gather(1, box.clamp(min=0)), nothing)
    return PointTargets(point_class, box)


@dataclass(frozen=True, kw_only=True)
class FocalLossConfig:
    """How much the few points on objects count against the many that are easy."""

    alpha: float = 0.25
    """Weight of points on objects; background has the rest to 1."""
    gamma: float = 2.0
    """How fast the weight of what is already right falls."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha must be from 0 to 1, got {self.alpha}")
        if not 0 <= self.gamma < math.inf:
            raise ValueError(f"gamma must be finite and not negative, got {self.gamma}")


def focal_loss(
    logits: Float[Tensor, "*shape num_classes"],
    point_class: Int64[Tensor, "*shape"],
    config: FocalLossConfig = FocalLossConfig(),
) -> Float[Tensor, ""]:
    """Sum of the sigmoid focal losses over the number of points on objects, or over 1.

    Lin et al. 2017 (RetinaNet), eq. 5. Each class is told from all else by itself; ignored points
    count nowhere.

    Args:
        logits: For each class.
        point_class: As `point_targets` gives it.
        config: Weights.
    """
    classes = torch.arange(logits.shape[-1], device=logits.device)
    is_class = (point_class[..., None] == classes).to(logits.dtype)
    entropy = binary_cross_entropy_with_logits(logits, is_class, reduction="none")
    probability = logits.sigmoid()
    wrong = torch.where(is_class > 0, 1 - probability, probability)
    # Where it is 0 a power below 1 has no finite slope.
    wrong = wrong.clamp(min=torch.finfo(wrong.dtype).tiny)
    balance = torch.where(is_class > 0, config.alpha, 1 - config.alpha)
    counts = (point_class != IGNORED)[..., None]
    weighted = torch.where(counts, balance * wrong**config.gamma * entropy, 0.0)
    return weighted.sum() / (point_class >= 0).sum().clamp(min=1)


def prior_bias(probability: float = 0.01) -> float:
    """Logit of how likely a point is on an object before anything is learned: section 4.1 there."""
    return -math.log((1 - probability) / probability)

"""Foreground segmentation of the first stage: targets and loss."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from sightline.ops.points_in_boxes import first_box_of_points

BACKGROUND = -1
"""Class of points outside all objects."""
IGNORED = -2
"""Class of points so close to an object that their label is uncertain."""


class PointTargets(NamedTuple):
    """Target of each point."""

    point_class: Int64[Tensor, "batch num_points"]
    """Class of the object that contains the point, or BACKGROUND, or IGNORED."""
    box: Int64[Tensor, "batch num_points"]
    """Index of that object among the frame's boxes; -1 if there is none."""


def point_targets(
    points: Float[Tensor, "batch num_points 3"],
    boxes: Float[Tensor, "batch num_boxes 7"],
    box_classes: Int64[Tensor, "batch num_boxes"],
    *,
    ignored_margin_m: float = 0.2,
) -> PointTargets:
    """Assign points to objects: Shi et al. 2019 (PointRCNN), section 3.1.

    A point in several boxes belongs to the first. Points outside all boxes but within the margin of
    one are ignored, because labels are no more exact than that. Rows of zeros, which pad frames
    with fewer objects, contain no points.

    Args:
        points: LiDAR frame [m].
        boxes: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        box_classes: Class numbers from 0, or IGNORED for boxes whose points count nowhere.
        ignored_margin_m: Width of the ignored zone around boxes.

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
    """Focal loss settings, which balance few foreground points against many easy ones."""

    alpha: float = 0.25
    """Weight of foreground points; background points have 1 - alpha."""
    gamma: float = 2.0
    """Focusing exponent: how fast the weight of correct predictions falls."""

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
    """Sum of the sigmoid focal losses over the number of foreground points, or over 1.

    Lin et al. 2017 (RetinaNet), eq. 5. Each class is a binary decision; ignored points count
    nowhere.

    Args:
        logits: Logits of each class.
        point_class: Output of `point_targets`.
        config: Weights.
    """
    classes = torch.arange(logits.shape[-1], device=logits.device)
    is_class = (point_class[..., None] == classes).to(logits.dtype)
    entropy = binary_cross_entropy_with_logits(logits, is_class, reduction="none")
    probability = logits.sigmoid()
    wrong = torch.where(is_class > 0, 1 - probability, probability)
    # At 0, a power below 1 has no finite slope.
    wrong = wrong.clamp(min=torch.finfo(wrong.dtype).tiny)
    balance = torch.where(is_class > 0, config.alpha, 1 - config.alpha)
    counts = (point_class != IGNORED)[..., None]
    weighted = torch.where(counts, balance * wrong**config.gamma * entropy, 0.0)
    return weighted.sum() / (point_class >= 0).sum().clamp(min=1)


def prior_bias(probability: float = 0.01) -> float:
    """Initial logit for a prior foreground probability: Lin et al. 2017, section 4.1."""
    return -math.log((1 - probability) / probability)

"""Training losses of the compact second stage: boxes, fronts and qualities."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from sightline.detection3d.box_corners import corner_costs
from sightline.detection3d.quality import quality_of_iou
from sightline.detection3d.region_coding import decode_regions, encode_regions, keeps_front
from sightline.detection3d.region_network import RegionOutput
from sightline.ops.rotated_iou import aligned_iou_3d


@dataclass(frozen=True, kw_only=True)
class RegionLossConfig:
    """Weights of the second stage's losses."""

    value_weight: float = 1.0
    """Weight of the loss on the box code."""
    corner_weight: float = 4.0
    """Weight of the corner loss; 0: no corner loss."""
    front_weight: float = 1.0
    """Weight of the loss on the front."""
    quality_weight: float = 0.5
    """Weight of the loss on the predicted IoU."""
    knee: float = 0.25
    """Error of the code where the loss changes from quadratic to linear."""
    corner_knee_m: float = 0.05
    """The same knee for the corner loss."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("value_weight", "corner_weight", "front_weight", "quality_weight"):
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ValueError(f"{name} must be finite and not negative, got {value}")
        for name in ("knee", "corner_knee_m"):
            value = getattr(self, name)
            if not 0 < value < float("inf"):
                raise ValueError(f"{name} must be positive and finite, got {value}")


class RegionLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    values: Float[Tensor, ""]
    corners: Float[Tensor, ""]
    front: Float[Tensor, ""]
    quality: Float[Tensor, ""]


def region_loss(
    output: RegionOutput,
    proposals: Float[Tensor, "num_regions 7"],
    truths: Float[Tensor, "num_regions 7"],
    is_object: Bool[Tensor, " num_regions"],
    config: RegionLossConfig = RegionLossConfig(),
) -> RegionLosses:
    """Compute the loss of regions: box changes of those on objects (mean), and qualities of all.

    The quality target is the IoU of the currently decoded box (soft label), and 0 without an
    object; it has no gradient for the boxes. Without objects, the other losses and their gradients
    are 0; without regions, all are.

    Args:
        output: Output of the network.
        proposals: Boxes of the regions: x, y, z, length, width, height, yaw.
        truths: The objects' boxes; any values where there is none.
        is_object: Mask of the regions with an object.
        config: Weights.
    """
    values, proposed = output.values[is_object], proposals[is_object].to(output.values.dtype)
    truth = truths[is_object].to(values.dtype)
    kept = keeps_front(truth, proposed)
    changed = decode_regions(values, kept, proposed)
    error = F.smooth_l1_loss(
        values, encode_regions(truth, proposed), reduction="none", beta=config.knee
    )
    front = F.binary_cross_entropy_with_logits(
        output.front_logits[is_object], kept.to(values.dtype), reduction="sum"
    )
    quality = torch.zeros_like(output.quality_logits)
    with torch.no_grad():
        quality[is_object] = quality_of_iou(aligned_iou_3d(changed, truth))
    rated = F.binary_cross_entropy_with_logits(output.quality_logits, quality, reduction="sum")
    number = max(len(values), 1)
    corners = corner_costs(changed, truth, knee_m=config.corner_knee_m).sum() / number
    parts = (error.sum() / number, corners, front / number, rated / max(len(quality), 1))
    total = (
        config.value_weight * parts[0]
        + config.corner_weight * parts[1]
        + config.front_weight * parts[2]
        + config.quality_weight * parts[3]
    )
    return RegionLosses(total, *parts)

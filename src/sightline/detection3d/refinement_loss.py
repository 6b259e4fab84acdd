"""Training losses of the plain second stage: boxes and confidence."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, smooth_l1_loss


@dataclass(frozen=True, kw_only=True)
class RefinementLossConfig:
    """IoU thresholds and the weight of the size."""

    foreground_iou: float = 0.55
    """3D IoU from which a proposal's box is trained."""
    size_weight: float = 3.0
    """Weight of the size in the sum of the box's parts."""
    positive_iou: float = 0.6
    """3D IoU from which a proposal is positive for the confidence."""
    negative_iou: float = 0.45
    """3D IoU up to which a proposal is negative; between the two it is unused."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0 <= self.negative_iou < self.positive_iou <= 1:
            raise ValueError(
                "negative_iou must be below positive_iou and both from 0 to 1, got "
                f"{self.negative_iou} and {self.positive_iou}"
            )
        if not 0 <= self.foreground_iou <= 1:
            raise ValueError(f"foreground_iou must be from 0 to 1, got {self.foreground_iou}")
        if not 0 <= self.size_weight < float("inf"):
            raise ValueError(f"size_weight must be finite and not negative, got {self.size_weight}")


class BoxLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    """location + size_weight * size + rotation."""
    location: Float[Tensor, ""]
    size: Float[Tensor, ""]
    rotation: Float[Tensor, ""]


def box_loss(
    predicted: Float[Tensor, "num_samples 7"],
    target: Float[Tensor, "num_samples 7"],
    iou: Float[Tensor, " num_samples"],
    config: RefinementLossConfig = RefinementLossConfig(),
) -> BoxLosses:
    """Smooth L1 (Girshick 2015, beta 1) of foreground boxes: the mean of each part.

    Boxes are x, y, z, length, width, height, yaw. Yaws are compared as numbers: two that differ by
    a full turn count as different. Without foreground, all losses and gradients are 0.

    Args:
        predicted: Output of the network.
        target: The assigned objects' boxes.
        iou: 3D IoU of proposal and object.
        config: Threshold and weight.
    """
    is_foreground = iou >= config.foreground_iou
    given, wanted = predicted[is_foreground], target[is_foreground].to(predicted.dtype)
    error = smooth_l1_loss(given, wanted, reduction="none")
    count = is_foreground.sum().clamp(min=1)
    location, size = error[:, :3].sum() / (3 * count), error[:, 3:6].sum() / (3 * count)
    rotation = error[:, 6].sum() / count
    return BoxLosses(location + config.size_weight * size + rotation, location, size, rotation)


def confidence_loss(
    logits: Float[Tensor, " num_samples"],
    iou: Float[Tensor, " num_samples"],
    config: RefinementLossConfig = RefinementLossConfig(),
) -> Float[Tensor, ""]:
    """Mean binary cross entropy: target 1 for a high enough IoU, 0 for a low enough one.

    Proposals in between are unused; if all are, loss and gradient are 0.

    Args:
        logits: Output of the network.
        iou: 3D IoU of proposal and assigned object.
        config: Thresholds.
    """
    is_positive = iou >= config.positive_iou
    counts = is_positive | (iou <= config.negative_iou)
    given, wanted = logits[counts], is_positive[counts].to(logits.dtype)
    total = binary_cross_entropy_with_logits(given, wanted, reduction="sum")
    return total / torch.clamp(counts.sum(), min=1)

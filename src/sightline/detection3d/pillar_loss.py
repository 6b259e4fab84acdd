"""Training losses of the compact first stage: heat, boxes, fronts and qualities."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from sightline.detection3d.box_corners import corner_costs
from sightline.detection3d.center_coding import (
    AXIS,
    FRONT,
    QUALITY,
    cell_middles,
    decode_centers,
    encode_centers,
)
from sightline.detection3d.pillar_config import PillarNetworkConfig
from sightline.detection3d.pillar_network import PillarOutput
from sightline.detection3d.pillar_targets import PillarTargets
from sightline.detection3d.quality import quality_of_iou
from sightline.ops.rotated_iou import aligned_iou_3d

_FOCUS, _NEAR_FOCUS = 2, 4  # exponents of the heat loss, as published


@dataclass(frozen=True, kw_only=True)
class PillarLossConfig:
    """Weights of the first stage's losses."""

    heat_weight: float = 1.0
    """Weight of the focal loss."""
    box_weight: float = 1.0
    """Weight of the loss on centre, sizes and axis."""
    corner_weight: float = 2.0
    """Weight of the corner loss."""
    front_weight: float = 2.0
    """Weight of the loss on the front."""
    quality_weight: float = 0.3
    """Weight of the loss on the predicted IoU."""
    knee: float = 0.05
    """Error where the loss changes from quadratic to linear; for corners twice this, in metres."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in (
            "heat_weight",
            "box_weight",
            "corner_weight",
            "front_weight",
            "quality_weight",
        ):
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ValueError(f"{name} must be finite and not negative, got {value}")
        if not 0 < self.knee < float("inf"):
            raise ValueError(f"knee must be positive and finite, got {self.knee}")


class PillarLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    heat: Float[Tensor, ""]
    box: Float[Tensor, ""]
    corners: Float[Tensor, ""]
    front: Float[Tensor, ""]
    quality: Float[Tensor, ""]


def pillar_loss(
    output: PillarOutput,
    targets: PillarTargets,
    network: PillarNetworkConfig,
    config: PillarLossConfig = PillarLossConfig(),
) -> PillarLosses:
    """Compute the loss of a batch, divided by the number of its objects.

    Without objects, all parts but the heat are 0, and so are their gradients. The quality target is
    the IoU of the current boxes; its loss has no gradient for the boxes.

    Args:
        output: Output of the network.
        targets: Ground truth.
        network: The network's settings.
        config: Weights.
    """
    heat = heat_loss(output.heat_logits, targets.heat, targets.counts)
    sweep, of_class, row, column = targets.cells.unbind(dim=1)
    values = output.center_values[sweep, of_class, :, row, column]
    middles = cell_middles(targets.cells[:, 2:], network.grid).to(values.dtype)
    mean_sizes = values.new_tensor([entry.mean_size_m for entry in network.classes])[of_class]
    truth = targets.boxes.to(values.dtype)
    wanted = encode_centers(truth, middles, mean_sizes)
    told = decode_centers(values, middles, mean_sizes)
    error = F.smooth_l1_loss(
        values[:, : AXIS.stop], wanted[:, : AXIS.stop], reduction="none", beta=config.knee
    )
    with torch.no_grad():
        quality = quality_of_iou(aligned_iou_3d(told, truth))
    costs = (
        error.sum(dim=1),
        corner_costs(told, truth, knee_m=2 * config.knee),
        (values[:, FRONT] - wanted[:, FRONT]).square().sum(dim=1),
        F.binary_cross_entropy_with_logits(values[:, QUALITY], quality, reduction="none"),
    )
    weights = targets.weights.to(values.dtype)
    number = weights.sum().clamp(min=1)
    box, corners, front, rated = ((cost * weights).sum() / number for cost in costs)
    total = (
        config.heat_weight * heat
        + config.box_weight * box
        + config.corner_weight * corners
        + config.front_weight * front
        + config.quality_weight * rated
    )
    return PillarLosses(total, heat, box, corners, front, rated)


def heat_loss(
    logits: Float[Tensor, "*shape"],
    heat: Float[Tensor, "*shape"],
    counts: Bool[Tensor, "*shape"],
) -> Float[Tensor, ""]:
    """Focal loss of heat over the number of centres, or over 1: Law and Deng 2018, eq. 1.

    High heat costs less in cells near a centre. Cells with unknown heat do not count.
    """
    score = logits.sigmoid()
    is_center = heat == 1
    cold = (1 - heat) ** _NEAR_FOCUS * score**_FOCUS * F.logsigmoid(-logits)
    cost = -torch.where(is_center, (1 - score) ** _FOCUS * F.logsigmoid(logits), cold)
    number = (is_center & counts).sum().clamp(min=1)
    return torch.where(counts, cost, 0.0).sum() / number

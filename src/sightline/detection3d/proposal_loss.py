"""Training losses of the point first stage: segmentation and boxes."""

from dataclasses import dataclass, field
from typing import NamedTuple

from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn.functional import cross_entropy, smooth_l1_loss

from sightline.detection3d.box_coding import (
    BoxCode,
    BoxPrediction,
    at_bin,
    encode_boxes,
    split_prediction,
)
from sightline.detection3d.foreground import FocalLossConfig, focal_loss, point_targets
from sightline.detection3d.proposal_network import ProposalNetworkConfig, ProposalNetworkOutput


@dataclass(frozen=True, kw_only=True)
class ProposalLossConfig:
    """Weights of the first stage's losses."""

    focal: FocalLossConfig = field(default_factory=FocalLossConfig)
    """Focal loss of the segmentation."""
    size_weight: float = 3.0
    """Weight of the size loss relative to centre and heading."""
    ignored_margin_m: float = 0.2
    """Margin around boxes in which points are ignored."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 0 <= self.ignored_margin_m < float("inf"):
            raise ValueError(
                f"ignored_margin_m must be finite and not negative, got {self.ignored_margin_m}"
            )
        if not 0 <= self.size_weight < float("inf"):
            raise ValueError(f"size_weight must be finite and not negative, got {self.size_weight}")


class ProposalLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    """segmentation + center + heading + size_weight * size."""
    segmentation: Float[Tensor, ""]
    center: Float[Tensor, ""]
    heading: Float[Tensor, ""]
    size: Float[Tensor, ""]


def proposal_loss(
    output: ProposalNetworkOutput,
    points: Float[Tensor, "batch num_points 3"],
    boxes: Float[Tensor, "batch num_boxes 7"],
    box_classes: Int64[Tensor, "batch num_boxes"],
    network: ProposalNetworkConfig,
    config: ProposalLossConfig = ProposalLossConfig(),
) -> ProposalLosses:
    """Compute the loss of a batch: segmentation of all points, boxes of the foreground points.

    Args:
        output: Output of the network.
        points: LiDAR frame [m].
        boxes: x, y, z, length, width, height, yaw of the labelled objects (LiDAR frame, metres,
            radians); rows of zeros pad frames with fewer.
        box_classes: Indices of their classes in the network, or IGNORED.
        network: The network's settings.
        config: Weights.

    Raises:
        ValueError: A point or box is not finite, or a size negative.
    """
    targets = point_targets(points, boxes, box_classes, ignored_margin_m=config.ignored_margin_m)
    segmentation = focal_loss(output.class_logits, targets.point_class, config.focal)
    sweep, point = (targets.point_class >= 0).nonzero(as_tuple=True)
    mean_sizes = points.new_tensor([entry.mean_size_m for entry in network.classes])
    code = encode_boxes(
        boxes[sweep, targets.box[sweep, point]],
        points[sweep, point],
        mean_sizes[targets.point_class[sweep, point]],
        network.coding,
    )
    prediction = split_prediction(output.box_values[sweep, point], network.coding)
    told = box_code_loss(prediction, code, config)
    return ProposalLosses(segmentation + told.total, segmentation, *told[1:])


class BoxCodeLosses(NamedTuple):
    """Scalar losses, means over the points; the parts are unweighted."""

    total: Float[Tensor, ""]
    """center + heading + size_weight * size."""
    center: Float[Tensor, ""]
    """Loss of bins and residuals along x and y, and of the offset in z."""
    heading: Float[Tensor, ""]
    """Loss of bin and residual."""
    size: Float[Tensor, ""]


def box_code_loss(
    prediction: BoxPrediction, target: BoxCode, config: ProposalLossConfig = ProposalLossConfig()
) -> BoxCodeLosses:
    """Cross entropy of the bins, smooth L1 of the true bins' residuals.

    The regression loss of Shi et al. 2019 (PointRCNN), section 3.1, with a weight on the size.

    Only foreground points take part. Without any, all losses and gradients are 0.

    Args:
        prediction: Predictions of the foreground points.
        target: Encoded boxes of these points.
        config: Weights.
    """
    center = (
        _bin_loss(prediction.x_bins, target.x_bin)
        + _bin_loss(prediction.y_bins, target.y_bin)
        + _residual_loss(at_bin(prediction.x_residuals, target.x_bin), target.x_residual)
        + _residual_loss(at_bin(prediction.y_residuals, target.y_bin), target.y_residual)
        + _residual_loss(prediction.z_offset[:, 0], target.z_offset)
    )
    residual = at_bin(prediction.heading_residuals, target.heading_bin)
    heading = _bin_loss(prediction.heading_bins, target.heading_bin) + _residual_loss(
        residual, target.heading_residual
    )
    size = _residual_loss(prediction.size_residual, target.size_residual)
    return BoxCodeLosses(center + heading + config.size_weight * size, center, heading, size)


def _bin_loss(scores: Float[Tensor, "n bins"], true_bin: Int64[Tensor, " n"]) -> Float[Tensor, ""]:
    return cross_entropy(scores, true_bin, reduction="sum") / max(len(true_bin), 1)


def _residual_loss(
    predicted: Float[Tensor, "*shape"], target: Float[Tensor, "*shape"]
) -> Float[Tensor, ""]:
    """Mean smooth L1; 0 for empty tensors."""
    total = smooth_l1_loss(predicted, target.to(predicted.dtype), reduction="sum")
    return total / max(predicted.numel(), 1)

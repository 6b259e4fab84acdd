"""Training of the first stage: targets of points, and losses."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, cross_entropy, smooth_l1_loss

from sightline.detection3d.points.box_coding import (
    BoxCode,
    BoxPrediction,
    ProposalNetworkOutput,
    at_bin,
    encode_boxes,
    split_prediction,
)
from sightline.detection3d.points.config import (
    FocalLossConfig,
    ProposalLossConfig,
    ProposalNetworkConfig,
)
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
    with fewer objects, contain no points. Boxes are x, y, z, length, width, height, yaw (LiDAR
    frame, metres, radians); their classes count from 0, or are IGNORED where points count nowhere.
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


def focal_loss(
    logits: Float[Tensor, "*shape num_classes"],
    point_class: Int64[Tensor, "*shape"],
    config: FocalLossConfig,
) -> Float[Tensor, ""]:
    """Sum of the sigmoid focal losses over the number of foreground points, or over 1.

    Lin et al. 2017 (RetinaNet), eq. 5. Each class is a binary decision; ignored points count
    nowhere.
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
    config: ProposalLossConfig,
) -> ProposalLosses:
    """Compute the loss of a batch: segmentation of all points, boxes of the foreground points.

    The other arguments are those of `point_targets`.
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
    code_losses = box_code_loss(prediction, code, config)
    return ProposalLosses(segmentation + code_losses.total, segmentation, *code_losses[1:])


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
    prediction: BoxPrediction, target: BoxCode, config: ProposalLossConfig
) -> BoxCodeLosses:
    """Cross entropy of the bins, smooth L1 of the true bins' residuals.

    The regression loss of Shi et al. 2019 (PointRCNN), section 3.1, with a weight on the size.

    Only foreground points take part. Without any, all losses and gradients are 0.
    """
    bins, residuals = [], []
    for scores, offsets, true_bin, true_offset in zip(
        prediction[:3], prediction[3:6], target[:3], target[3:6], strict=True
    ):
        bins.append(cross_entropy(scores, true_bin, reduction="sum") / max(len(true_bin), 1))
        residuals.append(_residual_loss(at_bin(offsets, true_bin), true_offset))
    height = _residual_loss(prediction.z_offset[:, 0], target.z_offset)
    center = bins[0] + bins[1] + residuals[0] + residuals[1] + height
    heading = bins[2] + residuals[2]
    size = _residual_loss(prediction.size_residual, target.size_residual)
    return BoxCodeLosses(center + heading + config.size_weight * size, center, heading, size)


def _residual_loss(
    predicted: Float[Tensor, "*shape"], target: Float[Tensor, "*shape"]
) -> Float[Tensor, ""]:
    """Mean smooth L1; 0 for empty tensors."""
    total = smooth_l1_loss(predicted, target.to(predicted.dtype), reduction="sum")
    return total / max(predicted.numel(), 1)

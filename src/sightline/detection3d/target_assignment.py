"""Which labelled object each proposal is to become."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from sightline.ops.rotated_iou import pairwise_iou_3d

NO_TRUTH = -1
"""Stands for the object of a proposal in a frame without objects."""


class Assignment(NamedTuple):
    """The object of each proposal."""

    truth: Int64[Tensor, " num_proposals"]
    """Its place among the objects; NO_TRUTH in a frame without any."""
    boxes: Float[Tensor, "num_proposals 7"]
    """Its box; zeros in a frame without objects."""
    iou: Float64[Tensor, " num_proposals"]
    """3D IoU of proposal and object."""


def assign_truths(
    proposals: Float[Tensor, "num_proposals 7"], truths: Float[Tensor, "num_truths 7"]
) -> Assignment:
    """Gives each proposal the object of highest 3D IoU, the first of several, whatever the IoU.

    Boxes are x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).

    Raises:
        ValueError: A box is not finite or has a negative size.
    """
    iou = pairwise_iou_3d(proposals.double(), truths)
    return assign_by_iou(iou, truths)


def assign_by_iou(
    iou: Float64[Tensor, "num_proposals num_truths"], truths: Float[Tensor, "num_truths 7"]
) -> Assignment:
    """The same by IoUs that are known."""
    num_proposals, num_truths = iou.shape
    if num_truths == 0:
        truth = torch.full((num_proposals,), NO_TRUTH, device=iou.device)
        return Assignment(truth, truths.new_zeros(num_proposals, 7), iou.new_zeros(num_proposals))
    truth = first_largest(iou)
    return Assignment(truth, truths[truth], iou.gather(1, truth[:, None])[:, 0])


def first_largest(values: Float64[Tensor, "rows columns"]) -> Int64[Tensor, " rows"]:
    """Place of the largest value of each row, the first of several: argmax leaves that open."""
    place = torch.arange(values.shape[1], device=values.device)
    is_largest = values == values.amax(dim=1, keepdim=True)
    return torch.where(is_largest, place, values.shape[1]).amin(dim=1)

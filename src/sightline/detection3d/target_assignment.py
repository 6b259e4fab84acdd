"""Assignment of labelled objects to proposals."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from sightline.ops.rotated_iou import pairwise_iou_3d

NO_TRUTH = -1
"""Object index of proposals in a frame without objects."""


class Assignment(NamedTuple):
    """Assigned object of each proposal."""

    truth: Int64[Tensor, " num_proposals"]
    """Index of the object; NO_TRUTH in a frame without objects."""
    boxes: Float[Tensor, "num_proposals 7"]
    """Box of the object; zeros in a frame without objects."""
    iou: Float64[Tensor, " num_proposals"]
    """3D IoU of proposal and object."""


def assign_truths(
    proposals: Float[Tensor, "num_proposals 7"], truths: Float[Tensor, "num_truths 7"]
) -> Assignment:
    """Assign each proposal the object of highest 3D IoU, the first of several, whatever the IoU.

    Boxes are x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).

    Raises:
        ValueError: A box is not finite or has a negative size.
    """
    iou = pairwise_iou_3d(proposals.double(), truths)
    return assign_by_iou(iou, truths)


def assign_by_iou(
    iou: Float64[Tensor, "num_proposals num_truths"], truths: Float[Tensor, "num_truths 7"]
) -> Assignment:
    """Assign as `assign_truths` does, from given IoUs."""
    num_proposals, num_truths = iou.shape
    if num_truths == 0:
        truth = torch.full((num_proposals,), NO_TRUTH, device=iou.device)
        return Assignment(truth, truths.new_zeros(num_proposals, 7), iou.new_zeros(num_proposals))
    truth = first_largest(iou)
    return Assignment(truth, truths[truth], iou.gather(1, truth[:, None])[:, 0])


def first_largest(values: Float64[Tensor, "rows columns"]) -> Int64[Tensor, " rows"]:
    """Index of each row's largest value, the first of several: argmax does not define which."""
    place = torch.arange(values.shape[1], device=values.device)
    is_largest = values == values.amax(dim=1, keepdim=True)
    return torch.where(is_largest, place, values.shape[1]).amin(dim=1)

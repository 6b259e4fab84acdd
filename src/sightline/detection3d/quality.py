"""Box quality from IoU, which both stages of the compact design predict."""

from jaxtyping import Float
from torch import Tensor

WORST_IOU, BEST_IOU = 0.25, 0.75  # IoUs of qualities 0 and 1


def quality_of_iou(iou: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Quality target for a 3D IoU: Shi et al. 2020 (PV-RCNN), section 3.3.

    It is 0 up to an IoU of 0.25, 1 from an IoU of 0.75, and linear in between.
    """
    return ((iou - WORST_IOU) / (BEST_IOU - WORST_IOU)).clamp(0, 1)


def iou_of_quality(quality: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Convert a quality to its IoU, from 0.25 to 0.75."""
    return WORST_IOU + (BEST_IOU - WORST_IOU) * quality

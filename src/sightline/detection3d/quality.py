"""How good a box is, as both stages of the compact design learn to tell it: by its IoU."""

from jaxtyping import Float
from torch import Tensor

WORST_IOU, BEST_IOU = 0.25, 0.75  # that qualities of 0 and 1 stand for


def quality_of_iou(iou: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """What a box of a 3D IoU shall be rated: Shi et al. 2020 (PV-RCNN), section 3.3.

    0 up to an IoU of 0.25, 1 from one of 0.75, rising evenly in between.
    """
    return ((iou - WORST_IOU) / (BEST_IOU - WORST_IOU)).clamp(0, 1)


def iou_of_quality(quality: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """The IoU that a quality stands for, from 0.25 to 0.75."""
    return WORST_IOU + (BEST_IOU - WORST_IOU) * quality

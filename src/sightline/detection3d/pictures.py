"""Pictures of sweeps from above, with detections and ground truth."""

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.detection3d.answer_picture import DRAWN_SCORE, LABELLED
from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.structures.predictions import Detections3D
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye, put_boxes_from_above
from sightline.visualization.colors import RGB
from sightline.visualization.lettering import with_title

MIN_IOU = 0.5
"""3D IoU with an object from which a detection is drawn as correct."""

TRUTH: RGB = LABELLED
RIGHT: RGB = (20, 190, 140)
WRONG: RGB = (226, 94, 20)


def training_picture(
    points: Float[Tensor, "num_points 4"],
    found: Detections3D,
    truths: Float[Tensor, "num_objects 7"],
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw objects in white, detections in green if they overlap one by `MIN_IOU`, else orange.

    Args:
        points: LiDAR frame.
        found: Detections.
        truths: Boxes of the labelled objects.
    """
    view = BirdsEyeView()
    picture = draw_birds_eye(points, Boxes3D(truths), ("",) * len(truths), view=view, color=TRUTH)
    sure = found.boxes.tensor[found.scores >= DRAWN_SCORE]
    is_right = torch.zeros(len(sure), dtype=torch.bool)
    if len(sure) and len(truths):
        is_right = pairwise_iou_3d(sure.double(), truths).amax(dim=1) >= MIN_IOU
    for mask, color in ((is_right, RIGHT), (~is_right, WRONG)):
        boxes = Boxes3D(sure[mask])
        put_boxes_from_above(picture, view, boxes, ("",) * len(boxes), color=color)
    return with_title(
        picture, f"from above: labels white, right detections green (IoU {MIN_IOU:g}), false orange"
    )

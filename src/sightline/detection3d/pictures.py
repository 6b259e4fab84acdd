"""Pictures of sweeps with proposals, detections and labels."""

import math
from dataclasses import replace
from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.augmentation.scene_changes import resize
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.structures.level import level_detections, level_sample
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye, put_boxes_from_above
from sightline.visualization.cells import GAP_PX, TITLE_PX, titled_cell
from sightline.visualization.colors import RGB
from sightline.visualization.image import camera_picture, draw_boxes3d, draw_points
from sightline.visualization.lettering import with_title

PROPOSED: Final[RGB] = (150, 156, 166)
LABELLED: Final[RGB] = (245, 245, 245)
RIGHT: Final[RGB] = (20, 190, 140)
WRONG: Final[RGB] = (226, 94, 20)

DRAWN_SCORE: Final = 0.3
"""Score from which proposals and detections are drawn."""
MIN_IOU: Final = 0.5
"""3D IoU with an object from which a detection is drawn as correct."""

_FARTHEST_M = 60.0


def prediction_picture(
    title: str,
    sample: CameraLidarSample,
    proposed: Detections3D,
    found: Detections3D,
    *,
    width_px: int = 900,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw proposals (grey) over detections in the image, and both from above at the right.

    Labels are white, detections have the colours of their classes. Proposals and detections with a
    score below 0.3 are not drawn.

    Args:
        title: Title of the first picture.
        sample: The detector's input; image, sweep and labels may be missing.
        proposed: Output of the first stage.
        found: Final detections.
        width_px: Width of the image.
    """
    height_px = max(round(sample.image_size[0] * width_px / sample.image_size[1]), 1)
    proposed, detections = (
        level_detections(each.filter_by_score(DRAWN_SCORE), sample) for each in (proposed, found)
    )
    sample = level_sample(resize(sample, height_px, width_px))
    image, calibration, labels = camera_picture(sample), sample.calibration, sample.objects
    first = draw_boxes3d(
        image, proposed.boxes, proposed.class_names, calibration, color=PROPOSED, tags=False
    )
    labelled = image
    if labels is not None:
        known = labels.select(labels.has_box3d)
        labelled = draw_boxes3d(
            image, known.boxes3d, known.class_names, calibration, color=LABELLED, tags=False
        )
    second = draw_boxes3d(
        labelled, detections.boxes, detections.class_names, calibration, scores=detections.scores
    )
    seen = np.concatenate(
        (
            titled_cell(title, f"{len(proposed.scores)} proposals", first),
            titled_cell("Detections", f"{len(detections.scores)}; labels are white", second),
        )
    )
    above_px = seen.shape[0] - TITLE_PX - GAP_PX
    view = BirdsEyeView(x_max_m=_FARTHEST_M)
    view = replace(view, pixels_per_m=above_px / (view.x_max_m - view.x_min_m))
    above = labels_from_above(sample, view)
    put_boxes_from_above(above, view, proposed.boxes, proposed.class_names, color=PROPOSED)
    put_boxes_from_above(above, view, detections.boxes, detections.class_names)
    fitted = cv2.resize(above, (above.shape[1], above_px), interpolation=cv2.INTER_AREA)
    cell = titled_cell("From above", "to 60 m", fitted.astype(np.uint8, copy=False))
    return np.concatenate((seen, cell), axis=1)


def labels_from_above(
    sample: CameraLidarSample, view: BirdsEyeView
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a level sample's sweep and labels (white) from above; both may be missing."""
    labels = sample.objects
    known = None if labels is None else labels.select(labels.has_box3d)
    return draw_birds_eye(
        sample.points,
        None if known is None else known.boxes3d,
        () if known is None else known.class_names,
        calibration=sample.calibration,
        image_size=sample.image_size,
        view=view,
        color=LABELLED,
    )


def training_picture(
    points: Float[Tensor, "num_points 4"],
    found: Detections3D,
    truths: Float[Tensor, "num_objects 7"],
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw a scene from above, and below it in 3D, seen from behind and above the LiDAR.

    Objects are white, detections green if they overlap one by `MIN_IOU`, else orange. Everything is
    in one LiDAR frame.
    """
    view, objects = BirdsEyeView(), Boxes3D(truths)
    above = draw_birds_eye(points, objects, ("",) * len(truths), view=view, color=LABELLED)
    height, width = above.shape[1] // 2, above.shape[1]
    behind = behind_and_above(height, width)
    scene = draw_points(np.zeros((height, width, 3), np.uint8), points, behind)
    groups = [(objects, LABELLED)]
    drawn = found.boxes.tensor[found.scores >= DRAWN_SCORE]
    is_right = torch.zeros(len(drawn), dtype=torch.bool)
    if len(drawn) and len(truths):
        is_right = pairwise_iou_3d(drawn.double(), truths).amax(dim=1) >= MIN_IOU
    groups += [(Boxes3D(drawn[is_right]), RIGHT), (Boxes3D(drawn[~is_right]), WRONG)]
    for boxes, color in groups:
        names = ("",) * len(boxes)
        scene = draw_boxes3d(scene, boxes, names, behind, color=color, tags=False)
        if color != LABELLED:
            put_boxes_from_above(above, view, boxes, names, color=color)
    legend = f"labels white, right detections green (IoU {MIN_IOU:g}), false orange"
    return np.concatenate((with_title(above, f"from above: {legend}"), with_title(scene, "in 3D")))


def behind_and_above(height: int, width: int) -> Calibration:
    """Camera 12 m behind the LiDAR and 8 m above it, looking 13 degrees down."""
    down = math.radians(13)
    return camera_at(
        (-12.0, 0.0, 8.0),
        (math.cos(down), 0.0, -math.sin(down)),
        focal_px=1.0 * width,
        size=(height, width),
    )


def camera_at(
    place_m: tuple[float, float, float],
    ahead: tuple[float, float, float],
    *,
    focal_px: float,
    size: tuple[int, int],
) -> Calibration:
    """Calibration of an imagined upright camera for drawing.

    Args:
        place_m: Its centre x, y, z (LiDAR frame).
        ahead: Unit vector of its optical axis (LiDAR frame), not vertical.
        focal_px: Focal length.
        size: Height, width [px] of the picture; the optical axis is at its centre.
    """
    height, width = size
    forward = torch.tensor(ahead, dtype=torch.float64)
    right = torch.linalg.cross(forward, forward.new_tensor([0, 0, 1]))
    right = right / right.norm()
    camera_from_lidar = torch.eye(4, dtype=torch.float64)
    camera_from_lidar[:3, :3] = torch.stack((right, torch.linalg.cross(forward, right), forward))
    place = torch.tensor(place_m, dtype=torch.float64)
    camera_from_lidar[:3, 3] = -camera_from_lidar[:3, :3] @ place
    image_from_camera = torch.tensor(
        [[focal_px, 0, width / 2, 0], [0, focal_px, height / 2, 0], [0, 0, 1, 0]],
        dtype=torch.float64,
    )
    return Calibration(image_from_camera=image_from_camera, camera_from_lidar=camera_from_lidar)

"""Pictures of detections, gates and inputs."""

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.detection2d.answer_picture import DRAWN_SCORE, LABELLED
from sightline.detection2d.batch import DetectionBatch
from sightline.detection2d.config import CLASSES, PostprocessConfig
from sightline.detection2d.placement import Placement
from sightline.detection2d.postprocess import to_detections
from sightline.detection2d.readings import DetectorOutput
from sightline.geometry.boxes2d import Boxes2D
from sightline.visualization.image import draw_boxes2d
from sightline.visualization.lettering import with_title


def gate_picture(
    gate: Float[Tensor, "groups rows columns"], size: tuple[int, int]
) -> UInt8[np.ndarray, "height width"]:
    """Draw a gate in grey at (height, width): 0 is closed, 255 open; mean of groups."""
    levels = (255 * gate.detach().float().mean(dim=0)).round().byte().cpu().numpy()
    stretched = cv2.resize(levels, size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(stretched, dtype=np.uint8)


def training_picture(
    batch: DetectionBatch, output: DetectorOutput, config: PostprocessConfig
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the first sample of a batch, one picture below the other, each with a title.

    From the top: the image with detections, and labels in white; the LiDAR's image (depth, height,
    intensity as red, green, blue); the camera's and the LiDAR's gate, if there are gates.
    """
    size = (batch.image.shape[-2], batch.image.shape[-1])
    seen = Placement(image_size=size, scale_x=1.0, scale_y=1.0)
    found = to_detections(output.scores[0], output.boxes[0], seen, config)
    sure = found.filter_by_score(DRAWN_SCORE)
    truth = batch.targets[0]
    drawn = draw_boxes2d(
        _rgb(batch.image[0]),
        Boxes2D(truth.boxes),
        [CLASSES[index] for index in truth.class_indices.tolist()],
        color=LABELLED,
        tags=False,
    )
    drawn = draw_boxes2d(drawn, sure.boxes, sure.class_names, scores=sure.scores)
    rows = [
        with_title(drawn, f"image: labels white, detections from {DRAWN_SCORE:g} on in colour"),
        with_title(_rgb(batch.lidar[0]), "LiDAR: depth, height, intensity as red, green, blue"),
    ]
    for name, gate in (("camera", output.camera_gate), ("LiDAR", output.lidar_gate)):
        if gate is not None:
            grey = np.repeat(gate_picture(gate[0], size)[..., None], 3, axis=2)
            rows.append(with_title(grey, f"gate of the {name}: black shut, white open"))
    return np.concatenate(rows)


def _rgb(planes: Float[Tensor, "3 height width"]) -> UInt8[np.ndarray, "height width 3"]:
    levels = (planes.detach().float().cpu() * 255).round().to(torch.uint8)
    return np.ascontiguousarray(levels.permute(1, 2, 0).numpy())

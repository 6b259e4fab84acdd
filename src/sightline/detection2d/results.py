"""Files and pictures of 2D detections and gates."""

from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from sightline.data.formats import kitti_labels
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_conversion import (
    check_boxes,
    detections2d_from_kitti,
    kitti_from_detections2d,
)
from sightline.detection2d.config import CLASSES, PostprocessConfig
from sightline.detection2d.fusion import DetectorOutput
from sightline.detection2d.placement import Placement, to_detections
from sightline.detection2d.predictor import DetectionResult
from sightline.detection2d.targets import DetectionBatch
from sightline.geometry.boxes2d import Boxes2D
from sightline.structures.predictions import Detections2D, Perception
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.cells import MUTED, titled_cell
from sightline.visualization.colors import RGB, class_color
from sightline.visualization.image import camera_picture, draw_boxes2d, sweep_picture
from sightline.visualization.lettering import with_title
from sightline.visualization.shares import lay_shares, put_share_legend

DRAWN_SCORE: Final = 0.3
"""Score from which detections are drawn."""
LABELLED: Final[RGB] = (245, 245, 245)
CAMERA_COLOR: Final[RGB] = class_color("Cyclist")
LIDAR_COLOR: Final[RGB] = class_color("Pedestrian")

Masks = tuple[Bool[Tensor, "height width"], Bool[Tensor, "height width"]]
"""Masks of the camera and LiDAR pixels that a corruption may have changed."""

_OUTLINE: RGB = (240, 60, 70)  # none of a gate's colours


def prediction_row(
    title: str,
    sample: CameraLidarSample,
    result: DetectionResult,
    *,
    masks: Masks | None = None,
    width_px: int = 600,
) -> UInt8[np.ndarray, "row_height row_width 3"]:
    """Draw one row of pictures under a title line.

    From the left: the image with detections of score 0.3 or more, labels in white; the camera's
    gate over the image and the LiDAR's gate over the sweep's points, if there are gates.

    Args:
        title: Title of the row.
        sample: The detector's input.
        result: The detector's output.
        masks: Pixels that a corruption may have changed; outlined if they form one part of the
            image.
        width_px: Width of each picture.
    """
    cells = []
    for panel in prediction_panels(sample, result, masks=masks, width_px=width_px):
        is_gate = bool(panel.note)
        cell = titled_cell(panel.name if is_gate else title, panel.note, panel.picture)
        if is_gate:
            put_share_legend(cell, "0", "1", right=width_px, top=9, color=MUTED)
        cells.append(cell)
    return np.concatenate(cells, axis=1)


class PredictionPanel(NamedTuple):
    """Picture of detections or of a gate."""

    name: str
    note: str
    """Mean value of a gate; empty for detections."""
    picture: UInt8[np.ndarray, "height width 3"]


def prediction_panels(
    sample: CameraLidarSample,
    result: DetectionResult,
    *,
    masks: Masks | None = None,
    width_px: int = 600,
) -> list[PredictionPanel]:
    """Draw the single pictures of `prediction_row`."""
    camera_mask, lidar_mask = masks or (None, None)
    image, sweep = (
        scaled_to_width(each, width_px) for each in (camera_picture(sample), sweep_picture(sample))
    )
    found = _draw_detections(_draw_outline(image, camera_mask), sample, result)
    panels = [PredictionPanel("detections", "", found)]
    for name, gate, backdrop, mask in (
        ("camera gate", result.camera_gate, image, camera_mask),
        ("LiDAR gate", result.lidar_gate, sweep, lidar_mask),
    ):
        if gate is not None:
            laid = _draw_outline(lay_shares(backdrop, gate.numpy()), mask)
            panels.append(PredictionPanel(name, f"mean {float(gate.mean()):.2f}", laid))
    return panels


def _draw_detections(
    image: UInt8[np.ndarray, "height width 3"], sample: CameraLidarSample, result: DetectionResult
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw boxes at the picture's final size, so that their tags can be read."""
    scale_y, scale_x = (
        new / old for new, old in zip(image.shape[:2], sample.image_size, strict=True)
    )
    found = result.detections.filter_by_score(DRAWN_SCORE)
    if sample.objects is not None:
        labels = sample.objects
        boxes = labels.boxes2d.resize(scale_x, scale_y)
        image = draw_boxes2d(image, boxes, labels.class_names, color=LABELLED, tags=False)
    boxes = found.boxes.resize(scale_x, scale_y)
    return draw_boxes2d(image, boxes, found.class_names, scores=found.scores)


def _draw_outline(
    picture: UInt8[np.ndarray, "height width 3"],
    mask: Bool[Tensor, "full_height full_width"] | None,
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the border of a mask if it forms one part of the picture."""
    if mask is None or bool(mask.all()):
        return picture
    marked = cv2.resize(
        mask.numpy().astype(np.uint8), picture.shape[1::-1], interpolation=cv2.INTER_NEAREST
    )
    if cv2.connectedComponents(marked)[0] != 2:
        return picture
    contours, _ = cv2.findContours(marked, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    canvas = picture.copy()
    cv2.drawContours(canvas, contours, -1, _OUTLINE, thickness=2)
    return canvas


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
    drawn_detections = found.filter_by_score(DRAWN_SCORE)
    truth = batch.targets[0]
    picture = draw_boxes2d(
        _rgb(batch.image[0]),
        Boxes2D(truth.boxes),
        [CLASSES[index] for index in truth.class_indices.tolist()],
        color=LABELLED,
        tags=False,
    )
    picture = draw_boxes2d(
        picture,
        drawn_detections.boxes,
        drawn_detections.class_names,
        scores=drawn_detections.scores,
    )
    rows = [
        with_title(picture, f"image: labels white, detections from {DRAWN_SCORE:g} on in colour"),
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


def write_results(path: Path, sample: CameraLidarSample, result: DetectionResult) -> None:
    """Write KITTI's result file.

    Raises:
        ValueError: A box or a score is invalid.
    """
    check_boxes(result.detections)
    kitti_labels.write_objects(path, kitti_from_detections2d(result.detections, sample.image_size))


def read_results(path: Path, perception: Perception) -> Perception:
    """Add the 2D boxes of KITTI's result file.

    Raises:
        FileError: The file is damaged.
    """
    return replace(perception, detections2d=_load_detections(path))


def read_detections(path: Path, sample: CameraLidarSample) -> DetectionResult:
    """Read the 2D boxes of KITTI's result file as a result without gates.

    Raises:
        FileError: The file is damaged.
    """
    del sample
    return DetectionResult(detections=_load_detections(path))


def _load_detections(path: Path) -> Detections2D:
    return detections2d_from_kitti(kitti_labels.read_results(path))


def write_gates(path: Path, sample: CameraLidarSample, result: DetectionResult) -> None:
    """Write the gates as a PNG of the image's size: the camera's in red, the LiDAR's in green.

    Raises:
        ValueError: The network has no gates.
    """
    if result.camera_gate is None or result.lidar_gate is None:
        raise ValueError("the network has no gates; leave the gates out")
    camera, lidar = (
        gate_picture(gate[None], sample.image_size)
        for gate in (result.camera_gate, result.lidar_gate)
    )
    write_rgb(path, np.stack((camera, lidar, np.zeros_like(camera)), axis=2))

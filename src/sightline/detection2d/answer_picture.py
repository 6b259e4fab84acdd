"""Row of pictures of a detector's output for a frame: detections, camera gate, LiDAR gate."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from torch import Tensor

from sightline.detection2d.predictor import DetectorAnswer
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.canvas import scaled_to_width
from sightline.visualization.cells import MUTED, titled_cell
from sightline.visualization.colors import RGB, class_color
from sightline.visualization.image import camera_picture, draw_boxes2d, sweep_picture
from sightline.visualization.shares import lay_shares, put_share_legend

DRAWN_SCORE: Final = 0.3
"""Score from which detections are drawn."""
LABELLED: Final[RGB] = (245, 245, 245)
CAMERA_COLOR: Final[RGB] = class_color("Cyclist")
LIDAR_COLOR: Final[RGB] = class_color("Pedestrian")

Masks = tuple[Bool[Tensor, "height width"], Bool[Tensor, "height width"]]
"""Masks of the camera and LiDAR pixels that a corruption may have changed."""

_OUTLINE: RGB = (240, 60, 70)  # none of a gate's colours


def answer_row(
    title: str,
    sample: CameraLidarSample,
    answer: DetectorAnswer,
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
        answer: The detector's output.
        masks: Pixels that a corruption may have changed; outlined if they form one part of the
            image.
        width_px: Width of each picture.
    """
    cells = []
    for panel in answer_panels(sample, answer, masks=masks, width_px=width_px):
        is_gate = bool(panel.note)
        cell = titled_cell(panel.name if is_gate else title, panel.note, panel.picture)
        if is_gate:
            put_share_legend(cell, "0", "1", right=width_px, top=9, color=MUTED)
        cells.append(cell)
    return np.concatenate(cells, axis=1)


class AnswerPanel(NamedTuple):
    """Picture of an answer."""

    name: str
    note: str
    """Mean value of a gate; empty for detections."""
    picture: UInt8[np.ndarray, "height width 3"]


def answer_panels(
    sample: CameraLidarSample,
    answer: DetectorAnswer,
    *,
    masks: Masks | None = None,
    width_px: int = 600,
) -> list[AnswerPanel]:
    """Draw the single pictures of `answer_row`."""
    camera_mask, lidar_mask = masks or (None, None)
    image, sweep = (
        scaled_to_width(each, width_px) for each in (camera_picture(sample), sweep_picture(sample))
    )
    found = _with_boxes(_outlined(image, camera_mask), sample, answer)
    panels = [AnswerPanel("detections", "", found)]
    for name, gate, backdrop, mask in (
        ("camera gate", answer.camera_gate, image, camera_mask),
        ("LiDAR gate", answer.lidar_gate, sweep, lidar_mask),
    ):
        if gate is not None:
            laid = _outlined(lay_shares(backdrop, gate.numpy()), mask)
            panels.append(AnswerPanel(name, f"mean {float(gate.mean()):.2f}", laid))
    return panels


def _with_boxes(
    image: UInt8[np.ndarray, "height width 3"], sample: CameraLidarSample, answer: DetectorAnswer
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw boxes at the picture's final size, so that their tags can be read."""
    scale_y, scale_x = (
        new / old for new, old in zip(image.shape[:2], sample.image_size, strict=True)
    )
    found = answer.detections.filter_by_score(DRAWN_SCORE)
    if sample.objects is not None:
        labels = sample.objects
        boxes = labels.boxes2d.resize(scale_x, scale_y)
        image = draw_boxes2d(image, boxes, labels.class_names, color=LABELLED, tags=False)
    boxes = found.boxes.resize(scale_x, scale_y)
    return draw_boxes2d(image, boxes, found.class_names, scores=found.scores)


def _outlined(
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

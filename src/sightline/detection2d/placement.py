"""Resizing of frames for networks, and the way back: detections in the frame's pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from sightline.augmentation.scene_changes import resize
from sightline.detection2d.config import CLASSES, InputConfig, PostprocessConfig
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.projection import DHI_RANGE_M, dhi_image
from sightline.ops.nms import nms2d
from sightline.structures.level import level_sample
from sightline.structures.predictions import Detections2D
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class Placement:
    """Placement of a resized frame, or of a band of it, at the top left of a network's input."""

    image_size: tuple[int, int]
    """Height, width [px] of the frame."""
    scale_x: float
    scale_y: float
    """Pixels of the input per pixel of the frame."""
    top: int = 0
    """Rows of the resized frame above the input."""

    def to_image(self, boxes: Float[Tensor, "num_boxes 4"]) -> Float[Tensor, "num_boxes 4"]:
        """Convert boxes from the input to the frame; pixels are squares around their centres."""
        scales = boxes.new_tensor([self.scale_x, self.scale_y] * 2)
        return (boxes + boxes.new_tensor([0.5, self.top + 0.5] * 2)) / scales - 0.5


def place(sample: CameraLidarSample, config: InputConfig) -> tuple[CameraLidarSample, Placement]:
    """Resize a sample to the network's size, before padding."""
    old_height, old_width = sample.image_size
    scale = scale_of(sample, config)
    height, width = config.size or (max(round(side * scale), 1) for side in sample.image_size)
    placement = Placement(
        image_size=sample.image_size, scale_x=width / old_width, scale_y=height / old_height
    )
    if (height, width) == sample.image_size:
        return sample, placement
    return resize(sample, height, width), placement


def scale_of(sample: CameraLidarSample, config: InputConfig) -> float:
    """Compute the resize factor of a frame that keeps its proportions."""
    focal_px = float(sample.calibration.image_from_camera[1, 1])
    return config.scale * min(config.longest_focal_px / max(focal_px, 1.0), 1.0)


def camera_image(sample: CameraLidarSample) -> Float32[Tensor, "3 height width"]:
    """Make the RGB image in [0, 1]; black if the camera is missing."""
    if sample.image is None:
        return torch.zeros(3, *sample.image_size)
    return sample.image.float() / 255


def lidar_image(
    sample: CameraLidarSample, config: InputConfig, *, range_m: float = DHI_RANGE_M
) -> Float32[Tensor, "3 height width"]:
    """Make the sweep's `dhi_image` in [0, 1]: depth, height, intensity; zeros without a sweep."""
    if sample.points is None:
        return torch.zeros(3, *sample.image_size)
    level = level_sample(sample)
    assert level.points is not None, "there is a sweep"
    offset_m = config.height_offset_m + sample.higher_than_kitti_m
    image = dhi_image(
        level.points,
        level.calibration,
        sample.image_size,
        height_offset_m=offset_m,
        range_m=range_m,
    )
    return image / 255


def padded(
    planes: Float32[Tensor, "channels height width"], size: tuple[int, int]
) -> Float32[Tensor, "channels new_height new_width"]:
    """Pad with zeros at the right and bottom, so that pixels keep their coordinates."""
    height, width = planes.shape[-2:]
    return F.pad(planes, (0, size[1] - width, 0, size[0] - height))


def whole_strides(size: tuple[int, int], stride: int) -> tuple[int, int]:
    """Round height and width up to multiples of the stride."""
    height, width = (-(-side // stride) * stride for side in size)
    return height, width


MAX_CANDIDATES = 2000  # best-scored boxes of a view that enter suppression


class Candidates(NamedTuple):
    """Boxes of a view before suppression, by descending score where they were too many."""

    boxes: Float[Tensor, "candidates 4"]
    """x_min, y_min, x_max, y_max in the frame's pixels; may reach beyond it."""
    scores: Float[Tensor, " candidates"]
    class_indices: Int64[Tensor, " candidates"]
    """Indices into `CLASSES`."""

    def select(self, kept: Tensor) -> "Candidates":
        """Select candidates by indices or a mask."""
        return Candidates(self.boxes[kept], self.scores[kept], self.class_indices[kept])


def candidates(
    scores: Float[Tensor, "places classes"],
    boxes: Float[Tensor, "places 4"],
    placement: Placement,
    config: PostprocessConfig,
) -> Candidates:
    """Select the best boxes above the least score, in the frame's pixels.

    Args:
        scores: Scores of each class at each place.
        boxes: x_min, y_min, x_max, y_max in pixels of the network's input.
        placement: Placement of the frame in the input.
        config: Thresholds.
    """
    rows, columns = (scores > config.min_score).nonzero().unbind(dim=1)
    top_scores = scores[rows, columns]
    if len(top_scores) > MAX_CANDIDATES:
        best = top_scores.argsort(descending=True, stable=True)[:MAX_CANDIDATES]
        rows, columns, top_scores = rows[best], columns[best], top_scores[best]
    return Candidates(placement.to_image(boxes[rows].float()), top_scores, columns)


def suppressed(
    views: Sequence[Candidates], image_size: tuple[int, int], config: PostprocessConfig
) -> Detections2D:
    """Make detections of the views' candidates, by descending score, clipped to the frame.

    Boxes of a class suppress each other (greedy, by IoU), whichever view they are from; empty boxes
    are removed.
    """
    boxes, scores, columns = (torch.cat(part) for part in zip(*views, strict=True))
    found = Boxes2D(boxes).clip(image_size)
    is_visible = found.area() > 0
    columns, scores, found = columns[is_visible], scores[is_visible], found[is_visible]
    kept = nms2d(
        found.tensor, scores, config.nms_iou, labels=columns, max_detections=config.max_detections
    )
    names = tuple(CLASSES[index] for index in columns[kept].tolist())
    return Detections2D(class_names=names, boxes=found[kept], scores=scores[kept].float())


def to_detections(
    scores: Float[Tensor, "places classes"],
    boxes: Float[Tensor, "places 4"],
    placement: Placement,
    config: PostprocessConfig,
) -> Detections2D:
    """Make detections of one input: `suppressed` after `candidates`.

    Boxes of several detectors are treated alike, which is how late fusion joins them.
    """
    found = candidates(scores, boxes, placement, config)
    return suppressed((found,), placement.image_size, config)

"""A frame's detections and returns in the level frame and in the image, for joining."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from sightline.geometry.boxes3d import Boxes3D, kitti_from_boxes3d
from sightline.geometry.image_boxes import kitti_corners, project_boxes
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.projection import project_points
from sightline.ops.roi_points import roi_points
from sightline.structures.level import level_detections, level_sample
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

_MARGIN_M = 0.05  # by which boxes are enlarged before their returns are counted


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Boxes:
    """Detections of one detector: classes, scores and boxes in the image."""

    names: tuple[str, ...]
    scores: Float64[np.ndarray, " num_boxes"]
    in_image: Float64[np.ndarray, "num_boxes 4"]
    """x_min, y_min, x_max, y_max [px] within the image; NaN: outside."""
    num_points: Int64[np.ndarray, " num_boxes"]
    """Number of returns in view in the 3D box; for detections in the image, in the image box."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scene:
    """Detections of one frame, and the returns in the camera's view."""

    image: Boxes
    """Detections of the image detector."""
    sweep: Boxes
    """Detections of the sweep detector, projected."""
    boxes3d: Float64[np.ndarray, "num_sweep 7"]
    """3D boxes of the sweep detector in the level LiDAR frame, as in `Boxes3D`."""
    image_size: tuple[int, int]
    """Height, width [px]."""
    image_from_camera: Float64[np.ndarray, "3 4"]
    camera_from_level: Float64[np.ndarray, "4 4"]
    lidar_height_m: float
    """Height of the LiDAR above the road."""
    points: Float64[np.ndarray, "num_points 3"]
    """Returns in the camera's view, level LiDAR frame [m]."""
    pixels: Float64[np.ndarray, "num_points 2"]
    """Their pixels: x, y."""
    has_camera: bool
    """Whether there is an image that is not black."""
    has_lidar: bool
    """Whether there is a return in view."""


def make_scene(
    sample: CameraLidarSample, found2d: Detections2D | None, found3d: Detections3D | None
) -> Scene:
    """Project and count for joining; a detector that did not run has no boxes."""
    level = level_sample(sample)
    points, pixels = _seen(level)
    boxes3d, sweep = _sweep_boxes(sample, level, found3d, points)
    return Scene(
        image=_image_boxes(found2d, sample.image_size, pixels.numpy()),
        sweep=sweep,
        boxes3d=boxes3d,
        image_size=sample.image_size,
        image_from_camera=level.calibration.image_from_camera.numpy(),
        camera_from_level=level.calibration.camera_from_lidar.numpy(),
        lidar_height_m=(
            KITTI_LIDAR_HEIGHT_M if sample.lidar_height_m is None else sample.lidar_height_m
        ),
        points=points.numpy(),
        pixels=pixels.numpy(),
        has_camera=sample.image is not None and bool(sample.image.any()),
        has_lidar=len(points) > 0,
    )


def with_sweep_boxes(scene: Scene, sample: CameraLidarSample, found3d: Detections3D) -> Scene:
    """Exchange the sweep detector's boxes of a frame's scene."""
    level = level_sample(sample)
    boxes3d, sweep = _sweep_boxes(sample, level, found3d, torch.from_numpy(scene.points))
    return replace(scene, sweep=sweep, boxes3d=boxes3d)


def count_returns(
    boxes: Boxes3D, points: Float64[Tensor, "num_points 3"]
) -> Int64[Tensor, " num_boxes"]:
    """Count the returns in boxes of the same frame, which are enlarged a little."""
    counts = roi_points(points[None], boxes.tensor[None], margin_m=_MARGIN_M, count=1, seed=0)
    return counts.num_inside[0]


def count_all_returns(scene: Scene, sample: CameraLidarSample) -> Int64[np.ndarray, " num_sweep"]:
    """Count the returns in the sweep detector's boxes, also outside the camera's view."""
    level = level_sample(sample)
    if level.points is None:
        return np.zeros(len(scene.boxes3d), dtype=np.int64)
    boxes = Boxes3D(torch.from_numpy(scene.boxes3d))
    counts: Int64[np.ndarray, " num_sweep"] = count_returns(
        boxes, level.points[:, :3].double()
    ).numpy()
    return counts


def project_upright(boxes: Boxes3D, level: CameraLidarSample) -> Float64[np.ndarray, "num_boxes 4"]:
    """Project boxes of a level frame to the image as result files do; NaN: outside."""
    calibration = level.calibration
    columns = kitti_from_boxes3d(boxes, calibration.camera_from_lidar)
    corners = kitti_corners(*columns)
    projected = project_boxes(corners, calibration.image_from_camera, level.image_size)
    in_image: Float64[np.ndarray, "num_boxes 4"] = projected.tensor.numpy()
    return in_image


def _seen(
    level: CameraLidarSample,
) -> tuple[Float64[Tensor, "num_points 3"], Float64[Tensor, "num_points 2"]]:
    """Points in the image and their pixels."""
    if level.points is None:
        return torch.zeros(0, 3).double(), torch.zeros(0, 2).double()
    points = level.points[:, :3].double()
    projected = project_points(points, level.calibration)
    is_seen = projected.in_image(level.image_size)
    return points[is_seen], projected.pixels[is_seen]


def _sweep_boxes(
    sample: CameraLidarSample,
    level: CameraLidarSample,
    found: Detections3D | None,
    points: Float64[Tensor, "num_points 3"],
) -> tuple[Float64[np.ndarray, "num_boxes 7"], Boxes]:
    """Level boxes, and the same in the image with their returns."""
    boxes = Boxes3D(torch.zeros(0, 7, dtype=torch.float64))
    names: tuple[str, ...] = ()
    scores = torch.zeros(0)
    if found is not None:
        found = level_detections(found, sample)
        boxes = Boxes3D(found.boxes.tensor.detach().cpu().double())
        names, scores = found.class_names, found.scores.detach().cpu()
    projected = Boxes(
        names=names,
        scores=scores.double().numpy(),
        in_image=project_upright(boxes, level),
        num_points=count_returns(boxes, points).numpy(),
    )
    return boxes.tensor.numpy(), projected


def _image_boxes(
    found: Detections2D | None,
    image_size: tuple[int, int],
    pixels: Float64[np.ndarray, "num_points 2"],
) -> Boxes:
    """Boxes inside the image, clipped to it, with their returns."""
    if found is None:
        empty = np.zeros(0)
        return Boxes(
            names=(),
            scores=empty,
            in_image=empty.reshape(0, 4),
            num_points=empty.astype(np.int64),
        )
    boxes = found.boxes.to("cpu").clip(image_size)
    kept = (boxes.area() > 0).nonzero()[:, 0]
    corners = boxes.tensor[kept].detach().double().numpy()
    x, y = pixels[np.argsort(pixels[:, 0])].T
    first, last = np.searchsorted(x, corners[:, 0]), np.searchsorted(x, corners[:, 2], "right")
    counts = [
        np.count_nonzero((y[start:end] >= y_min) & (y[start:end] <= y_max))
        for start, end, (_, y_min, _, y_max) in zip(first, last, corners, strict=True)
    ]
    return Boxes(
        names=tuple(found.class_names[index] for index in kept.tolist()),
        scores=found.scores.detach().cpu()[kept].double().numpy(),
        in_image=corners,
        num_points=np.array(counts, dtype=np.int64),
    )

"""Input of the network that guesses depth from the image: a common scale, and a plain street.

How near a thing looks depends on the camera's focal length, pitch and height above the road. The
network sees every camera at one focal length, and with it the depth that a plain street would have
in this camera's pixels, which it corrects.
"""

from typing import Final

import numpy as np
import torch
from jaxtyping import Float32, Float64
from torch import Tensor

from sightline.augmentation.scene_changes import resize
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample

FARTHEST_STREET_M: Final = 30.0
"""Depth of the plain street at the horizon: the network corrects it by a factor of 4 at most."""
WALL_HEIGHT_M: Final = 6.0
"""Height above the camera at which the plain street is closed, as trees and facades close one."""
LARGEST_SCALE: Final = 2.0
"""Largest factor by which an image is enlarged."""
LOWEST_CAMERA_M: Final = 0.5
"""Least height of a camera above the road; lower ones are taken to be as high."""


def to_focal_length(sample: CameraLidarSample, focal_px: float | None) -> CameraLidarSample:
    """Resize an image to a focal length [px], by `LARGEST_SCALE` at most; None: leave it."""
    if focal_px is None:
        return sample
    matrix = sample.calibration.image_from_camera
    scales = (min(focal_px / matrix[axis, axis].abs().item(), LARGEST_SCALE) for axis in (1, 0))
    height, width = (
        max(1, round(pixels * scale))
        for pixels, scale in zip(sample.image_size, scales, strict=True)
    )
    return sample if (height, width) == sample.image_size else resize(sample, height, width)


def street_depth(sample: CameraLidarSample) -> Float32[Tensor, "height width"]:
    """Compute the depth [m] of a plain street in the pixels of a sample's camera.

    Inverse depths add up: that of the horizon, of a level road below it, and of a level ceiling
    above it. So the depth tells the direction of every pixel and never ends. Road and horizon are
    those of the level frame (`level_from_lidar`) and of the LiDAR's height above the road.
    """
    camera_from_level = level_sample(sample).calibration.camera_from_lidar.numpy()
    camera_in_level = -camera_from_level[:3, :3].T @ camera_from_level[:3, 3]
    lidar_m = KITTI_LIDAR_HEIGHT_M if sample.lidar_height_m is None else sample.lidar_height_m
    above_road_m = max(lidar_m + camera_in_level[2], LOWEST_CAMERA_M)
    slope = _slope(sample)
    inverse = 1 / FARTHEST_STREET_M + np.maximum(-slope / above_road_m, slope / WALL_HEIGHT_M)
    return torch.from_numpy((1 / inverse).astype(np.float32))


def _slope(sample: CameraLidarSample) -> Float64[np.ndarray, "height width"]:
    """Compute the rise of each pixel's ray, in metres per metre along the optical axis."""
    calibration = level_sample(sample).calibration
    height, width = sample.image_size
    upwards = calibration.camera_from_lidar[:3, 2].numpy()
    # Linear in the pixel's column and row.
    across, down, constant = upwards @ np.linalg.inv(calibration.image_from_camera[:, :3].numpy())
    slope: Float64[np.ndarray, "height width"]
    slope = across * np.arange(width) + down * np.arange(height)[:, None] + constant
    return slope

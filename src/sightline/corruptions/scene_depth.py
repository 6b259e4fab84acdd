"""How far away everything in an image is, as weather needs it: fast, and good to some percent."""

from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32

from sightline.geometry.calibration import Calibration
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.sample import CameraLidarSample

_DENSE_SHARE = 0.5  # of the pixels below the horizon: with more of them a depth map is dense
_SMOOTHING_PX = 9
_NEVER_M = 1e6  # the sky


class SceneRanges(NamedTuple):
    """Distances along the camera's rays."""

    ranges_m: Float32[np.ndarray, "height width"]
    """Of the sky a million."""
    source: Literal["depth", "sweep", "flat road"]
    """What they are from."""


def scene_ranges(sample: CameraLidarSample) -> SceneRanges:
    """The distance of what each pixel shows.

    Of a dense depth map, where the sample has one: what it does not know is sky. Else of the sweep
    (with the measured pixels of a sparse depth map): each pixel has the inverse depth of the
    nearest measured one, smoothed; but above the horizon it is sky where that one is below, as a
    LiDAR that looks up a little has had no echo there. Without any, of a flat road below the
    horizon. Takes about 10 ms; surfaces end within some pixels of where they do.
    """
    height, width = sample.image_size
    known = np.zeros((height, width), dtype=np.float32)
    if sample.depth is not None:
        known = sample.depth.numpy()
    horizon = _horizon_row(sample)
    below = known[min(horizon, height - 1) :]
    if (below > 0).mean() >= _DENSE_SHARE:
        depth_m, source = np.where(known > 0, known, np.float32(_NEVER_M)), "depth"
    else:
        if sample.points is not None:
            of_sweep = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
            known = np.where(known > 0, known, of_sweep.numpy())
        if known.any():
            depth_m, source = _filled(known, horizon), "sweep"
        else:
            depth_m, source = _flat_road(sample, horizon), "flat road"
    ranges_m = np.minimum(depth_m * _ray_lengths(sample.calibration, height, width), _NEVER_M)
    return SceneRanges(ranges_m.astype(np.float32, copy=False), source)


def _horizon_row(sample: CameraLidarSample) -> int:
    """Where the horizon is, if the camera looks straight ahead."""
    row = float(sample.calibration.image_from_camera[1, 2])
    return int(np.clip(round(row), 0, sample.image_size[0]))


def _filled(
    known_m: Float32[np.ndarray, "height width"], horizon: int
) -> Float32[np.ndarray, "height width"]:
    is_known = known_m > 0
    _, labels = cv2.distanceTransformWithLabels(
        (~is_known).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(is_known)
    row_of = np.zeros(labels.max() + 1, dtype=np.int32)
    inverse_of = np.zeros(labels.max() + 1, dtype=np.float32)
    of_known = labels[rows, columns]
    row_of[of_known] = rows
    inverse_of[of_known] = 1 / known_m[rows, columns]
    inverse = inverse_of[labels]
    inverse[:horizon][row_of[labels[:horizon]] > horizon] = 0
    inverse = cv2.blur(inverse, (_SMOOTHING_PX, _SMOOTHING_PX))
    return (1 / np.maximum(inverse, 1 / _NEVER_M)).astype(np.float32, copy=False)


def _flat_road(sample: CameraLidarSample, horizon: int) -> Float32[np.ndarray, "height width"]:
    height, width = sample.image_size
    focal_px = float(sample.calibration.image_from_camera[1, 1])
    rows_below = np.maximum(np.arange(height) - horizon, 0)
    camera_height_m = KITTI_LIDAR_HEIGHT_M  # less some centimetres
    depth_m = focal_px * camera_height_m / np.maximum(rows_below, 1e-3)
    column = np.minimum(depth_m, _NEVER_M).astype(np.float32)
    return np.repeat(column[:, None], width, axis=1)


def _ray_lengths(
    calibration: Calibration, height: int, width: int
) -> Float32[np.ndarray, "height width"]:
    """Metres along each pixel's ray for a metre of depth."""
    intrinsics = calibration.image_from_camera[:, :3].numpy()
    x = (np.arange(width) - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (np.arange(height) - intrinsics[1, 2]) / intrinsics[1, 1]
    return np.sqrt(1 + x**2 + (y**2)[:, None]).astype(np.float32)

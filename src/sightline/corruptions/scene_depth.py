"""Distance of everything in an image, and its sky, for weather: accurate to a few percent."""

import math
from typing import Final, Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt8
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.level import horizon_row
from sightline.structures.sample import CameraLidarSample

_BLUER = 1.15  # minimum ratio of blue to red in a blue sky
_BLUE_LEVEL = 110  # its minimum level; darker pixels lie in the shade
_WHITE_LEVEL = 225  # minimum level of an overexposed sky
_CLOUD_SHARE = 0.6  # minimum level of clouds, as a share of the image's brightest tenth
_RINGS_PX = 9  # more than the spacing of rings in KITTI's image
_WINDOW_PX = 15


def sky_mask(
    planes: UInt8[np.ndarray, "3 height width"],
    is_known: Bool[np.ndarray, "height width"],
    is_silent: Bool[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Mark pixels that are blue, white, or without echo and as bright as a cloud, except walls.

    A wall of such a colour is detected from the pixels below: they lead down without an edge to
    measured pixels, over more than the spacing of rings. The majority of the surroundings decides,
    as some measurements lie beside their edge.

    Args:
        planes: Part of an image above the horizon, RGB.
        is_known: Measured pixels.
        is_silent: Pixels without an echo that the LiDAR may have covered.
    """
    if not planes.size:
        return is_known
    red, green, blue = planes.astype(np.int16)
    is_blue = (blue > _BLUER * red) & (blue >= green) & (blue >= _BLUE_LEVEL)
    level = planes.min(axis=0)
    cloud_level = min(_CLOUD_SHARE * float(np.percentile(level[::4, ::4], 90)), _WHITE_LEVEL)
    is_similar = is_blue | (level >= np.where(is_silent, cloud_level, _WHITE_LEVEL))
    upright = np.ones((_RINGS_PX, 1), dtype=np.uint8)  # closes small gaps in an upright run
    in_run = cv2.morphologyEx(is_similar.astype(np.uint8), cv2.MORPH_CLOSE, upright) > 0
    is_beside = cv2.dilate(is_known.astype(np.uint8), np.ones((1, 3), dtype=np.uint8)) > 0
    is_wall = is_similar & (_next_row(~in_run) >= _next_row(is_beside) + _RINGS_PX)
    walls, similar = (
        cv2.blur(each.astype(np.float32), (_WINDOW_PX, _WINDOW_PX))
        for each in (is_wall, is_similar)
    )
    is_sky: Bool[np.ndarray, "height width"] = is_similar & (walls <= similar / 2)
    return is_sky


def _next_row(is_marked: Bool[np.ndarray, "height width"]) -> Int64[np.ndarray, "height width"]:
    """Find for each pixel the first marked row from its own downwards; otherwise the height."""
    height, _ = is_marked.shape
    rows = np.where(is_marked, np.arange(height)[:, None], height)
    next_row: Int64[np.ndarray, "height width"] = np.minimum.accumulate(rows[::-1])[::-1]
    return next_row


_DENSE_SHARE = 0.5  # minimum share of known pixels below the horizon in a dense depth map
_WIDE_WINDOW_PX = 61  # where there is no measurement nearby
_TRUSTED_PX = 8.0  # distance from a measured pixel at which the weight of its depth falls to 1/e
_MIN_TRUST = 0.1
_SMOOTH_LEVELS = 12.0  # minimum change of the guide at an edge
_SILENT_M = 100.0  # minimum range of surfaces without an echo
_NEVER_M = 1e6  # range of the sky
_LEVEL_DEG: Final = 1.0
"""Pitch of a camera that counts as none: LiDARs that count as level lean, KITTI's by 0.6."""


class SceneRanges(NamedTuple):
    """Distances along the camera's rays."""

    ranges_m: Float32[np.ndarray, "height width"]
    """Ranges along the rays; 1e6 for the sky."""
    source: Literal["depth", "sweep", "flat road"]
    """Source of the ranges."""


def scene_ranges(sample: CameraLidarSample) -> SceneRanges:
    """Estimate the range at each pixel.

    The source is a dense depth map, if the sample has one: its unknown pixels are sky. Otherwise it
    is the sweep (with the measured pixels of a sparse depth map): each pixel has the inverse depth
    of the nearest measured one. Pixels above the horizon whose nearest measured pixel is below it
    are silent: a LiDAR that looks up a little has no echo there, so they are at least 100 m away.
    Pixels that look like sky (`sky_mask`) are sky; without an image, all silent pixels are. Edges
    then follow the image's: a guided filter, He et al. 2010, as Sakaridis et al. 2018 use it on the
    transmittance. Without measurements nearby, its window is wider, and measured, silent and sky
    pixels weigh most, so that depths do not change where the nearest measurement does. Without any
    measurement, the source is a flat road below the horizon. Edges of surfaces are accurate to some
    pixels.
    """
    height, width = sample.image_size
    known = np.zeros((height, width), dtype=np.float32)
    if sample.depth is not None:
        known = sample.depth.numpy()
    row = round(scene_horizon(sample))
    horizon = min(max(row, 0), height)
    below = known[min(horizon, height - 1) :]
    source: Literal["depth", "sweep", "flat road"] = "depth"
    if (below > 0).mean() >= _DENSE_SHARE:
        depth_m = np.where(known > 0, known, np.float32(_NEVER_M))
    else:
        if sample.points is not None:
            sweep_depth_m = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
            known = np.where(known > 0, known, sweep_depth_m.numpy())
        if known.any():
            depth_m, source = _filled(known, horizon, sample.image), "sweep"
        else:
            depth_m, source = _flat_road(sample, row), "flat road"
    ranges_m = np.minimum(depth_m * _ray_lengths(sample.calibration, height, width), _NEVER_M)
    return SceneRanges(ranges_m.astype(np.float32, copy=False), source)


def scene_horizon(sample: CameraLidarSample) -> float:
    """Row [px] of the horizon, inside the image or not.

    It is the principal point's if the camera is pitched by less than a degree against the level
    frame, or does not look ahead.
    """
    focal_px, level_row = sample.calibration.image_from_camera[1, 1:3].tolist()
    row = horizon_row(sample)
    if row is None or abs(row - level_row) < focal_px * math.tan(math.radians(_LEVEL_DEG)):
        return float(level_row)
    return row


def _filled(
    known_m: Float32[np.ndarray, "height width"],
    horizon: int,
    image: UInt8[Tensor, "3 height width"] | None,
) -> Float32[np.ndarray, "height width"]:
    is_known = known_m > 0
    away_px, labels = cv2.distanceTransformWithLabels(
        (~is_known).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    rows, columns = np.nonzero(is_known)
    label_rows = np.zeros(labels.max() + 1, dtype=np.int32)
    label_inverse = np.zeros(labels.max() + 1, dtype=np.float32)
    known_labels = labels[rows, columns]
    label_rows[known_labels] = rows
    label_inverse[known_labels] = 1 / known_m[rows, columns]
    inverse = label_inverse[labels]
    above = slice(0, horizon)
    is_silent = label_rows[labels[above]] > horizon
    if image is None:
        inverse[above][is_silent] = 0
    else:
        far = np.minimum(inverse[above][is_silent], np.float32(1 / _SILENT_M))
        inverse[above][is_silent] = far
        is_sky = sky_mask(image.numpy()[:, above], is_known[above], is_silent)
        inverse[above][is_sky] = 0
        away_px[above][is_sky] = 0
    away_px[above][is_silent] = 0  # the absence of an echo is a measurement, too
    guide = inverse if image is None else image.numpy().max(axis=0).astype(np.float32)
    trust = np.exp(-away_px / np.float32(_TRUSTED_PX))
    near = _guided(inverse, guide, np.ones_like(trust), _WINDOW_PX)
    wide = _guided(inverse, guide, trust + np.float32(_MIN_TRUST), _WIDE_WINDOW_PX)
    share = cv2.blur(trust, (_WINDOW_PX, _WINDOW_PX))
    inverse = wide + share * (near - wide)
    depth_m: Float32[np.ndarray, "height width"] = 1 / np.maximum(inverse, np.float32(1 / _NEVER_M))
    return depth_m.astype(np.float32, copy=False)


def _guided(
    values: Float32[np.ndarray, "height width"],
    guide: Float32[np.ndarray, "height width"],
    weights: Float32[np.ndarray, "height width"],
    window_px: int,
) -> Float32[np.ndarray, "height width"]:
    """Fit the values as a linear function of the guide in each window; average the functions."""

    def mean(plane: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
        return cv2.blur(plane, (window_px, window_px)).astype(np.float32, copy=False)

    total = mean(weights)
    mean_guide, mean_values = mean(weights * guide) / total, mean(weights * values) / total
    spread = mean(weights * guide * guide) / total - mean_guide * mean_guide
    cross = mean(weights * guide * values) / total - mean_guide * mean_values
    slope = cross / (spread + _SMOOTH_LEVELS**2)
    filtered: Float32[np.ndarray, "height width"] = mean(slope) * guide
    filtered += mean(mean_values - slope * mean_guide)
    return filtered


def _flat_road(sample: CameraLidarSample, horizon: int) -> Float32[np.ndarray, "height width"]:
    height, width = sample.image_size
    focal_px = float(sample.calibration.image_from_camera[1, 1])
    rows_below = np.maximum(np.arange(height) - horizon, 0)
    height_m = KITTI_LIDAR_HEIGHT_M + sample.higher_than_kitti_m  # LiDAR height, near the camera's
    depth_m = focal_px * height_m / np.maximum(rows_below, 1e-3)
    column = np.minimum(depth_m, _NEVER_M).astype(np.float32)
    return np.repeat(column[:, None], width, axis=1)


def _ray_lengths(
    calibration: Calibration, height: int, width: int
) -> Float32[np.ndarray, "height width"]:
    """Compute the metres along each pixel's ray per metre of depth."""
    intrinsics = calibration.image_from_camera[:, :3].numpy()
    x = (np.arange(width) - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (np.arange(height) - intrinsics[1, 2]) / intrinsics[1, 1]
    lengths: Float32[np.ndarray, "height width"] = np.sqrt(1 + x**2 + (y**2)[:, None]).astype(
        np.float32
    )
    return lengths

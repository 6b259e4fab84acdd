"""Sorting of sweeps in any order ring by ring, as in KITTI's files."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float32, Int64

from sightline.data.formats.lidar_origin import seen_from_lidar
from sightline.data.formats.ring_elevations import MIN_RINGS, rings_by_elevation
from sightline.data.formats.rings import is_firing_order
from sightline.geometry.tilt import Tilt
from sightline.health.sphere import to_sphere
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample

SEAM_DEG = 30.0
"""Largest decrease of the azimuth inside a ring."""
_MIN_POINTS = 100  # minimum number of points to detect an order
_APART = 7  # index distance of points on one ring, or nearly so
_SCATTERED = 0.2  # share of the elevations' spread between points that are not
_MAX_DOUBTFUL_SHARE = 0.15  # share of points between rings: a noisy sensor must be judged, too
_RING_GAP_DEG = 0.1
_MIN_RINGS = 4
_RING_STEP_DEG = 0.4  # step for rings blurred by noise


def level_by_ring(sample: CameraLidarSample) -> CameraLidarSample:
    """Transform a sample to its level frame; points of a tilted LiDAR are then ring by ring.

    Its rings are found in its own frame, as they are at no one elevation in the level frame. Points
    that are ring by ring, or show no rings there, keep their order. Points in a vehicle's frame are
    seen from KITTI's height of a LiDAR.
    """
    sample = seen_from_lidar(sample)
    level = level_sample(sample)
    if sample.level_from_lidar is None or sample.points is None or level.points is None:
        return level
    if Tilt.from_up(sample.level_from_lidar[2, :3].numpy()).is_level:
        return level
    points = sample.points.numpy()
    if not is_firing_order(points):
        return level
    try:
        from_top = rings_by_elevation(points, _MAX_DOUBTFUL_SHARE, try_leaning=False)
    except ValueError:
        return level
    order = np.lexsort((to_sphere(level.points.numpy())[1], from_top))
    return replace(level, points=level.points[torch.from_numpy(order)])


def ring_by_ring(
    points: Float32[np.ndarray, "num_points 4"],
) -> Float32[np.ndarray, "num_points 4"]:
    """Sort points with the highest ring first, each ring by increasing azimuth.

    Points in KITTI's order are unchanged. Clockwise rings are reversed. Points in the order of the
    laser's firings, or in none, are split into rings by their elevation (`rings_by_elevation`; if
    noise blurs these, by gaps or even steps).

    Args:
        points: A sweep, or a part of it that is less than a full turn.
    """
    if len(points) < _MIN_POINTS:
        return points
    _, azimuth_deg, elevation_deg = to_sphere(points)
    spread = float(np.subtract(*np.quantile(elevation_deg, (0.9, 0.1))))
    apart = np.abs(elevation_deg[_APART:] - elevation_deg[:-_APART])
    is_scattered = float(np.median(apart)) > _SCATTERED * spread
    if is_scattered or number_rings(azimuth_deg)[-1] + 1 < MIN_RINGS:
        by_ring = _rings_from_below(points, elevation_deg, is_scattered=is_scattered)
        if by_ring is not None:
            return points[np.lexsort((azimuth_deg, -by_ring))]
    if np.median(np.diff(azimuth_deg)) < 0:
        points, elevation_deg = points[::-1], elevation_deg[::-1]
        azimuth_deg = azimuth_deg[::-1]
    rings = number_rings(azimuth_deg)
    first, last = (elevation_deg[rings == number] for number in (rings[0], rings[-1]))
    if np.median(first) < np.median(last):
        points = points[np.argsort(-rings, kind="stable")]
    return np.ascontiguousarray(points)


def number_rings(
    azimuth_deg: Float32[np.ndarray, " num_points"],
) -> Int64[np.ndarray, " num_points"]:
    """Number the rings of a part of a sweep, from 0, by the decreases of the azimuth."""
    return np.cumsum(np.diff(azimuth_deg, prepend=azimuth_deg[:1]) < -SEAM_DEG, dtype=np.int64)


def _rings_from_below(
    points: Float32[np.ndarray, "num_points 4"],
    elevation_deg: Float32[np.ndarray, " num_points"],
    *,
    is_scattered: bool,
) -> Int64[np.ndarray, " num_points"] | None:
    """Number rings by elevation; None for points possibly ring by ring that show no other rings."""
    try:
        return -rings_by_elevation(points, _MAX_DOUBTFUL_SHARE, try_leaning=False)
    except ValueError:
        return _groups_by_elevation(elevation_deg) if is_scattered else None


def _groups_by_elevation(
    elevation_deg: Float32[np.ndarray, " num_points"],
) -> Int64[np.ndarray, " num_points"]:
    """Number groups from below: by gaps between them, or by even steps if there are no gaps."""
    order = np.argsort(elevation_deg)
    gaps = np.diff(elevation_deg[order], prepend=elevation_deg[order[:1]]) > _RING_GAP_DEG
    if gaps.sum() + 1 < _MIN_RINGS:
        return np.floor(elevation_deg / _RING_STEP_DEG).astype(np.int64)
    rings = np.empty(len(order), np.int64)
    rings[order] = np.cumsum(gaps)
    return rings

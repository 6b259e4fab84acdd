"""Yaw error of the LiDAR relative to the camera, from edges of depth and image.

As in Levinson and Thrun 2013, "Automatic online calibration of cameras and lasers": where the range
jumps along a ring, there is the side of an object. Its edge in the image is searched at every angle
of a grid. This needs neither a network nor a calibration target.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from sightline.geometry.wrong_types import named_arguments
from sightline.health.ring_order import ring_by_ring
from sightline.health.sphere import to_sphere
from sightline.health.tilt_error import TopMatch, edge_strength, match_tops
from sightline.ops.compiled import compiled
from sightline.structures.sample import CameraLidarSample

LARGEST_DEG = 3.0
"""Largest detectable rotation."""
_STEP_DEG = 0.05
_ANGLES_DEG = np.linspace(-4.0, 4.0, 161)  # beyond the largest, so that its peak is complete
_BLURS_PX = (12.0, 4.0, 1.5)  # blur of the image's edges, coarse to fine
_WINDOWS_DEG = (0.8, 0.3)  # search windows of the next finer peak, around the last one
_JUMP_M = 0.5  # minimum range jump between neighbours on a ring
_JUMP_SHARE = 0.07  # same, as a share of the nearer range
_WIDEST_STEP = 4.0  # maximum azimuth distance of neighbours, in typical steps
_MIN_EDGES = 30
_MARGIN_SHARE = 0.15  # margin beyond the image's borders, as a share of its width


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class EdgeMatch:
    """Match of the edges of one or more frames at each angle of the grid, coarse to fine."""

    curves: Float64[np.ndarray, "num_blurs num_angles"]
    num_edges: int
    """Number of depth edges searched."""
    tops: TopMatch
    """Match of upper edges, for pitch and roll."""

    def __add__(self, other: "EdgeMatch") -> "EdgeMatch":
        """Sum the matches of both."""
        return EdgeMatch(
            curves=self.curves + other.curves,
            num_edges=self.num_edges + other.num_edges,
            tops=self.tops + other.tops,
        )

    def faded(self, share: float) -> "EdgeMatch":
        """Scale the match's weight, so that older frames count less."""
        return replace(self, curves=share * self.curves, tops=self.tops.faded(share))


class YawEstimate(NamedTuple):
    """Uncalibrated rotation of the LiDAR about its z axis."""

    yaw_deg: float
    """Counter-clockwise, as in `data.faults.TurnedLidar`."""
    prominence: float
    """Height of the peak above the curve's mean, in standard deviations of the curve."""


@named_arguments
def match_edges(sample: CameraLidarSample) -> EdgeMatch | None:
    """Match the edges of one frame; about 25 ms on one core for KITTI's size.

    Returns:
        None if a sensor is absent, or too few depth edges are in view.
    """
    if sample.image is None or sample.points is None:
        return None
    image_from_lidar = sample.calibration.image_from_lidar.double().numpy()
    near = ring_by_ring(_near_view(sample.points.numpy(), image_from_lidar, sample.image_size))
    points, weights = find_depth_edges(near)
    if len(points) < _MIN_EDGES:
        return None
    image = np.ascontiguousarray(sample.image.permute(1, 2, 0).numpy())
    sharp = edge_strength(image, "horizontal")
    angles = np.radians(_ANGLES_DEG)
    curves = [
        _mean_strength(
            points,
            weights,
            image_from_lidar,
            cv2.GaussianBlur(sharp, (0, 0), blur, sigmaY=1),
            angles,
        )
        for blur in _BLURS_PX
    ]
    return EdgeMatch(
        curves=np.stack(curves),
        num_edges=len(points),
        tops=match_tops(image, near, image_from_lidar),
    )


@named_arguments
def estimate_yaw(match: EdgeMatch) -> YawEstimate:
    """Find the angle of the best match: the coarse curve's peak, then refined by the finer ones.

    A parabola through three angles of the grid gives the peak between them.
    """
    yaw_deg, reach_deg = 0.0, math.inf
    for curve, next_reach in zip(match.curves, (*_WINDOWS_DEG, 0.0), strict=True):
        near = np.abs(_ANGLES_DEG - yaw_deg) <= reach_deg
        best = int(np.where(near, curve, -np.inf).argmax())
        yaw_deg = float(_ANGLES_DEG[best]) + _STEP_DEG * _parabola_top(curve, best)
        reach_deg = next_reach
    coarse = match.curves[0]
    spread = float(coarse.std())
    prominence = float(coarse.max() - coarse.mean()) / spread if spread else 0.0
    return YawEstimate(yaw_deg=yaw_deg, prominence=prominence)


@named_arguments
def match_at_zero(match: EdgeMatch) -> float:
    """Compute the deficit of the match at zero rotation to the best one, in standard deviations.

    The middle blur is used: the finest has random peaks, the coarsest hardly any.
    """
    curve = match.curves[len(match.curves) // 2]
    spread = float(curve.std())
    behind = float(curve.max() - np.interp(0.0, _ANGLES_DEG, curve))
    return behind / spread if spread else 0.0


@named_arguments
def find_depth_edges(
    points: Float32[np.ndarray, "num_points 4"],
) -> tuple[Float64[np.ndarray, "num_edges 3"], Float64[np.ndarray, " num_edges"]]:
    """Find sides of objects, where the range jumps from one point to the next on a ring.

    The place [m] is that of the nearer point, half an azimuth step towards the farther one; the
    weight is the logarithm of the ratio of both ranges, at most 1.

    Args:
        points: Points ring by ring, see `ring_by_ring`.
    """
    if len(points) < 2:
        return np.zeros((0, 3)), np.zeros(0)
    ranges, azimuth_deg, _ = to_sphere(points)
    steps = np.abs(np.diff(azimuth_deg))
    nearer = np.minimum(ranges[1:], ranges[:-1])
    jumps = np.abs(np.diff(ranges)) > np.maximum(_JUMP_M, _JUMP_SHARE * nearer)
    first = np.flatnonzero(jumps & (steps < _WIDEST_STEP * np.median(steps)) & (nearer > 0))
    front = np.where(ranges[first] < ranges[first + 1], first, first + 1)
    azimuth = np.radians((azimuth_deg[first] + azimuth_deg[first + 1]) / 2)
    flat = np.hypot(points[front, 0], points[front, 1])
    places = np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), points[front, 2]), axis=1)
    ratio = np.maximum(ranges[first], ranges[first + 1]) / nearer[first]
    return places.astype(np.float64), np.minimum(np.log(ratio), 1.0).astype(np.float64)


def _near_view(
    points: Float32[np.ndarray, "num_points 4"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    image_size: tuple[int, int],
) -> Float32[np.ndarray, "num_near 4"]:
    """Select points that some rotation of the grid brings into the image: a quarter of a sweep."""
    height, width = image_size
    matrix = image_from_lidar.astype(np.float32)
    x, y, depth = matrix[:, :3] @ points[:, :3].T + matrix[:, 3:]
    margin = _MARGIN_SHARE * width
    near: Float32[np.ndarray, "num_near 4"] = points[
        (depth > 0)
        & (x > -margin * depth)
        & (x < (width + margin) * depth)
        & (y > -margin * depth)
        & (y < (height + margin) * depth)
    ]
    return near


def _parabola_top(curve: Float64[np.ndarray, " num_angles"], best: int) -> float:
    """Compute the top of the parabola through a peak and its neighbours, in steps from the peak."""
    if not 0 < best < len(curve) - 1:
        return 0.0
    before, at, after = curve[best - 1 : best + 2]
    bend = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


@compiled
def _mean_strength(
    points: Float64[np.ndarray, "num_edges 3"],
    weights: Float64[np.ndarray, " num_edges"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    strength: Float32[np.ndarray, "height width"],
    angles: Float64[np.ndarray, " num_angles"],
) -> Float64[np.ndarray, " num_angles"]:
    """Compute the mean strength at the points' pixels after undoing each rotation [rad]."""
    height, width = strength.shape
    matrix = image_from_lidar
    means = np.zeros(len(angles))
    for number in range(len(angles)):
        cosine, sine = np.cos(angles[number]), np.sin(angles[number])
        total, weight = 0.0, 0.0
        for i in range(len(points)):
            x = cosine * points[i, 0] + sine * points[i, 1]
            y = cosine * points[i, 1] - sine * points[i, 0]
            z = points[i, 2]
            depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z + matrix[2, 3]
            if depth < 1.0:
                continue
            u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / depth
            v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / depth
            left, row = int(np.floor(u)), int(np.floor(v + 0.5))
            if left < 0 or left >= width - 1 or row < 0 or row >= height:
                continue
            share = u - left
            here = (1 - share) * strength[row, left] + share * strength[row, left + 1]
            total += weights[i] * here
            weight += weights[i]
        if weight > 0:
            means[number] = total / weight
    return means

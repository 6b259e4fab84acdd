"""Misalignment of the LiDAR with the camera, in space or time.

Image, calibration and labels stay as they are; the sweep is transformed to the true frame of the
LiDAR. KITTI's labels are in the camera's frame, so all of them are now offset from the points.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.spatial.transform import Rotation
from torch import Tensor

from sightline.corruptions.corruption import (
    LidarCorruption,
    Parameter,
    PointsChange,
    Sweep,
    everywhere,
)
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.ranges import Within
from sightline.geometry.transforms import rigid_inverse, transform_points
from sightline.structures.sample import CameraLidarSample

_OWN_CAR_M: Final = (2.5, 1.2)
"""Reach of the own car from the LiDAR, along the camera's view and across it."""
_OWN_SLOPE: Final = 1 / 3
"""Least drop by distance of its bonnet and boot, which lie aside in the view of a side camera."""
_CLEARANCE_M: Final = 0.3  # least height above the road; the road itself lies lower


@dataclass(frozen=True, kw_only=True, slots=True)
class SpatialMisalignment(LidarCorruption):
    """Rotation and translation of the LiDAR in its mount, with random axis and direction.

    Angle and distance equal the settings exactly.
    """

    kind = "misalignment_spatial"

    rotation_deg: Annotated[float, Within(0, 180)]
    translation_m: Annotated[float, Within(0)]

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Move the sweep; draws axis and direction, each uniformly on the sphere."""
        axis, direction = _direction(rng), _direction(rng)
        turn = Rotation.from_rotvec(math.radians(self.rotation_deg) * axis)
        moved_from_lidar = torch.eye(4, dtype=torch.float64)
        moved_from_lidar[:3, :3] = torch.from_numpy(turn.as_matrix())
        moved_from_lidar[:3, 3] = torch.from_numpy(self.translation_m * direction)
        drawn: dict[str, Parameter] = {
            "axis": axis.tolist(),
            "rotation_deg": self.rotation_deg,
            "translation_m": (self.translation_m * direction).tolist(),
        }
        return _transformed(moved_from_lidar, points, sample, drawn)


@dataclass(frozen=True, kw_only=True, slots=True)
class TemporalMisalignment(LidarCorruption):
    """Sweep older than the image, by a latency during which the car moved.

    The scene is static: the current sweep is transformed to the LiDAR's earlier pose. The car
    drives ahead, however the LiDAR is mounted, at a constant speed and yaw rate. Returns of the
    car itself stay where they are (`own_returns`).
    """

    kind = "misalignment_temporal"
    revision = 2

    latency_s: Annotated[float, Within(0)]
    speed_mps: Annotated[float, Within(0)] = 10.0
    yaw_rate_dps: Annotated[tuple[float, float], Within(-180, 180)] = (-10.0, 10.0)
    """Degrees per second, counter-clockwise; uniform distribution."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Move the sweep by `ego_motion`, without the own car's returns."""
        yaw_rate_dps = rng.uniform(*self.yaw_rate_dps)
        then_from_now = ego_motion(self.speed_mps, yaw_rate_dps, self.latency_s)
        level = sample.level_from_lidar
        if level is not None:
            then_from_now = rigid_inverse(level) @ then_from_now @ level
        drawn: dict[str, Parameter] = {
            "latency_s": self.latency_s,
            "speed_mps": self.speed_mps,
            "yaw_rate_dps": yaw_rate_dps,
        }
        change = _transformed(then_from_now, points, sample, drawn)
        is_own = own_returns(points, sample)
        change.points[is_own] = points[is_own]
        return change


def own_returns(points: Sweep, sample: CameraLidarSample) -> Bool[Tensor, " num_points"]:
    """Mark points on the car that carries the LiDAR.

    They are more than 0.3 m above the road, and in a box along the camera's view or, in any
    direction, as near as its length and steeply below the LiDAR.
    """
    places = points[:, :3]
    if sample.level_from_lidar is not None:
        places = transform_points(sample.level_from_lidar, places)
    height_m = KITTI_LIDAR_HEIGHT_M + sample.higher_than_kitti_m
    flat_m, up_m = places[:, :2], places[:, 2]
    in_box = (flat_m.abs() < flat_m.new_tensor(_OWN_CAR_M)).all(dim=1)
    away_m = flat_m.norm(dim=1)
    is_below = (away_m < _OWN_CAR_M[0]) & (up_m < -_OWN_SLOPE * away_m)
    is_own: Bool[Tensor, " num_points"] = (in_box | is_below) & (up_m > _CLEARANCE_M - height_m)
    return is_own


def ego_motion(speed_mps: float, yaw_rate_dps: float, time_s: float) -> Float64[Tensor, "4 4"]:
    """Compute the pose after a time on an arc [m], in the initial frame: level, x ahead."""
    yaw = math.radians(yaw_rate_dps) * time_s
    # The arc's end, written with sin(x) / x, which is also defined without rotation.
    ahead_m = speed_mps * time_s * float(np.sinc(yaw / math.pi))
    aside_m = speed_mps * time_s * math.sin(yaw / 2) * float(np.sinc(yaw / 2 / math.pi))
    then_from_now = torch.eye(4, dtype=torch.float64)
    then_from_now[:3, :3] = torch.from_numpy(Rotation.from_euler("z", yaw).as_matrix())
    then_from_now[:2, 3] = torch.tensor([ahead_m, aside_m])
    return then_from_now


def _direction(rng: np.random.Generator) -> Float64[np.ndarray, "3"]:
    while True:
        drawn = rng.standard_normal(3)
        length = float(np.linalg.norm(drawn))
        if length > 1e-6:
            return drawn / length


def _transformed(
    other_from_lidar: Float64[Tensor, "4 4"],
    points: Sweep,
    sample: CameraLidarSample,
    drawn: dict[str, Parameter],
) -> PointsChange:
    moved = points.clone()
    moved[:, :3] = transform_points(other_from_lidar, points[:, :3].double()).float()
    return PointsChange(moved, torch.arange(len(points)), everywhere(sample), drawn)

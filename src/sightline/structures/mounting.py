"""Mounting of a sweep's LiDAR, given by the user or estimated from the road in its points."""

from collections.abc import Sequence
from typing import SupportsFloat

import numpy as np
from jaxtyping import Float32
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.mount_axes import axes_doubt
from sightline.geometry.road_height import (
    MAX_LIDAR_HEIGHT_M,
    MAX_TILT_DEG,
    MIN_LIDAR_HEIGHT_M,
    UNKNOWN_TILT,
    LidarPose,
    describe_odd_height,
    is_road_hidden,
    lidar_pose,
    mount_doubts,
)
from sightline.geometry.tilt import Tilt
from sightline.geometry.user_warning import warn_user
from sightline.structures.arrays import plain_number


def plain_height(lidar_height_m: SupportsFloat) -> float:
    """Convert a LiDAR's height [m] above the road from any type of number.

    Raises:
        ValueError: The value is no number, or no plausible height.
    """
    height_m = plain_number("lidar_height_m", lidar_height_m)
    if not MIN_LIDAR_HEIGHT_M <= height_m <= MAX_LIDAR_HEIGHT_M:
        raise ValueError(
            f"lidar_height_m is {height_m:g}, expected {MIN_LIDAR_HEIGHT_M:g} to "
            f"{MAX_LIDAR_HEIGHT_M:g}; give the LiDAR's height above the road in metres"
        )
    return height_m


def plain_tilt(lidar_tilt_deg: Sequence[SupportsFloat] | np.ndarray | Tensor) -> Tilt:
    """Convert a LiDAR's roll and pitch [degrees] against the road from any type of numbers.

    Raises:
        ValueError: The values are not two numbers, or no plausible tilt.
    """
    try:
        angles = [plain_number("lidar_tilt_deg", angle) for angle in lidar_tilt_deg]
    except TypeError:
        angles = []
    if len(angles) != 2 or not all(abs(angle) <= MAX_TILT_DEG for angle in angles):
        value = " ".join(str(lidar_tilt_deg).split())[:60]
        raise ValueError(
            f"lidar_tilt_deg is {value}, expected roll and pitch, each from {-MAX_TILT_DEG:g} to "
            f"{MAX_TILT_DEG:g}; give two angles in degrees"
        )
    return Tilt(roll_deg=angles[0], pitch_deg=angles[1])


def pose_of_sweep(
    sweep: Float32[Tensor, "num_points 4"], height_m: float | None, tilt: Tilt | None
) -> LidarPose:
    """Determine height and tilt of a sweep's LiDAR: the given values, else from the road.

    Warns if a tilt is found, if a height or the tilt beside a given one has to be assumed, if a
    height looks like one in another unit, and if the road contradicts the given values.
    """
    for difference in mount_doubts([sweep.numpy()], height_m, tilt):
        warn_user(str(difference))
    if height_m is not None and tilt is not None:
        return LidarPose(height_m=height_m, tilt=tilt)
    pose = lidar_pose([sweep.numpy()], tilt)
    if tilt is None and pose.tilt is not None:
        warn_user(
            f"by the road in its points the LiDAR is tilted, {pose.tilt}: detectors get the "
            "levelled cloud, and predictions stay in the LiDAR's own frame; give "
            "lidar_tilt_deg=(roll, pitch), (0, 0) if it is level",
        )
    if height_m is not None:
        if is_road_hidden([sweep.numpy()], pose):
            warn_user(UNKNOWN_TILT)
        return LidarPose(height_m=height_m, tilt=pose.tilt)
    if pose.height_m is not None and (doubt := describe_odd_height(pose.height_m)):
        warn_user(
            f"by the road in its points the LiDAR is {pose.height_m:.2f} m above it{doubt}",
        )
    if pose.height_m is None and len(sweep):
        warn_user(
            f"too little of the road is visible in the {len(sweep)} points to estimate the LiDAR's "
            f"height above it: KITTI's {KITTI_LIDAR_HEIGHT_M} m is assumed; give lidar_height_m",
        )
    return pose


def warn_of_axes(sweep: Float32[Tensor, "num_points 4"], calibration: Calibration) -> bool:
    """Warn, with the remedy, if a sweep's z axis does not point up; returns whether it warned."""
    doubt = axes_doubt(sweep.numpy(), calibration.camera_from_lidar.numpy())
    if doubt is None:
        return False
    problem, remedy = doubt
    warn_user(f"the cloud {problem}; {remedy}")
    return True

"""Mounting of the LiDAR of a KITTI tree or raw drive, from the road in a few of its clouds."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.drive_tree import DriveFrame
from sightline.data.entry_checks import select_spread
from sightline.data.frame_checks import read_or_note
from sightline.data.object_tree import ObjectFrame
from sightline.data.velodyne import read_sweep
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.road_height import (
    LidarPose,
    describe_lowness,
    lidar_pose,
    road_height_m,
    upright_turn,
)

_MIN_TILT_DEG: Final = 4.0
"""Smallest tilt to level: above the apparent tilt of any cloud of KITTI (3.3 degrees)."""
_MIN_HEIGHT_DIFFERENCE_M: Final = 0.5
"""Smallest difference to KITTI's height to use: errors on KITTI reach 0.43 m for single clouds
and 0.16 m for medians of three."""
_KITTI_POSE: Final = LidarPose(height_m=None, tilt=None)


def pose_of_tree(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> LidarPose:
    """Estimate the pose of a LiDAR over the road from the first cloud, the last and one between.

    A LiDAR tilted by less than 4 degrees is assumed to be level, and one whose height differs by
    less than 0.5 m from KITTI's, or whose clouds hardly show the road, to be mounted like KITTI's.

    Args:
        frames: All frames of a tree, so that any selection has the same pose.
    """
    paths = select_spread([frame.points for frame in frames if frame.points is not None])
    read = (read_or_note(read_sweep, path, []) for path in paths)
    sweeps = [sweep for sweep in read if sweep is not None]  # others: reported by their readers
    pose = lidar_pose(sweeps)
    if pose.tilt is not None and pose.tilt.angle_deg < _MIN_TILT_DEG:
        pose = replace(pose, tilt=None)
    if pose.tilt is None and not (_has_other_height(pose) and _is_road_visible(sweeps)):
        return _KITTI_POSE
    # Clouds with other axes have no such pose: they are reported by their own check.
    has_other_axes = any(upright_turn(sweep) is not None for sweep in sweeps)
    return _KITTI_POSE if has_other_axes else pose


def warn_of_mount(pose: LidarPose, folder: Path) -> None:
    """Warn of a found tilt and of a height other than KITTI's, with their consequences."""
    remedy = "make the data a recording with"
    if pose.tilt is not None:
        warnings.warn(
            f"{folder}: the road in its clouds shows that the LiDAR is tilted, {pose.tilt}: "
            "detectors get levelled clouds, and predictions stay in the LiDAR's frame; to set the "
            f"tilt, {remedy} lidar_tilt_deg (docs/recordings.md)",
            stacklevel=4,
        )
    for description in describe_height(pose):
        warnings.warn(
            f"{folder}: {description}; to set the height, {remedy} lidar_height_m "
            "(docs/recordings.md)",
            stacklevel=4,
        )


def describe_height(pose: LidarPose) -> tuple[str, ...]:
    """Describe a LiDAR's height in a clause; empty: like KITTI's."""
    if pose.height_m is None or not _has_other_height(pose):
        return ()
    return (
        f"the road in its clouds shows that the LiDAR is {pose.height_m:.2f} m above it, not "
        f"{KITTI_LIDAR_HEIGHT_M} m like KITTI's: detectors get clouds shifted in z by the "
        f"difference{describe_lowness(pose.height_m)}",
    )


def _is_road_visible(sweeps: Sequence[Float32[np.ndarray, "_num_points 4"]]) -> bool:
    return 2 * sum(road_height_m(sweep) is not None for sweep in sweeps) > len(sweeps)


def _has_other_height(pose: LidarPose) -> bool:
    height_m = pose.height_m
    return height_m is not None and abs(height_m - KITTI_LIDAR_HEIGHT_M) > _MIN_HEIGHT_DIFFERENCE_M

"""Mounting of the LiDAR of a KITTI tree or raw drive, from the road in a few of its clouds."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from sightline.data.drive_tree import DriveFrame
from sightline.data.entry_checks import draw
from sightline.data.frame_checks import read_or_note
from sightline.data.object_tree import ObjectFrame
from sightline.data.velodyne import read_sweep
from sightline.geometry.road_height import LidarPose, lidar_pose, upright_turn

_LEAST_TILT_DEG: Final = 4.0
"""Smallest tilt to level: above the apparent tilt of any cloud of KITTI (3.3 degrees)."""
_AS_KITTI: Final = LidarPose(height_m=None, tilt=None)


def pose_of_tree(frames: Sequence[ObjectFrame] | Sequence[DriveFrame]) -> LidarPose:
    """Estimate the pose of a LiDAR over the road from the first cloud, the last and one between.

    A LiDAR tilted by less than 4 degrees is assumed to be mounted like KITTI's.

    Args:
        frames: All frames of a tree, so that any selection has the same pose.
    """
    paths = draw([frame.points for frame in frames if frame.points is not None])
    read = (read_or_note(read_sweep, path, []) for path in paths)
    sweeps = [sweep for sweep in read if sweep is not None]  # others: reported by their readers
    pose = lidar_pose(sweeps)
    if pose.tilt is None or pose.tilt.angle_deg < _LEAST_TILT_DEG:
        return _AS_KITTI
    # Clouds with other axes have no tilt: they are reported by their own check.
    is_upturned = any(upright_turn(sweep) is not None for sweep in sweeps)
    return _AS_KITTI if is_upturned else pose


def warn_of_tilt(pose: LidarPose, folder: Path) -> None:
    """Warn of a found tilt, with its consequences."""
    if pose.tilt is not None:
        warnings.warn(
            f"{folder}: by the road in its clouds the LiDAR is tilted, {pose.tilt}: detectors see "
            "them levelled, and answers stay in the LiDAR's own frame; to give the tilt yourself "
            "make the data a recording with lidar_tilt_deg (docs/recordings.md)",
            stacklevel=4,
        )

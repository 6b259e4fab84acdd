"""Poses of the LiDAR during a drive."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.kitti_calibration import read_rigid_transform
from sightline.data.layouts.drive_times import drive_times
from sightline.data.layouts.kitti_trees import (
    OXTS_SUFFIXES,
    DriveFiles,
    describe_absent,
    list_files,
)
from sightline.files.plain_text import REMEDY, parse_numbers, read_text
from sightline.files.problem import FileError, Problem
from sightline.geometry.rotations import rotation_fault
from sightline.geometry.user_warning import warn_user

_EARTH_RADIUS_M = 6378137.0
_OXTS_FIELDS = 30
_MAX_ANGLE_RAD: Final = 2 * math.pi + 1e-3  # rounded
_MAX_SPEED_MPS: Final = 100.0
_MIN_LIMIT_M: Final = 10.0  # at any speed: GPS corrects itself by metres
_MAX_STEP_M: Final = 50.0  # between frames without times


def read_poses(path: Path | str) -> Float64[np.ndarray, "num_frames 4 4"]:
    """Read `world_from_lidar` from lines of 12 numbers: the upper 3x4 part, row by row.

    Raises:
        FileError: A line has a wrong number of values, or no valid rotation.
    """
    poses = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        words = line.split()
        if not words:
            continue
        if len(words) != 12:
            raise FileError(
                path,
                f"line {number} holds {len(words)} values, expected the 12 of a 3x4 pose",
                "correct the line",
            )
        pose = np.eye(4)
        pose[:3] = np.reshape(parse_numbers(words, path, f"line {number}:"), (3, 4))
        fault = rotation_fault(pose[:3, :3])
        if fault is not None:
            raise FileError(
                path,
                f"line {number}: its left 3x3 part is no rotation: {fault}",
                "correct the line",
            )
        poses.append(pose)
    return np.array(poses).reshape(-1, 4, 4)


def list_oxts(files: DriveFiles) -> list[Path]:
    """List the file of GPS and IMU readings of each frame of a drive, in order.

    Raises:
        ValueError: There is no folder of readings.
        FileError: Frames lack theirs.
    """
    if files.oxts is None:
        raise ValueError("the drive has no folder oxts/data; extract it or name a file of poses")
    readings = list_files(files.oxts, OXTS_SUFFIXES)
    names = [frame.sample_id for frame in files.frames]
    lacking = [name for name in names if name not in readings]
    if lacking:
        raise FileError(
            files.oxts,
            f"lacks the readings of {len(lacking)} of {len(names)} frames "
            f"({describe_absent(lacking)}), expected a file such as {lacking[0]}.txt for each",
            "extract it again or name a file of poses",
        )
    return [readings[name] for name in names]


def check_oxts(files: DriveFiles) -> list[Problem]:
    """Find problems of a drive's GPS and IMU readings: missing, unreadable or impossible ones."""
    try:
        times = drive_times(files)
    except FileError:
        times = None  # told with the times
    try:
        paths = list_oxts(files)
        readings = _read_readings(paths, times)
    except FileError as error:
        return [error.problem]
    doubt = _zeros_doubt(paths, readings)
    return [] if doubt is None else [doubt]


def read_oxts_poses(
    files: Sequence[Path],
    imu_to_velodyne: Path | str,
    times: Sequence[float] | None = None,
) -> Float64[np.ndarray, "num_frames 4 4"]:
    """Compute `world_from_lidar` from GPS and IMU readings; the world is the first LiDAR frame.

    Positions use the Mercator projection with true lengths at the first latitude, rotations are yaw
    after pitch after roll: Geiger et al. 2013, section 3, and the raw development kit. A warning
    tells readings that are all zeros.

    Args:
        files: `oxts/data/N.txt` of the frames, in order.
        imu_to_velodyne: `calib_imu_to_velo.txt`.
        times: Times [s] of the frames, if known.

    Raises:
        FileError: A file does not hold 30 numbers, latitude, longitude or an angle is out of range,
            or the position is farther from the one before than any car drives.
    """
    lidar_from_imu = read_rigid_transform(imu_to_velodyne)
    imu_from_lidar = np.linalg.inv(lidar_from_imu)
    readings = _read_readings(files, times)
    if not len(readings):
        return np.zeros((0, 4, 4))
    doubt = _zeros_doubt(files, readings)
    if doubt is not None:
        warn_user(str(doubt))
    poses = _poses_of(readings)
    world_from_mercator = lidar_from_imu @ np.linalg.inv(poses[0])
    world_from_lidar: Float64[np.ndarray, "num_frames 4 4"] = (
        world_from_mercator @ poses @ imu_from_lidar
    )
    return world_from_lidar


def _read_readings(
    files: Sequence[Path], times: Sequence[float] | None
) -> Float64[np.ndarray, "num_frames fields"]:
    """Read the fields of all files, and refuse impossible ones."""
    readings = np.array([_read_oxts(path) for path in files]).reshape(-1, _OXTS_FIELDS)
    if len(readings):
        readings[:, 1] = np.unwrap(readings[:, 1], period=360)  # across the date line
        _check_steps(files, _poses_of(readings)[:, :3, 3], times)
    return readings


def _read_oxts(path: Path) -> list[float]:
    values = parse_numbers(read_text(path).split(), path)
    if len(values) != _OXTS_FIELDS:
        raise FileError(
            path,
            f"holds {len(values)} numbers, expected the {_OXTS_FIELDS} of an OXTS reading",
            REMEDY,
        )
    latitude, longitude, _, *angles = values[:6]
    if not abs(latitude) < 90:
        raise FileError(
            path, f"has the latitude {latitude}, expected degrees between -90 and 90", REMEDY
        )
    if not abs(longitude) <= 180:
        raise FileError(
            path, f"has the longitude {longitude}, expected degrees from -180 to 180", REMEDY
        )
    for name, angle in zip(("roll", "pitch", "yaw"), angles, strict=True):
        if not abs(angle) <= _MAX_ANGLE_RAD:
            raise FileError(
                path,
                f"has the {name} {angle}, expected radians from -2 pi to 2 pi: it is probably in "
                "degrees",
                "write roll, pitch and yaw in radians",
            )
    return values


def _check_steps(
    files: Sequence[Path],
    positions_m: Float64[np.ndarray, "num_frames 3"],
    times: Sequence[float] | None,
) -> None:
    """Refuse positions that jump farther than a car drives between two frames.

    Raises:
        FileError: One does; names both files.
    """
    for place in range(1, len(files)):
        step_m = float(np.linalg.norm(positions_m[place] - positions_m[place - 1]))
        step_s = 0.0 if times is None else times[place] - times[place - 1]
        if step_s > 0:
            limit_m = max(_MAX_SPEED_MPS * step_s, _MIN_LIMIT_M)
            expected = f"at most {limit_m:.4g} m in {step_s:.4g} s"
        else:
            num_steps = _num_steps(files[place - 1].stem, files[place].stem)
            limit_m = _MAX_STEP_M * num_steps
            expected = f"at most {limit_m:.4g} m"
        if step_m > limit_m:
            raise FileError(
                files[place],
                f"lies {step_m:.4g} m from the frame before it, {files[place - 1]}, expected "
                f"{expected}",
                "correct the readings or name a file of poses",
            )


def _num_steps(earlier: str, later: str) -> int:
    """Difference of two frames' numbers, as where frames were lost; 1 for other names."""
    if not (f"{earlier}{later}".isascii() and earlier.isdecimal() and later.isdecimal()):
        return 1
    return max(int(later) - int(earlier), 1)


def _zeros_doubt(
    files: Sequence[Path], readings: Float64[np.ndarray, "num_frames fields"]
) -> Problem | None:
    if len(files) < 2 or readings[:, :6].any():
        return None
    return Problem(
        path=files[0].parent,
        problem=f"holds only zeros for place and direction in all {len(files)} readings, so the "
        "drive seems to stand still: the unit was probably not initialised",
        remedy="record them again or name a file of poses",
    )


def _poses_of(
    readings: Float64[np.ndarray, "num_frames fields"],
) -> Float64[np.ndarray, "num_frames 4 4"]:
    scale = math.cos(math.radians(readings[0, 0]))
    return np.array([_mercator_from_imu(reading, scale) for reading in readings.tolist()])


def _mercator_from_imu(reading: Sequence[float], scale: float) -> Float64[np.ndarray, "4 4"]:
    latitude, longitude, altitude, roll, pitch, yaw = reading[:6]
    mercator_from_imu = np.eye(4)
    mercator_from_imu[:3, :3] = _turn(yaw, 0, 1) @ _turn(pitch, 2, 0) @ _turn(roll, 1, 2)
    mercator_from_imu[:3, 3] = (
        scale * _EARTH_RADIUS_M * math.radians(longitude),
        scale * _EARTH_RADIUS_M * math.log(math.tan(math.radians(90 + latitude) / 2)),
        altitude,
    )
    return mercator_from_imu


def _turn(angle: float, source: int, target: int) -> Float64[np.ndarray, "3 3"]:
    """Rotation matrix that turns axis `source` towards axis `target` by `angle`."""
    rotation = np.eye(3)
    rotation[source, source] = rotation[target, target] = math.cos(angle)
    rotation[target, source] = math.sin(angle)
    rotation[source, target] = -math.sin(angle)
    return rotation

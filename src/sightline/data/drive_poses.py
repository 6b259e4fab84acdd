"""Poses and timestamps of the LiDAR during a drive."""

import math
import re
from collections.abc import Sequence
from datetime import datetime
from decimal import Decimal
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sightline.data.kitti_calibration import read_rigid_transform
from sightline.data.kitti_trees import DriveFiles
from sightline.data.recording_files import doubtful_steps
from sightline.files.plain_text import REMEDY, parse_numbers, read_text, shortened
from sightline.files.problem import FileError, Problem
from sightline.geometry.rotations import rotation_fault

_EARTH_RADIUS_M = 6378137.0
_OXTS_FIELDS = 30
_TIME_DIGITS = 9  # decimals of seconds: nanoseconds
_TIME = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(\.\d+)?", re.ASCII)


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


def read_timestamps(path: Path | str) -> Float64[np.ndarray, " num_frames"]:
    """Read lines such as "2011-09-26 13:02:25.964389445" as seconds since the first line.

    The seconds are rounded to nanoseconds, the precision of the file.

    Raises:
        FileError: A line is no date with a time.
    """
    moments: list[tuple[datetime, float]] = []
    for number, line in enumerate(read_text(path).split("\n"), start=1):
        if not line.strip():
            continue
        try:
            moments.append(_parse_time(line.strip()))
        except ValueError as error:
            raise FileError(
                path,
                f"line {number}: '{shortened(line.strip(), 40)}' is no time, expected one such as "
                "2011-09-26 13:02:25.964389445",
                REMEDY,
            ) from error
    if not moments:
        return np.zeros(0)
    first, first_fraction = moments[0]
    since = [(moment - first).total_seconds() + part - first_fraction for moment, part in moments]
    return np.round(np.array(since), _TIME_DIGITS)


def drive_times(files: DriveFiles) -> tuple[float, ...] | None:
    """Seconds since a raw drive's first frame, by the frames' numbers; None: there is no such file.

    Raises:
        FileError: The file cannot be read, or has too few times.
    """
    if files.timestamps is None:
        return None
    times = read_timestamps(files.timestamps)
    sample_ids = [frame.sample_id for frame in files.frames]
    if len(times) == len(sample_ids):
        lines = list(range(len(times)))
    else:  # KITTI has a time for every number, also for lost frames
        lines = [int(name) if name.isascii() and name.isdecimal() else -1 for name in sample_ids]
        if not 0 <= min(lines) <= max(lines) < len(times):
            raise FileError(
                files.timestamps,
                f"holds {len(times)} times, expected one for each of the {len(sample_ids)} frames, "
                "or for each number up to the last",
                "extract the drive again",
            )
    return tuple((times[lines] - times[lines[0]]).tolist())


def check_drive_times(files: DriveFiles) -> list[Problem]:
    """Find the problem of a raw drive's times: unreadable, or not rising."""
    try:
        times = drive_times(files)
    except FileError as error:
        return [error.problem]
    doubt = None if times is None else drive_times_doubt(files, times)
    return [] if doubt is None else [doubt]


def drive_times_doubt(files: DriveFiles, times: Sequence[float]) -> Problem | None:
    """Problem of a raw drive whose times do not rise from frame to frame, or have gaps; else None.

    Args:
        files: Files of the drive, with timestamps.
        times: Result of `drive_times`.
    """
    not_rising = [place for place in range(1, len(times)) if times[place] <= times[place - 1]]
    if files.timestamps is None:
        return None
    if not not_rising:
        names = [frame.sample_id for frame in files.frames]
        steps = doubtful_steps(list(zip(names, map(Decimal, times), strict=True)))
        if steps is None:
            return None
        return Problem(path=files.timestamps, problem=steps[0], remedy=steps[1])
    return Problem(
        path=files.timestamps,
        problem=f"has times that do not rise from frame to frame: {len(not_rising)} of "
        f"{len(times)}, such as that of {files.frames[not_rising[0]].sample_id}",
        remedy="correct them, or number the frames in the order in which they were taken",
    )


def read_oxts_poses(
    files: Sequence[Path], imu_to_velodyne: Path | str
) -> Float64[np.ndarray, "num_frames 4 4"]:
    """Compute `world_from_lidar` from GPS and IMU readings; the world is the first LiDAR frame.

    Positions use the Mercator projection with true lengths at the first latitude, rotations are yaw
    after pitch after roll: Geiger et al. 2013, section 3, and the raw development kit.

    Args:
        files: `oxts/data/N.txt` of the frames, in order.
        imu_to_velodyne: `calib_imu_to_velo.txt`.

    Raises:
        FileError: A file does not hold 30 numbers, or a latitude is not between -90 and 90 degrees.
    """
    lidar_from_imu = read_rigid_transform(imu_to_velodyne)
    imu_from_lidar = np.linalg.inv(lidar_from_imu)
    readings = [_read_oxts(path) for path in files]
    if not readings:
        return np.zeros((0, 4, 4))
    scale = math.cos(math.radians(readings[0][0]))
    poses = np.array([_mercator_from_imu(reading, scale) for reading in readings])
    world_from_mercator = lidar_from_imu @ np.linalg.inv(poses[0])
    world_from_lidar: Float64[np.ndarray, "num_frames 4 4"] = (
        world_from_mercator @ poses @ imu_from_lidar
    )
    return world_from_lidar


def _parse_time(text: str) -> tuple[datetime, float]:
    """Split a time into whole seconds and a fraction of nine digits, too many for a datetime."""
    match = _TIME.fullmatch(text)
    if match is None:
        raise ValueError
    return datetime.fromisoformat(match[1]), float(match[2] or 0)


def _read_oxts(path: Path) -> list[float]:
    values = parse_numbers(read_text(path).split(), path)
    if len(values) != _OXTS_FIELDS:
        raise FileError(
            path,
            f"holds {len(values)} numbers, expected the {_OXTS_FIELDS} of an OXTS reading",
            REMEDY,
        )
    if not abs(values[0]) < 90:
        raise FileError(
            path, f"has the latitude {values[0]}, expected degrees between -90 and 90", REMEDY
        )
    return values


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

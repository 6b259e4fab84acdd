"""Poses of the LiDAR during a drive."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sightline.data.kitti_calibration import read_rigid_transform
from sightline.files.plain_text import REMEDY, parse_numbers, read_text
from sightline.files.problem import FileError
from sightline.geometry.rotations import rotation_fault

_EARTH_RADIUS_M = 6378137.0
_OXTS_FIELDS = 30


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

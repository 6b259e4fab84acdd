"""Sweeps of walls, by sensors of any number of beams, for the held-out-rings protocol."""

from dataclasses import replace

import numpy as np
import torch

from sightline.geometry.calibration import Calibration
from sightline.structures.sample import CameraLidarSample

WALL_M = 10.0
SMALL = (60, 80)


def camera(image_size, *, focal_px=300.0, baseline_m=0.0):
    """Looks along x; its pixels are square. Sits `baseline_m` right of the LiDAR."""
    height, width = image_size
    intrinsics = [[focal_px, 0, width / 2, 0], [0, focal_px, height / 2, 0], [0, 0, 1, 0]]
    mount = [[0, -1, 0, -baseline_m], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    return Calibration(
        image_from_camera=torch.tensor(intrinsics, dtype=torch.float64),
        camera_from_lidar=torch.tensor(mount, dtype=torch.float64),
    )


def scan(ranges_m, *, tangents=(-0.13, 0.13), top=0.09, step=0.004):
    """One row of depths for each ring, from the top; from the right edge to the left."""
    num_rings, num_points = ranges_m.shape
    across = np.linspace(*tangents, num_points)
    down = top - step * np.arange(num_rings)
    left, up = across * ranges_m, down[:, None] * ranges_m
    points = np.stack((ranges_m, left, up, np.full_like(ranges_m, 0.5)), axis=-1)
    return torch.from_numpy(points.reshape(-1, 4).astype(np.float32))


def wall_sample(image_size=SMALL, *, num_rings=45, depth_m=WALL_M):
    # azimuths beyond 15 degrees on both sides, so that each ring ends with a jump back
    ranges = np.full((num_rings, 30), depth_m)
    return CameraLidarSample(
        sample_id="wall",
        calibration=camera(image_size, focal_px=60.0),
        image_size=image_size,
        points=scan(ranges, tangents=(-0.6, 0.6)),
    )


def turning_sample(num_lasers, *, image_size=SMALL, sample_id="turn", step=0.02):
    """A whole sweep of the inside of a cylinder, of lasers around the horizon."""
    azimuth = np.radians(np.arange(0.5, 360, 2.0))
    up = step * (num_lasers / 2 - np.arange(num_lasers))
    sweep = [(np.cos(azimuth), np.sin(azimuth), np.full_like(azimuth, each)) for each in up]
    xyz = WALL_M * np.stack(sweep).transpose(0, 2, 1).reshape(-1, 3)
    points = np.concatenate((xyz, np.full((len(xyz), 1), 0.5)), axis=1).astype(np.float32)
    return replace(wall_sample(image_size), sample_id=sample_id, points=torch.from_numpy(points))

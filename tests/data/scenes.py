"""Random scenes before a camera, for the tests of what changes samples."""

import math

import numpy as np
import torch
from hypothesis import settings
from hypothesis import strategies as st

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample
from tests.geometry.cameras import kitti_like_calibration

SIZE = (120, 400)  # of the middle of KITTI's image: the tests are many and images large
seeds = st.integers(0, 2**31)
few = settings(max_examples=20)  # each builds a scene


def sample_of(seed=0, *, num_points=300, **parts):
    """A random scene before a camera like KITTI's, whose image is small blocks of colour."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((3, -30, -2, 0), (70, 30, 2, 1), (num_points, 4)).astype(np.float32)
    blocks = rng.integers(0, 256, (3, 12, 20), dtype=np.uint8)
    image = blocks.repeat(10, axis=1).repeat(20, axis=2)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = rotation("z", 0.3) @ rotation("x", 0.1)
    pose[:3, 3] = torch.tensor([5.0, -7.0, 1.0])
    values = {
        "sample_id": f"random {seed}",
        "calibration": kitti_like_calibration().crop(420, 120),
        "image_size": SIZE,
        "image": torch.from_numpy(np.ascontiguousarray(image)),
        "points": torch.from_numpy(points),
        "depth": torch.from_numpy(rng.uniform(0, 80, SIZE).astype(np.float32)),
        "objects": two_objects(),
        "world_from_lidar": pose,
    }
    return CameraLidarSample(**{**values, **parts})


def two_objects():
    return ObjectLabels(
        class_names=("Car", "DontCare"),
        boxes2d=Boxes2D(torch.tensor([[100.0, 150, 220, 200], [500, 160, 520, 170]]).double()),
        boxes3d=Boxes3D(torch.tensor([[20.0, 6, -1, 4, 1.6, 1.5, 0.4], [0.0] * 7]).double()),
        truncation=torch.tensor([0.0, -1.0]).double(),
        occlusion=torch.tensor([0, -1]),
        alpha=torch.tensor([-1.6, -10.0]).double(),
    )


def rotation(axis, angle):
    cos, sin = math.cos(angle), math.sin(angle)
    rows = {
        "x": [[1, 0, 0], [0, cos, -sin], [0, sin, cos]],
        "y": [[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]],
        "z": [[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]],
    }
    return torch.tensor(rows[axis], dtype=torch.float64)

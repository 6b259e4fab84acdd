"""Camera, black picture and sample for tests of pictures."""

import numpy as np
import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample

IMAGE_SIZE = (120, 400)


@pytest.fixture
def calibration() -> Calibration:
    """Calibration: focal length 200 px, central principal point, camera at the LiDAR's position."""
    return Calibration(
        image_from_camera=torch.tensor(
            [[200.0, 0.0, 199.5, 0.0], [0.0, 200.0, 59.5, 0.0], [0.0, 0.0, 1.0, 0.0]],
            dtype=torch.float64,
        ),
        camera_from_lidar=torch.tensor(
            [
                [0.0, -1.0, 0.0, 0.0],
                [0.0, 0.0, -1.0, 0.0],
                [1.0, 0.0, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
            ],
            dtype=torch.float64,
        ),
    )


@pytest.fixture
def black() -> np.ndarray:
    return np.zeros((*IMAGE_SIZE, 3), np.uint8)


@pytest.fixture
def sample(calibration: Calibration) -> CameraLidarSample:
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(500, 4, generator=generator) * torch.tensor([40.0, 10.0, 2.0, 1.0])
    points -= torch.tensor([0.0, 5.0, 1.7, 0.0])
    return CameraLidarSample(
        sample_id="000042",
        calibration=calibration,
        image_size=IMAGE_SIZE,
        image=torch.randint(0, 256, (3, *IMAGE_SIZE), dtype=torch.uint8, generator=generator),
        points=points,
        objects=ObjectLabels(
            class_names=("Car", "DontCare"),
            boxes2d=Boxes2D(torch.tensor([[150.0, 40.0, 240.0, 90.0], [10.0, 10.0, 30.0, 30.0]])),
            boxes3d=Boxes3D(torch.tensor([[12.0, 0.0, -0.9, 4.0, 1.7, 1.5, 0.3], [0.0] * 7])),
            truncation=torch.tensor([0.0, -1.0], dtype=torch.float64),
            occlusion=torch.tensor([0, -1]),
            alpha=torch.tensor([0.3, -10.0], dtype=torch.float64),
        ),
    )

"""A camera and a mount like KITTI's, for the tests of this folder."""

import torch

from sightline.geometry.calibration import Calibration

IMAGE_FROM_CAMERA = [
    [721.5377, 0.0, 609.5593, 44.85728],
    [0.0, 721.5377, 172.854, 0.2163791],
    [0.0, 0.0, 1.0, 0.002745884],
]
CAMERA_FROM_LIDAR = [
    [0.0, -1.0, 0.0, -0.01],
    [0.0, 0.0, -1.0, -0.08],
    [1.0, 0.0, 0.0, -0.27],
    [0.0, 0.0, 0.0, 1.0],
]


def kitti_like_calibration() -> Calibration:
    return Calibration(
        image_from_camera=torch.tensor(IMAGE_FROM_CAMERA, dtype=torch.float64),
        camera_from_lidar=torch.tensor(CAMERA_FROM_LIDAR, dtype=torch.float64),
    )

"""Image region covered by points."""

from typing import Final

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from sightline.geometry.projection import project_points
from sightline.structures.sample import CameraLidarSample

_SPACING_PX: Final = 9  # spacing of neighbouring rings in KITTI's image, rather more than less


def region_of(
    points: Float32[np.ndarray, "num_points fields"], sample: CameraLidarSample
) -> Bool[Tensor, "height width"]:
    """Mark the pixels hit by points, and pixels between them up to the spacing of rings."""
    height, width = sample.image_size
    projected = project_points(torch.from_numpy(points[:, :3]).double(), sample.calibration)
    seen = projected.pixels[projected.in_image((height, width))].numpy()
    columns, rows = np.floor(seen + 0.5).astype(np.int64).T
    region = np.zeros((height, width), dtype=np.uint8)
    region[rows, columns] = 1
    kernel = np.ones((_SPACING_PX, _SPACING_PX), dtype=np.uint8)
    closed = cv2.morphologyEx(region, cv2.MORPH_CLOSE, kernel)
    return torch.from_numpy((closed > 0) | (region > 0))

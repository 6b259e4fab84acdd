"""Sensors that deliver nothing: Kim et al. 2018, section IV-A, "blank data"."""

from dataclasses import dataclass

import numpy as np
import torch

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    LidarCorruption,
    PointsChange,
    Sweep,
)
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraBlank(CameraCorruption):
    """A dead camera whose picture still comes, black; `data.faults.NoCamera` has no picture."""

    kind = "camera_blank"
    leaves_nothing = True

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Zeros; draws nothing."""
        del rng
        everywhere = torch.ones(sample.image_size, dtype=torch.bool)
        return ImageChange(torch.zeros_like(image), everywhere, {})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarBlank(LidarCorruption):
    """A dead LiDAR: a sweep without points, so that all its projected maps are zero."""

    kind = "lidar_blank"
    leaves_nothing = True

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """No points; draws nothing."""
        del rng
        everywhere = torch.ones(sample.image_size, dtype=torch.bool)
        return PointsChange(points.new_zeros(0, 4), everywhere, {})

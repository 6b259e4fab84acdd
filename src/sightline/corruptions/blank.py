"""Sensors without data: Kim et al. 2018, section IV-A, "blank data"."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    LidarCorruption,
    PointsChange,
    Sweep,
    everywhere,
    nowhere,
)
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraBlank(CameraCorruption):
    """Dead camera with a black image; `data.faults.NoCamera` has no image."""

    kind = "camera_blank"
    leaves_nothing = True

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Return zeros; no random draws."""
        del rng
        return ImageChange(torch.zeros_like(image), everywhere(sample), {})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarBlank(LidarCorruption):
    """Dead LiDAR: a sweep without points, so that all its projected maps are zero."""

    kind = "lidar_blank"
    leaves_nothing = True

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Return no points; no random draws."""
        del rng
        return _no_points(points, everywhere(sample))


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraFramesLost(CameraCorruption):
    """Camera with some black images, each with the same probability."""

    kind = "camera_blank"
    leaves_nothing = True

    chance: Annotated[float, Within(0, 1)] = 1.0

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Return zeros, or the unchanged image."""
        is_lost = rng.random() < self.chance
        if not is_lost:
            return ImageChange(image.clone(), nowhere(sample), {"is_lost": 0})
        return ImageChange(torch.zeros_like(image), everywhere(sample), {"is_lost": 1})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarFramesLost(LidarCorruption):
    """LiDAR with some sweeps without points, each with the same probability."""

    kind = "lidar_blank"
    leaves_nothing = True

    chance: Annotated[float, Within(0, 1)] = 1.0

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Return no points, or the unchanged sweep."""
        if rng.random() < self.chance:
            return _no_points(points, everywhere(sample))._replace(parameters={"is_lost": 1})
        return PointsChange(
            points.clone(), torch.arange(len(points)), nowhere(sample), {"is_lost": 0}
        )


def _no_points(points: Sweep, mask: Bool[Tensor, "height width"]) -> PointsChange:
    return PointsChange(points.new_zeros(0, 4), torch.zeros(0, dtype=torch.int64), mask, {})

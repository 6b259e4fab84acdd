"""Noise on the coordinates x, y, z of LiDAR points; reflectances are unchanged."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float32, Int64

from sightline.corruptions.corruption import (
    LidarCorruption,
    Parameter,
    PointsChange,
    Sweep,
    everywhere,
)
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarGaussianNoise(LidarCorruption):
    """Independent normal noise on each coordinate of each point."""

    kind = "lidar_gaussian_noise"

    sigma_m: Annotated[float, Within(0)]
    """Standard deviation."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Add noise; the same draws are scaled by the deviation."""
        noise_m = self.sigma_m * rng.standard_normal((len(points), 3), dtype=np.float32)
        return _moved(points, noise_m, sample, {"sigma_m": self.sigma_m})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarUniformNoise(LidarCorruption):
    """Independent uniform noise on each coordinate of each point."""

    kind = "lidar_uniform_noise"

    half_width_m: Annotated[float, Within(0)]
    """Maximum noise."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Add noise; the same draws are scaled by the width."""
        noise_m = self.half_width_m * (2 * rng.random((len(points), 3), dtype=np.float32) - 1)
        return _moved(points, noise_m, sample, {"half_width_m": self.half_width_m})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarImpulseNoise(LidarCorruption):
    """Fixed steps of some points in each coordinate, in either direction."""

    kind = "lidar_impulse_noise"

    share: Annotated[float, Within(0, 1)]
    """Share of the points, rounded down."""
    step_m: Annotated[float, Within(0)] = 0.1

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Add steps; draws an order, in which the first points are affected, and all signs."""
        chosen = rng.permutation(len(points))[: int(self.share * len(points) + 1e-9)]
        signs = 2 * rng.integers(0, 2, (len(points), 3)) - 1
        noise_m = _only_at(chosen, (self.step_m * signs).astype(np.float32))
        return _moved(points, noise_m, sample, {"num_points": len(chosen)})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarCrosstalk(LidarCorruption):
    """Crosstalk from pulses of other LiDARs: large, normally distributed errors of some points.

    Levels are from Dong et al. 2023, "Benchmarking robustness of 3D object detection to common
    corruptions".
    """

    kind = "lidar_crosstalk"

    share: Annotated[float, Within(0, 1)]
    """Share of the points, rounded."""
    sigma_m: Annotated[float, Within(0)] = 3.0
    """Standard deviation in each coordinate."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Add errors; draws an order, in which the first points are affected, and all noise."""
        chosen = rng.permutation(len(points))[: round(self.share * len(points))]
        noise_m = self.sigma_m * rng.standard_normal((len(points), 3), dtype=np.float32)
        noise_m = _only_at(chosen, noise_m)
        return _moved(points, noise_m, sample, {"num_points": len(chosen)})


def _only_at(
    chosen: Int64[np.ndarray, " num_chosen"], noise_m: Float32[np.ndarray, "num_points 3"]
) -> Float32[np.ndarray, "num_points 3"]:
    kept = np.zeros_like(noise_m)
    kept[chosen] = noise_m[chosen]
    return kept


def _moved(
    points: Sweep,
    shifts_m: Float32[np.ndarray, "num_points 3"],
    sample: CameraLidarSample,
    parameters: dict[str, Parameter],
) -> PointsChange:
    moved = points.clone()
    moved[:, :3] += torch.from_numpy(shifts_m)
    return PointsChange(moved, torch.arange(len(points)), everywhere(sample), parameters)

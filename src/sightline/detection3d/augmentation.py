"""Scenes changed for training, sweep and boxes together."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from sightline.data.augmentation import mirror, thin_rings
from sightline.data.scene_changes import scale_scene, turn_scene
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True)
class SceneChangeConfig:
    """How far scenes are changed; the defaults are those of Shi et al. 2019 (PointRCNN)."""

    mirror: bool = True
    """Whether every second scene is seen in a mirror."""
    turn_deg: float = 10.0
    """Scenes turn about the sensor by up to so much, either way."""
    scales: tuple[float, float] = (0.95, 1.05)
    """Smallest and largest factor on all lengths."""
    rise_m: float = 0.0
    """Scenes are lifted or lowered by up to so much."""
    slope_deg: float = 0.0
    """The ground is sheared upwards or downwards by up to so much, along x and along y each: roads
    are not flat, and cars pitch."""
    range_noise_m: float = 0.0
    """Standard deviation of an error of each point's range."""
    beams: tuple[int, ...] = (64,)
    """How many beams of KITTI's 64 a sweep keeps: one of these, each as likely."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        low, high = self.scales
        if not 0 < low <= high < math.inf:
            raise ValueError(f"changes.scales must be positive and in order, got {self.scales}")
        for name in ("turn_deg", "rise_m", "slope_deg", "range_noise_m"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"changes.{name} must be finite and not negative, got {value}")
        if self.slope_deg > _STEEPEST_DEG:
            raise ValueError(
                f"changes.slope_deg must be up to {_STEEPEST_DEG}, got {self.slope_deg}"
            )
        if not self.beams or any(count not in _BEAMS for count in self.beams):
            raise ValueError(f"changes.beams must hold some of {_BEAMS}, got {self.beams}")


_BEAMS = (64, 32, 16, 8)
_STEEPEST_DEG = 45.0


def change_scene(
    sample: CameraLidarSample, config: SceneChangeConfig, rng: np.random.Generator
) -> CameraLidarSample:
    """A sample as another street, mount or sensor would have given it.

    Rings are thinned first, as their order goes by the sweep as it was taken.
    """
    keep_every = _BEAMS[0] // int(rng.choice(np.array(config.beams)))
    if keep_every > 1:
        sample = thin_rings(sample, keep_every, int(rng.integers(keep_every)))
    if config.mirror and rng.random() < 0.5:
        sample = mirror(sample)
    sample = turn_scene(sample, rng.uniform(-config.turn_deg, config.turn_deg))
    sample = scale_scene(sample, rng.uniform(*config.scales))
    slopes = np.tan(np.radians(rng.uniform(-config.slope_deg, config.slope_deg, size=2)))
    rise_m = rng.uniform(-config.rise_m, config.rise_m)
    if config.slope_deg or config.rise_m:
        sample = lift_ground(sample, rise_m, float(slopes[0]), float(slopes[1]))
    return add_range_noise(sample, config.range_noise_m, rng) if config.range_noise_m else sample


def lift_ground(
    sample: CameraLidarSample, rise_m: float, slope_x: float, slope_y: float
) -> CameraLidarSample:
    """The sample with everything rise_m + slope_x * x + slope_y * y higher [m].

    A shear: boxes stay upright and go with the ground under their centres. The calibration stays,
    so that points leave their pixels: choose those in view before.
    """
    points, objects = sample.points, sample.objects
    if points is not None:
        points = points.clone()
        points[:, 2] += rise_m + slope_x * points[:, 0] + slope_y * points[:, 1]
    if objects is not None:
        boxes = objects.boxes3d.tensor.clone()
        lift = rise_m + slope_x * boxes[:, 0] + slope_y * boxes[:, 1]
        boxes[:, 2] += torch.where(objects.has_box3d, lift, 0.0)
        objects = replace(objects, boxes3d=Boxes3D(boxes))
    return replace(sample, points=points, objects=objects)


def add_range_noise(
    sample: CameraLidarSample, deviation_m: float, rng: np.random.Generator
) -> CameraLidarSample:
    """The sample with a normal error of each point's range along its ray.

    Raises:
        ValueError: The sample has no sweep.
    """
    if sample.points is None:
        raise ValueError(f"sample {sample.sample_id} has no sweep to change; give it points")
    points = sample.points.clone()
    ranges_m = points[:, :3].norm(dim=1, keepdim=True)
    errors_m = torch.from_numpy(rng.normal(scale=deviation_m, size=(len(points), 1))).float()
    points[:, :3] *= 1 + errors_m / ranges_m.clamp(min=1.0)
    return replace(sample, points=points)

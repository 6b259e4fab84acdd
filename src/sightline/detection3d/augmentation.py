"""Training augmentations that change sweep and boxes together."""

import math
from dataclasses import dataclass

import numpy as np
import torch

from sightline.augmentation.sample_changes import mirror, thin_rings
from sightline.augmentation.scene_changes import scale_scene, turn_scene
from sightline.augmentation.sweep_changes import (
    GroundShapeConfig,
    add_range_noise,
    bend_ground,
    draw_ground_shape,
    stretch_objects,
)
from sightline.detection3d.object_sampling import ObjectBank, ObjectSamplingConfig, paste_objects
from sightline.structures.sample import CameraLidarSample

_BEAMS = (64, 32, 16, 8)


@dataclass(frozen=True, kw_only=True)
class SceneChangeConfig:
    """Strengths of the scene augmentations; defaults from Shi et al. 2019 (PointRCNN)."""

    mirror: bool = True
    """Whether every second scene is mirrored."""
    turn_deg: float = 10.0
    """Largest rotation about the sensor, to either side."""
    scales: tuple[float, float] = (0.95, 1.05)
    """Smallest and largest factor on all lengths."""
    ground: GroundShapeConfig | None = None
    """Bending of the ground: roads are not flat, and cars pitch. None: no bending."""
    stretch: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Standard deviations of the logarithms of factors on each object's length, width, height."""
    range_noise_m: float = 0.0
    """Standard deviation of the noise on each point's range."""
    beams: tuple[int, ...] = (64,)
    """Choices, equally likely, of how many of KITTI's 64 beams a sweep keeps."""
    objects: ObjectSamplingConfig | None = None
    """Objects of other sweeps to paste into sweeps that keep all beams. None: none."""
    bank_frames: int = 1000
    """Largest number of training frames, drawn by the seed, whose objects are kept for pasting."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        low, high = self.scales
        if not 0 < low <= high < math.inf:
            raise ValueError(f"changes.scales must be positive and in order, got {self.scales}")
        for name in ("turn_deg", "range_noise_m"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"changes.{name} must be finite and not negative, got {value}")
        if not all(0 <= value < math.inf for value in self.stretch):
            raise ValueError(f"changes.stretch must be finite and not negative, got {self.stretch}")
        if not self.beams or any(count not in _BEAMS for count in self.beams):
            raise ValueError(f"changes.beams must hold some of {_BEAMS}, got {self.beams}")
        if self.bank_frames < 1:
            raise ValueError(f"changes.bank_frames must be at least 1, got {self.bank_frames}")


def change_scene(
    sample: CameraLidarSample,
    config: SceneChangeConfig,
    rng: np.random.Generator,
    bank: ObjectBank | None = None,
) -> CameraLidarSample:
    """Augment a sample as if another street, mount or sensor had given it.

    Rings are thinned first, because their order comes from the original sweep. Objects are pasted
    next, while the calibration still matches the camera's view.

    Args:
        sample: Sample with a sweep and labels.
        config: Strengths of the changes.
        rng: Source of all randomness.
        bank: Objects to paste, if the settings ask for pasting.
    """
    keep_every = _BEAMS[0] // int(rng.choice(np.array(config.beams)))
    if keep_every > 1:
        sample = thin_rings(sample, keep_every, int(rng.integers(keep_every)))
    elif config.objects is not None and bank is not None:
        sample = paste_objects(sample, bank, rng, config.objects)
    if any(config.stretch) and sample.objects is not None:
        logs = rng.normal(size=(len(sample.objects), 3)) * np.array(config.stretch)
        sample = stretch_objects(sample, torch.from_numpy(np.exp(logs)))
    if config.mirror and rng.random() < 0.5:
        sample = mirror(sample)
    sample = turn_scene(sample, rng.uniform(-config.turn_deg, config.turn_deg))
    sample = scale_scene(sample, rng.uniform(*config.scales))
    if config.ground is not None:
        sample = bend_ground(sample, draw_ground_shape(config.ground, rng))
    return add_range_noise(sample, config.range_noise_m, rng) if config.range_noise_m else sample

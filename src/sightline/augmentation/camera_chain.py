"""Augmentation with other lenses and image sensors.

The effects of a camera in their order: chromatic aberration and blur of the lens, colour balance
and noise of the sensor. They improve networks trained on rendered pictures: Carlson et al. 2018,
"Modeling Camera Effects to Improve Visual Learning from Synthetic Data".
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8

from sightline.structures.sample import CameraLidarSample

_MIN_BLUR_PX = 0.2  # a smaller blur has no effect
_LEVELS = 255


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraChainConfig:
    """Largest differences to the original camera; 0 disables an effect."""

    share: float = 0.5
    """Share of the pictures that are changed."""
    chromatic_px: float = 0.7
    """Largest shifts of red and of blue, drawn separately, against green at the picture's edge."""
    blur_px: float = 1.0
    """Largest standard deviation of the blur."""
    balance: float = 0.1
    """Range x of the colours' factors, drawn from [1 / (1 + x), 1 + x], uniform in log."""
    noise_levels: float = 8.0
    """Largest standard deviation of the noise on the brightest pixels; it falls with the square
    root of the light (photon noise), down to half on black pixels."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 0 <= self.share <= 1:
            raise ValueError(f"share must be from 0 to 1, got {self.share}")
        for name in ("chromatic_px", "blur_px", "balance", "noise_levels"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}")


def change_camera(
    sample: CameraLidarSample, rng: np.random.Generator, config: CameraChainConfig
) -> CameraLidarSample:
    """Simulate another camera in the same place; a sample without an image is unchanged."""
    if sample.image is None or rng.random() >= config.share:
        return sample
    image = np.ascontiguousarray(sample.image.permute(1, 2, 0).numpy())
    image = split_colors(image, *rng.uniform(-1, 1, size=2) * config.chromatic_px)
    blur_px = rng.uniform(0, config.blur_px)
    if blur_px >= _MIN_BLUR_PX:
        image = cv2.GaussianBlur(image, (0, 0), blur_px)
    gains = np.exp(rng.uniform(-1, 1, size=3) * math.log1p(config.balance))
    image = expose(image, gains, rng.uniform(0, config.noise_levels), rng)
    return replace(sample, image=torch.from_numpy(image).permute(2, 0, 1).contiguous())


def split_colors(
    image: UInt8[np.ndarray, "height width 3"], red_px: float, blue_px: float
) -> UInt8[np.ndarray, "height width 3"]:
    """Magnify red and blue about the centre, by the given shifts at the farther edge.

    Args:
        image: RGB image.
        red_px: Outward shift of red [px]; negative: inwards.
        blue_px: Outward shift of blue [px]; negative: inwards.
    """
    height, width = image.shape[:2]
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    planes = list(cv2.split(image))
    for channel, shift_px in ((0, red_px), (2, blue_px)):
        scale = 1 + shift_px / max(*middle, 1.0)
        to_new = np.column_stack((scale * np.eye(2), (1 - scale) * middle))
        planes[channel] = cv2.warpAffine(
            planes[channel], to_new, (width, height), borderMode=cv2.BORDER_REPLICATE
        )
    return cv2.merge(planes)


def expose(
    image: UInt8[np.ndarray, "height width 3"],
    gains: Float64[np.ndarray, "3"],
    noise_levels: float,
    rng: np.random.Generator,
) -> UInt8[np.ndarray, "height width 3"]:
    """Multiply each colour by a gain and add noise that grows with the square root of the light.

    Args:
        image: RGB image.
        gains: Gains of red, green and blue.
        noise_levels: Standard deviation on white; half of it on black.
        rng: Generator of the noise.
    """
    levels = np.arange(_LEVELS + 1, dtype=np.float32)
    light = cv2.LUT(image, (levels[:, None] * gains[None]).astype(np.float32)[None])
    deviation = noise_levels * np.sqrt(0.25 + 0.75 * levels / _LEVELS)
    noise: Float32[np.ndarray, "height width 3"] = rng.standard_normal(
        image.shape, dtype=np.float32
    )
    noise *= cv2.LUT(image, deviation.astype(np.float32))
    light += noise
    np.rint(light, out=light)
    np.clip(light, 0, _LEVELS, out=light)
    return light.astype(np.uint8)

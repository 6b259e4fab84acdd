"""Noise and dead pixels of a camera's sensor, and fast counts of photons."""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
import torch
from jaxtyping import Bool, Float64, UInt8
from scipy.stats import poisson
from torch import Tensor

from sightline.corruptions.corruption import CameraCorruption, Image, ImageChange, everywhere
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample

_DRAWS: Final = 1 << 16


def detect_photons(
    image: UInt8[Tensor, "channels height width"],
    mean_photons: Float64[np.ndarray, "256"],
    levels_per_photon: float,
    rng: np.random.Generator,
) -> UInt8[Tensor, "channels height width"]:
    """Simulate an image from photon counts: an independent Poisson number for each value.

    Numbers are drawn by inverting the distribution function at 2^16 evenly spaced places, so that
    probabilities are exact to 1e-5; individual draws take three times as long.

    Args:
        image: Image without noise.
        mean_photons: Mean number of photons for each of its 256 levels.
        levels_per_photon: Added level per photon; rounded, clipped to [0, 255].
        rng: Source of all randomness.
    """
    table = np.stack([_outcomes(mean, levels_per_photon) for mean in mean_photons.tolist()])
    drawn = rng.integers(0, _DRAWS, image.shape, dtype=np.uint16)
    places = image.numpy().astype(np.int32)
    places <<= 16
    places |= drawn
    return torch.from_numpy(table.reshape(-1)[places])


def _outcomes(mean: float, levels_per_photon: float) -> UInt8[np.ndarray, "draws"]:
    """Compute the levels of all draws, in ascending order of photons."""
    max_count = int(mean + 7 * np.sqrt(mean) + 12)
    counts = np.arange(max_count + 1)
    up_to = np.rint(_DRAWS * poisson.cdf(counts, mean)).astype(np.int64)
    up_to[-1] = _DRAWS
    levels = np.clip(np.rint(levels_per_photon * counts), 0, 255).astype(np.uint8)
    return np.repeat(levels, np.diff(up_to, prepend=0))


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraGaussianNoise(CameraCorruption):
    """Independent normal noise on every pixel and channel: Kim et al. 2018, section IV-A.

    The paper draws the variance "within the certain range" without giving it; here the standard
    deviation is drawn, uniformly.
    """

    kind = "camera_gaussian_noise"

    sigma_levels: Annotated[tuple[float, float], Within(0, 255)] = (20.0, 120.0)
    """Standard deviation in grey levels of 255."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `add_gaussian_noise`."""
        sigma_levels = rng.uniform(*self.sigma_levels)
        noisy = add_gaussian_noise(image, sigma_levels, rng)
        return ImageChange(noisy, everywhere(sample), {"sigma_levels": sigma_levels})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraUniformNoise(CameraCorruption):
    """Independent uniform noise on every pixel and channel."""

    kind = "camera_uniform_noise"

    half_width_levels: Annotated[float, Within(0, 255)]
    """Maximum noise in grey levels of 255."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `add_uniform_noise`."""
        noisy = add_uniform_noise(image, self.half_width_levels, rng)
        drawn = {"half_width_levels": self.half_width_levels}
        return ImageChange(noisy, everywhere(sample), drawn)


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraShotNoise(CameraCorruption):
    """Shot noise from low light: Hendrycks and Dietterich 2019, "shot noise"."""

    kind = "camera_shot_noise"

    full_scale_photons: Annotated[float, Within(0.1, 10000)]
    """Mean number of photons for a level of 255."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `detect_photons`."""
        means = self.full_scale_photons * np.arange(256) / 255
        noisy = detect_photons(image, means, 255 / self.full_scale_photons, rng)
        return ImageChange(
            noisy, everywhere(sample), {"full_scale_photons": self.full_scale_photons}
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraImpulseNoise(CameraCorruption):
    """Values set to 0 or 255 at random, per channel and equally likely ("salt and pepper")."""

    kind = "camera_impulse_noise"

    share: Annotated[float, Within(0, 1)]
    """Probability of replacing each value."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Replace values; in one draw, a larger share replaces all values of a smaller one."""
        del sample
        drawn = rng.random(image.shape, dtype=np.float32)
        noisy = image.numpy().copy()
        noisy[drawn < self.share / 2] = 0
        noisy[drawn >= 1 - self.share / 2] = 255
        mask = np.abs(drawn - 0.5).max(axis=0) >= 0.5 - self.share / 2
        # Rounding may put a value on the other side of the limit: the mask includes every change.
        mask |= (noisy != image.numpy()).any(axis=0)
        return ImageChange(torch.from_numpy(noisy), torch.from_numpy(mask), {"share": self.share})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraDeadPixels(CameraCorruption):
    """Dead pixels scattered over the sensor."""

    kind = "camera_dead_pixels"
    leaves_nothing = True

    share: Annotated[tuple[float, float], Within(0, 1)]
    """Share of the pixels; uniform distribution."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Set pixels from `draw_pixels` to black in all channels."""
        share = rng.uniform(*self.share)
        dead = draw_pixels(sample.image_size, share, rng)
        return ImageChange(image.masked_fill(dead, 0), dead, {"share": share})


def add_gaussian_noise(
    image: UInt8[Tensor, "channels height width"], sigma_levels: float, rng: np.random.Generator
) -> UInt8[Tensor, "channels height width"]:
    """Add normal noise of this standard deviation, rounded and clipped to [0, 255]."""
    noisy = rng.standard_normal(image.shape, dtype=np.float32)
    noisy *= sigma_levels
    noisy += image.numpy()
    np.rint(noisy, out=noisy)
    np.clip(noisy, 0, 255, out=noisy)
    return torch.from_numpy(noisy.astype(np.uint8))


def add_uniform_noise(
    image: UInt8[Tensor, "channels height width"],
    half_width_levels: float,
    rng: np.random.Generator,
) -> UInt8[Tensor, "channels height width"]:
    """Add uniform noise up to this width, rounded and clipped to [0, 255]."""
    noisy = rng.random(image.shape, dtype=np.float32)
    noisy -= 0.5
    noisy *= 2 * half_width_levels
    noisy += image.numpy()
    np.rint(noisy, out=noisy)
    np.clip(noisy, 0, 255, out=noisy)
    return torch.from_numpy(noisy.astype(np.uint8))


def draw_pixels(
    image_size: tuple[int, int], share: float, rng: np.random.Generator
) -> Bool[Tensor, "height width"]:
    """Draw exactly the rounded share of the pixels, with equal probabilities."""
    num_pixels = image_size[0] * image_size[1]
    chosen = rng.choice(num_pixels, round(share * num_pixels), replace=False, shuffle=False)
    mask = np.zeros(num_pixels, dtype=np.bool_)
    mask[chosen] = True
    return torch.from_numpy(mask.reshape(image_size))

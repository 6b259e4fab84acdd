"""A camera that adds something of its own to every picture."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from sightline.corruptions.corruption import CameraCorruption, Image, ImageChange, check_range
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraGaussianNoise(CameraCorruption):
    """Independent normal noise on every pixel and channel: Kim et al. 2018, section IV-A.

    They draw its variance "within the certain range" and name no range; drawn here is the standard
    deviation, evenly.
    """

    kind = "camera_gaussian_noise"

    sigma_levels: tuple[float, float] = (20.0, 120.0)
    """Standard deviation in grey levels of 255."""

    def __post_init__(self) -> None:
        """Checks the range."""
        check_range("sigma_levels", self.sigma_levels, 0, 255)

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """See `add_gaussian_noise`."""
        sigma_levels = rng.uniform(*self.sigma_levels)
        everywhere = torch.ones(sample.image_size, dtype=torch.bool)
        noisy = add_gaussian_noise(image, sigma_levels, rng)
        return ImageChange(noisy, everywhere, {"sigma_levels": sigma_levels})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraDeadPixels(CameraCorruption):
    """Pixels that deliver nothing, scattered over the sensor."""

    kind = "camera_dead_pixels"
    leaves_nothing = True

    share: tuple[float, float]
    """Of the pixels, drawn evenly."""

    def __post_init__(self) -> None:
        """Checks the range."""
        check_range("share", self.share, 0, 1)

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """See `draw_pixels`; all channels of a dead pixel are black."""
        share = rng.uniform(*self.share)
        dead = draw_pixels(sample.image_size, share, rng)
        return ImageChange(image.masked_fill(dead, 0), dead, {"share": share})


def add_gaussian_noise(
    image: UInt8[Tensor, "channels height width"], sigma_levels: float, rng: np.random.Generator
) -> UInt8[Tensor, "channels height width"]:
    """The image with normal noise of this standard deviation, rounded and kept in [0, 255]."""
    noisy = rng.standard_normal(image.shape, dtype=np.float32)
    noisy *= sigma_levels
    noisy += image.numpy()
    np.rint(noisy, out=noisy)
    np.clip(noisy, 0, 255, out=noisy)
    return torch.from_numpy(noisy.astype(np.uint8))


def draw_pixels(
    image_size: tuple[int, int], share: float, rng: np.random.Generator
) -> Bool[Tensor, "height width"]:
    """Exactly the rounded share of the pixels, each as likely as any other."""
    num_pixels = image_size[0] * image_size[1]
    chosen = rng.choice(num_pixels, round(share * num_pixels), replace=False, shuffle=False)
    mask = np.zeros(num_pixels, dtype=np.bool_)
    mask[chosen] = True
    return torch.from_numpy(mask.reshape(image_size))

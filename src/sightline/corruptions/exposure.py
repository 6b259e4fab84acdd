"""Wrong exposures of cameras, and blinding light on a part of the image."""

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    Parameter,
    everywhere,
)
from sightline.corruptions.noise import detect_photons
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraBrightness(CameraCorruption):
    """Increase of the largest channel of each pixel (V of HSV); hue and saturation stay."""

    kind = "camera_brightness"

    added_share: Annotated[float, Within(0, 1)]
    """Added share of full scale."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `add_value`; no random draws."""
        del rng
        brighter = add_value(image, 255 * self.added_share)
        return ImageChange(brighter, everywhere(sample), {"added_share": self.added_share})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraDarkness(CameraCorruption):
    """Night: white becomes grey, shadows become black, and photons are few.

    A level x in [0, 1] has the mean `peak` x^`gamma` and Poisson noise, after the low light of Kong
    et al. 2023 (RoboDepth).
    """

    kind = "camera_darkness"

    peak: Annotated[float, Within(0, 1)]
    """Mean of a white pixel, as a share of full scale."""
    gamma: Annotated[float, Within(0.1, 10)] = 2.0
    full_scale_photons: Annotated[float, Within(0.1, 10000)] = 255.0
    """Number of photons for a level of 255."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `detect_photons`."""
        means = self.full_scale_photons * self.peak * (np.arange(256) / 255) ** self.gamma
        dark = detect_photons(image, means, 255 / self.full_scale_photons, rng)
        return ImageChange(dark, everywhere(sample), {"peak": self.peak})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraContrast(CameraCorruption):
    """Reduced distance of each channel to its mean: Hendrycks and Dietterich 2019, "contrast"."""

    kind = "camera_contrast"

    factor: Annotated[float, Within(0, 1)]
    """Factor on the distance to the mean."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `reduce_contrast`; no random draws."""
        del rng
        flat = reduce_contrast(image, self.factor)
        return ImageChange(flat, everywhere(sample), {"factor": self.factor})


def add_value(
    image: UInt8[Tensor, "3 height width"], added_levels: float
) -> UInt8[Tensor, "3 height width"]:
    """Raise each pixel's largest channel by `added_levels`, up to 255, the others in proportion.

    Black becomes grey.
    """
    planes = image.numpy()
    value = planes.max(axis=0)
    raised = np.minimum(np.arange(256, dtype=np.float32) + added_levels, 255)
    factors = raised / np.maximum(np.arange(256, dtype=np.float32), 1)
    brighter = np.rint(planes * factors[value])
    brighter[:, value == 0] = np.rint(raised[0])
    return torch.from_numpy(np.clip(brighter, 0, 255).astype(np.uint8))


def reduce_contrast(
    image: UInt8[Tensor, "3 height width"], factor: float
) -> UInt8[Tensor, "3 height width"]:
    """Multiply each channel's distance to its mean by the factor, rounded."""
    levels = np.arange(256)
    planes = []
    for plane in image.numpy():
        mean = float(plane.mean())
        table = np.rint(mean + factor * (levels - mean)).astype(np.uint8)
        planes.append(cv2.LUT(np.ascontiguousarray(plane), table))
    return torch.from_numpy(np.stack(planes).astype(np.uint8, copy=False))


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraIllumination(CameraCorruption):
    """Bright disc: Kim et al. 2018, section IV-A, "abrupt illumination change".

    Its centre is anywhere in the image, and its edge is hard. The paper gives no range; the disc of
    Fig. 3b has about 361 px and 205 levels.
    """

    kind = "camera_illumination"

    radius_px: Annotated[tuple[float, float], Within(0)] = (100.0, 400.0)
    """Radius; uniform distribution."""
    added_levels: Annotated[tuple[int, int], Within(0, 255)] = (100, 230)
    """Integer grey levels of 255 added to all channels; uniform, including the upper limit."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `brighten` to a `disc_mask`."""
        height, width = sample.image_size
        centre_px = rng.uniform(-0.5, width - 0.5), rng.uniform(-0.5, height - 0.5)
        radius_px = rng.uniform(*self.radius_px)
        added_levels = int(rng.integers(*self.added_levels, endpoint=True))
        mask = disc_mask(sample.image_size, centre_px, radius_px)
        drawn: dict[str, Parameter] = {
            "centre_px": centre_px,
            "radius_px": radius_px,
            "added_levels": added_levels,
        }
        return ImageChange(brighten(image, mask, added_levels), mask, drawn)


def disc_mask(
    image_size: tuple[int, int], centre_px: tuple[float, float], radius_px: float
) -> Bool[Tensor, "height width"]:
    """Mark the pixels of a (height, width) image with centres within the radius from (x, y)."""
    height, width = image_size
    x = torch.arange(width, dtype=torch.float64) - centre_px[0]
    y = torch.arange(height, dtype=torch.float64) - centre_px[1]
    return x.square() + y.square()[:, None] <= radius_px**2


def brighten(
    image: UInt8[Tensor, "channels height width"],
    mask: Bool[Tensor, "height width"],
    added_levels: int,
) -> UInt8[Tensor, "channels height width"]:
    """Add levels to the masked pixels, up to 255."""
    headroom = 255 - image
    return torch.where(mask, image + headroom.clamp(max=added_levels), image)

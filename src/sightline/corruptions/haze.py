"""Fog before a camera: Koschmieder's law."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    check_number,
    everywhere,
)
from sightline.corruptions.scene_depth import scene_ranges
from sightline.structures.sample import CameraLidarSample

VISIBLE_CONTRAST = 0.05
"""Of what is as far away as one can see: the meteorological optical range."""

_BRIGHTEST_SHARE = 0.1
_LUMINANCE = np.array([0.299, 0.587, 0.114], dtype=np.float32)  # ITU-R BT.601


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraFog(CameraCorruption):
    """Homogeneous fog, the thicker the farther things are; distances are by `scene_ranges`."""

    kind = "camera_fog"
    needs_calibration = True
    revision = 3

    visibility_m: float
    """Meteorological optical range: where a contrast of 5 % is left."""

    def __post_init__(self) -> None:
        """Checks the visibility."""
        check_number("visibility_m", self.visibility_m, 0.1, 1e6)

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """See `veil`; draws nothing."""
        del rng
        ranges_m, source = scene_ranges(sample)
        extinction = extinction_per_m(self.visibility_m)
        airlight = airlight_level(image)
        foggy = to_levels(veil(image, ranges_m, extinction, airlight))
        said = {
            "visibility_m": self.visibility_m,
            "airlight_levels": airlight,
            "distances_from": source,
        }
        return ImageChange(foggy, everywhere(sample), said)


def extinction_per_m(visibility_m: float) -> float:
    """Extinction [1/m] of air with this meteorological optical range: -ln 0.05 / range."""
    return -math.log(VISIBLE_CONTRAST) / visibility_m


def airlight_level(image: UInt8[Tensor, "3 height width"]) -> float:
    """Grey level of light that the air scatters: the sky's, as He et al. 2009 take it.

    A lower one would part the sky that is seen as such from what is left of it elsewhere. By day
    the brightest tenth of the image is sky or lit by it; by night there is little light to scatter.
    """
    planes = image.numpy()[:, ::2, ::2]
    luminance = np.tensordot(_LUMINANCE, planes.astype(np.float32), axes=1).reshape(-1)
    count = max(1, round(_BRIGHTEST_SHARE * luminance.size))
    brightest = np.partition(luminance, -count)[-count:]
    return float(brightest.mean())


def veil(
    image: UInt8[Tensor, "channels height width"],
    ranges_m: Float32[np.ndarray, "height width"],
    extinction: float,
    airlight: float,
) -> Float32[np.ndarray, "channels height width"]:
    """The image through air: J t + A (1 - t), t = exp(-extinction range): Koschmieder 1924.

    As Sakaridis et al. 2018 (Foggy Cityscapes) apply it, on the levels as they are stored.

    Args:
        image: J, in clear air.
        ranges_m: Along the rays.
        extinction: Of the air [1/m].
        airlight: A, the level of what is infinitely far away.

    Returns:
        Levels, not rounded.
    """
    passing = np.exp(np.float32(-extinction) * ranges_m)
    veiled = image.numpy() * passing
    veiled += np.float32(airlight) * (1 - passing)
    return veiled


def to_levels(
    levels: Float32[np.ndarray, "channels height width"],
) -> UInt8[Tensor, "channels height width"]:
    """Rounded and kept in [0, 255]."""
    np.rint(levels, out=levels)
    np.clip(levels, 0, 255, out=levels)
    return torch.from_numpy(levels.astype(np.uint8))

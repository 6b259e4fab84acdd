"""Fog before a camera: Koschmieder's law."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from sightline.corruptions.corruption import CameraCorruption, Image, ImageChange, everywhere
from sightline.corruptions.scene_depth import scene_ranges
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample

VISIBLE_CONTRAST = 0.05
"""Remaining contrast at the meteorological optical range."""

_BRIGHTEST_SHARE = 0.1
_LUMINANCE = np.array([0.299, 0.587, 0.114], dtype=np.float32)  # ITU-R BT.601


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraFog(CameraCorruption):
    """Homogeneous fog, denser with distance; distances are from `scene_ranges`."""

    kind = "camera_fog"
    needs_calibration = True
    revision = 3

    visibility_m: Annotated[float, Within(0.1, 1000000.0)]
    """Meteorological optical range, at which 5 % of the contrast is left."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `veil`; no random draws."""
        del rng
        ranges_m, source = scene_ranges(sample)
        extinction = extinction_per_m(self.visibility_m)
        airlight = airlight_level(image)
        foggy = to_levels(veil(image, ranges_m, extinction, airlight))
        parameters = {
            "visibility_m": self.visibility_m,
            "airlight_levels": airlight,
            "distances_from": source,
        }
        return ImageChange(foggy, everywhere(sample), parameters)


def extinction_per_m(visibility_m: float) -> float:
    """Compute the extinction [1/m] from the meteorological optical range: -ln 0.05 / range."""
    return -math.log(VISIBLE_CONTRAST) / visibility_m


def airlight_level(image: UInt8[Tensor, "3 height width"]) -> float:
    """Estimate the grey level of the scattered light: the sky's, as in He et al. 2009.

    A lower level would separate visible sky from its remains elsewhere. By day the brightest tenth
    of the image is sky or lit by it; by night there is little light to scatter.
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
    """Apply haze to an image: J t + A (1 - t), t = exp(-extinction range): Koschmieder 1924.

    As in Sakaridis et al. 2018 (Foggy Cityscapes), it is applied to the stored levels.

    Args:
        image: J, in clear air.
        ranges_m: Ranges along the rays.
        extinction: Extinction of the air [1/m].
        airlight: A, the level at infinite distance.

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
    """Round and clip to [0, 255]."""
    np.rint(levels, out=levels)
    np.clip(levels, 0, 255, out=levels)
    return torch.from_numpy(levels.astype(np.uint8))

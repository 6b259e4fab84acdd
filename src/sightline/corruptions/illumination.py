"""Blinding light on a part of the camera image."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    Parameter,
)
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample


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

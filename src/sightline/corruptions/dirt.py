"""Mud on the camera's lens or window."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float32

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
)
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraDirt(CameraCorruption):
    """Soft, dark brown blobs, out of focus at this small distance; they transmit some light."""

    kind = "camera_dirt"

    num_blobs: Annotated[int, Within(0, 100000)]
    radius_share: Annotated[tuple[float, float], Within(0, 10)] = (0.03, 0.12)
    """Radius as a share of the image's height; uniform distribution."""
    opacity: Annotated[tuple[float, float], Within(0, 1)] = (0.6, 0.97)
    """Opacity at a blob's middle; uniform distribution."""
    color: Annotated[tuple[float, float, float], Within(0, 255)] = (62.0, 54.0, 44.0)
    """RGB in levels of 255."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Draw the blobs one after the other; see `soft_blob`."""
        height, width = sample.image_size
        passing = np.ones((height, width), dtype=np.float32)
        for _ in range(self.num_blobs):
            centre_px = rng.uniform(-0.5, width - 0.5), rng.uniform(-0.5, height - 0.5)
            radius_px = max(rng.uniform(*self.radius_share) * height, 1.0)
            cover(passing, centre_px, radius_px, rng.uniform(*self.opacity))
        planes = image.numpy()
        dirty = np.empty_like(planes)
        for plane, level, out in zip(planes, self.color, dirty, strict=True):
            out[:] = np.rint(level + (plane - np.float32(level)) * passing)
        mask = torch.from_numpy(passing < 1)
        return ImageChange(torch.from_numpy(dirty), mask, {"num_blobs": self.num_blobs})


def cover(
    passing: Float32[np.ndarray, "height width"],
    centre_px: tuple[float, float],
    radius_px: float,
    opacity: float,
) -> None:
    """Reduce the light through a blob, in place: to 1 - opacity (1 - d^4)^2 of it at d radii.

    Args:
        passing: Share of the light that passes each pixel.
        centre_px: x, y.
        radius_px: Radius of the blob's edge.
        opacity: Opacity at its middle.
    """
    height, width = passing.shape
    x, y = centre_px
    left, right = (int(np.clip(x + side * radius_px, -1, width)) for side in (-1, 1))
    top, bottom = (int(np.clip(y + side * radius_px, -1, height)) for side in (-1, 1))
    window = slice(max(top, 0), bottom + 2), slice(max(left, 0), right + 2)
    rows, columns = (
        np.arange(size, dtype=np.float32)[part]
        for size, part in zip((height, width), window, strict=True)
    )
    distance = ((columns - x) ** 2 + ((rows - y) ** 2)[:, None]) / radius_px**2
    weight = np.clip(1 - distance**2, 0, None) ** 2
    passing[window] *= (1 - opacity * weight).astype(np.float32)

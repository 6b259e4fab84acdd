"""Dirt on the windscreen in front of a camera: specks, a film, and the edges of the wiped arc."""

from typing import Final, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32

_COARSE: Final = 8
"""Side length [px] of a cell of the pattern: the lens is focused far behind the windscreen."""
_SPECKS: Final = 140.0  # number of specks on a wholly dirty windscreen
_SPECK_RADII: Final = (0.003, 0.02)  # shares of the image's width
_SPECK_COVER: Final = (0.15, 0.75)
_FILM: Final = 0.22  # mean cover by the film on a wholly dirty windscreen
_UNWIPED: Final = 0.3  # further cover outside the wiped arc
_GLOW: Final = 0.55  # radiance of lit dirt, as a share of the image's mean


class Dirt(NamedTuple):
    """Share of each pixel's light that dirt keeps back."""

    cover: Float32[np.ndarray, "height width"]


def draw_dirt(rng: np.random.Generator, image_size: tuple[int, int], amount: float) -> Dirt:
    """Draw the dirt of a windscreen; an amount of 0 is clean, 1 as dirty as one can drive with."""
    height, width = (-(-side // _COARSE) for side in image_size)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    clouds = cv2.resize(rng.random((5, 9), np.float32), (width, height))
    clouds = cv2.GaussianBlur(clouds, (0, 0), max(width / 20, 1.0))
    cover = np.float32(_FILM * amount) * clouds * 2
    # The wiper turns about a point below the image.
    pivot_x, pivot_y = width * rng.uniform(0.1, 0.9), height * rng.uniform(1.1, 1.6)
    reach = height * rng.uniform(1.0, 1.6)
    outside = np.clip((np.hypot(x - pivot_x, y - pivot_y) - reach) / (0.02 * width), 0, 1)
    cover += np.float32(_UNWIPED * amount) * outside.astype(np.float32)
    specks = np.zeros((height, width), np.float32)
    for _ in range(int(rng.poisson(_SPECKS * amount))):
        place = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        axes = np.maximum(width * rng.uniform(*_SPECK_RADII, 2), 0.7).round().astype(int).tolist()
        patch = np.zeros_like(specks)
        cv2.ellipse(
            patch, place, axes, float(rng.uniform(0, 180)), 0, 360, rng.uniform(*_SPECK_COVER), -1
        )
        np.maximum(specks, patch, out=specks)
    soft = cv2.GaussianBlur(specks, (0, 0), max(0.006 * width, 0.5))
    kept_back = (1 - (1 - cover.clip(0, 0.9)) * (1 - soft)).astype(np.float32)
    size = image_size[::-1]
    return Dirt(cv2.resize(kept_back, size, interpolation=cv2.INTER_LINEAR).astype(np.float32))


def seen_through(
    dirt: Dirt, radiance: Float32[np.ndarray, "height width 3"]
) -> Float32[np.ndarray, "height width 3"]:
    """Dim the light behind dirt and add the light that the dirt itself scatters to the camera."""
    glow = np.float32(_GLOW) * radiance.reshape(-1, 3).mean(axis=0, dtype=np.float32)
    return np.asarray(radiance + dirt.cover[..., None] * (glow - radiance))

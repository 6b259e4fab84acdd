"""Motion blur, defocus and strong compression of camera images, and mud on the lens."""

import math
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
import torch
from jaxtyping import Float32, UInt8
from torch import Tensor

from sightline.corruptions.corruption import CameraCorruption, Image, ImageChange, everywhere
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
        """Draw the blobs one after the other."""
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


_FINE = 8  # samples per side of a pixel, of a disc


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraMotionBlur(CameraCorruption):
    """Even motion of the image along a line during the exposure."""

    kind = "camera_motion_blur"

    length_px: Annotated[float, Within(1, 1000)]

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply a `line_kernel`; the angle is drawn uniformly."""
        angle_deg = rng.uniform(0, 180)
        blurred = blur(image, line_kernel(self.length_px, angle_deg))
        drawn = {"length_px": self.length_px, "angle_deg": angle_deg}
        return ImageChange(blurred, everywhere(sample), drawn)


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraDefocus(CameraCorruption):
    """Defocus: each point of the scene is a disc in the image."""

    kind = "camera_defocus"

    radius_px: Annotated[float, Within(0, 1000)]

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply a `disc_kernel`; no random draws."""
        del rng
        blurred = blur(image, disc_kernel(self.radius_px))
        return ImageChange(blurred, everywhere(sample), {"radius_px": self.radius_px})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraJpeg(CameraCorruption):
    """JPEG compression of low quality."""

    kind = "camera_jpeg"

    quality: Annotated[int, Within(1, 100)]
    """Quality of libjpeg, from 1 to 100."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Compress and decompress; no random draws."""
        del rng
        pixels = np.ascontiguousarray(image.numpy().transpose(1, 2, 0)[..., ::-1])
        is_stored, stored = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        assert is_stored, "an 8-bit image can be stored"
        read = cv2.imdecode(stored, cv2.IMREAD_COLOR)
        assert read is not None, "a stored JPEG can be read"
        planes = np.ascontiguousarray(read[..., ::-1].transpose(2, 0, 1))
        return ImageChange(torch.from_numpy(planes), everywhere(sample), {"quality": self.quality})


def line_kernel(length_px: float, angle_deg: float) -> Float32[np.ndarray, "side side"]:
    """Make a line kernel through the middle, counter-clockwise from the right, of sum 1.

    Its points, a hundredth of a pixel apart or less, are shared among the four pixels around each.
    """
    reach = (length_px - 1) / 2
    half = math.ceil(reach)
    places = np.linspace(-reach, reach, 100 * half + 1)
    x = half + places * math.cos(math.radians(angle_deg))
    y = half - places * math.sin(math.radians(angle_deg))
    kernel = np.zeros((2 * half + 3, 2 * half + 3))  # with a border for the rounding
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    right, below = x - column, y - row
    for down, row_weight in ((0, 1 - below), (1, below)):
        for across, column_weight in ((0, 1 - right), (1, right)):
            np.add.at(kernel, (row + down + 1, column + across + 1), row_weight * column_weight)
    normed: Float32[np.ndarray, "side side"] = (kernel / kernel.sum()).astype(np.float32)
    return normed


def disc_kernel(radius_px: float) -> Float32[np.ndarray, "side side"]:
    """Make a disc kernel of even weight and sum 1; rim pixels have their covered share."""
    half = math.ceil(radius_px)
    parts = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    places = (np.arange(-half, half + 1)[:, None] + parts).reshape(-1)
    inside = places**2 + places[:, None] ** 2 <= radius_px**2
    side = 2 * half + 1
    kernel = inside.reshape(side, _FINE, side, _FINE).mean(axis=(1, 3))
    if not kernel.any():
        kernel[half, half] = 1
    normed: Float32[np.ndarray, "side side"] = (kernel / kernel.sum()).astype(np.float32)
    return normed


def blur(
    image: UInt8[Tensor, "channels height width"], kernel: Float32[np.ndarray, "side side"]
) -> UInt8[Tensor, "channels height width"]:
    """Filter the image and round it; the border is mirrored about the outermost pixels."""
    planes = [
        cv2.filter2D(np.ascontiguousarray(plane), -1, kernel, borderType=cv2.BORDER_REFLECT_101)
        for plane in image.numpy()
    ]
    return torch.from_numpy(np.stack(planes).astype(np.uint8, copy=False))

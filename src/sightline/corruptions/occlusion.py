"""Occlusion of a sensor: Kim et al. 2018, section IV-A, "random occlusion"."""

from dataclasses import astuple, dataclass, field

import numpy as np
from jaxtyping import Float32, UInt8
from torch import Tensor

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    LidarCorruption,
    PointsChange,
    Sweep,
)
from sightline.corruptions.pixel_box import AreaDrawing, BoxDrawing, PixelBox
from sightline.geometry.calibration import Calibration
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraOcclusion(CameraCorruption):
    """Black box in the image."""

    kind = "camera_occlusion"
    leaves_nothing = True

    box: BoxDrawing | AreaDrawing = field(default_factory=BoxDrawing)

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `occlude_image`."""
        box = self.box.draw(sample, rng)
        return ImageChange(
            occlude_image(image, box), box.mask(sample.image_size), {"box_px": astuple(box)}
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarOcclusion(LidarCorruption):
    """Empty box in the sweep's projected maps."""

    kind = "lidar_occlusion"
    leaves_nothing = True

    box: BoxDrawing = field(default_factory=BoxDrawing)

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Apply `occlude_points`."""
        box = self.box.draw(sample, rng)
        kept = ~box.holds(points, sample.calibration)
        return PointsChange(
            points[kept],
            kept.nonzero()[:, 0],
            box.mask(sample.image_size),
            {"box_px": astuple(box)},
        )


def occlude_image(
    image: UInt8[Tensor, "channels height width"], box: PixelBox
) -> UInt8[Tensor, "channels height width"]:
    """Set the box's pixels to black."""
    occluded = image.clone()
    occluded[(..., *box.window)] = 0
    return occluded


def occlude_points(
    points: Float32[Tensor, "num_points 4"], calibration: Calibration, box: PixelBox
) -> Float32[Tensor, "num_left 4"]:
    """Remove the points, at any depth, that project to the box's pixels.

    Every projected map is then zero there and unchanged elsewhere. The order of the points stays.
    """
    return points[~box.holds(points, calibration)]

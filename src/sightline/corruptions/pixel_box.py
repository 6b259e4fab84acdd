"""Boxes of whole pixels, and their random draws."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.geometry.choices import check_choices
from sightline.geometry.projection import project_points
from sightline.geometry.ranges import Within, check_ranges
from sightline.structures.sample import CameraLidarSample

_NO_OBJECT = "DontCare"  # KITTI's name for a region of unknown content


@dataclass(frozen=True, slots=True)
class PixelBox:
    """Box of the columns `left` to below `right` and rows `top` to below `bottom` of an image."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def window(self) -> tuple[slice, slice]:
        """Index of its rows and columns in a map of height and width."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def mask(self, image_size: tuple[int, int]) -> Bool[Tensor, "height width"]:
        """Mark its pixels in an image of (height, width)."""
        mask = torch.zeros(image_size, dtype=torch.bool)
        mask[self.window] = True
        return mask

    def holds(
        self, points: Float32[Tensor, "num_points 4"], calibration: Calibration
    ) -> Bool[Tensor, " num_points"]:
        """Test which LiDAR points [m] project to its pixels, as in `sparse_depth_map`."""
        # In float64 throughout: a rounded pixel may be the neighbour.
        columns, rows = project_points(points[:, :3].double(), calibration).pixels.unbind(dim=-1)
        # NaN, the pixel of a point not in front of the camera, fails the comparison.
        inside = (columns >= self.left - 0.5) & (columns < self.right - 0.5)
        return inside & (rows >= self.top - 0.5) & (rows < self.bottom - 0.5)


@dataclass(frozen=True, kw_only=True)
class BoxDrawing:
    """Distribution of a box's size and place; each number is uniform.

    Kim et al. 2018, section IV-A, give no numbers; in their Fig. 3d the box is about 0.5 by 0.63.
    """

    width_share: Annotated[tuple[float, float], Within(0, 1)] = (0.2, 0.6)
    """Share of the image's width."""
    height_share: Annotated[tuple[float, float], Within(0, 1)] = (0.3, 0.65)
    """Share of the image's height."""
    placement: Literal["object", "uniform"] = "object"
    """Centre of the box: the centre of a random labelled object's 2D box (not of DontCare), or
    anywhere in the image. Without an object it is anywhere."""

    def __post_init__(self) -> None:
        """Check the choices and the ranges."""
        check_choices(self)
        check_ranges(self)

    def draw(self, sample: CameraLidarSample, rng: np.random.Generator) -> PixelBox:
        """Draw a box of at least one pixel, clipped at the image's border."""
        height, width = sample.image_size
        box_width = max(1, round(rng.uniform(*self.width_share) * width))
        box_height = max(1, round(rng.uniform(*self.height_share) * height))
        x, y = rng.uniform(-0.5, width - 0.5), rng.uniform(-0.5, height - 0.5)
        if self.placement == "object":
            x, y = _object_centre(sample, rng) or (x, y)
        # The box's centre, within the image, is on one of its pixels, so at least one is left.
        left = round(min(max(x, 0), width - 1) - (box_width - 1) / 2)
        top = round(min(max(y, 0), height - 1) - (box_height - 1) / 2)
        return PixelBox(
            max(left, 0),
            max(top, 0),
            min(left + box_width, width),
            min(top + box_height, height),
        )


@dataclass(frozen=True, kw_only=True)
class AreaDrawing:
    """Distribution of a box of a given area: its shape within bounds, its place as in `BoxDrawing`.

    The whole box lies in the image, so that it has the given area, up to the rounding of its sides.
    """

    area_share: Annotated[float, Within(0, 1)]
    """Share of the image's area."""
    aspect: Annotated[tuple[float, float], Within(0.01, 100.0)] = (0.5, 2.0)
    """Width over height, each as a share of the image's; log-uniform distribution."""
    placement: Literal["object", "uniform"] = "object"
    """See `BoxDrawing.placement`; the box is then moved into the image."""

    def __post_init__(self) -> None:
        """Check the choices and the ranges."""
        check_choices(self)
        check_ranges(self)

    def draw(self, sample: CameraLidarSample, rng: np.random.Generator) -> PixelBox:
        """Draw a box of at least one pixel."""
        height, width = sample.image_size
        aspect = math.exp(rng.uniform(math.log(self.aspect[0]), math.log(self.aspect[1])))
        # A side longer than the image's is cut to that length, and the other is extended in turn.
        width_share = min(max(math.sqrt(self.area_share * aspect), self.area_share), 1)
        box_width = max(1, round(width_share * width))
        box_height = max(1, round(self.area_share / max(width_share, 1e-9) * height))
        x, y = rng.uniform(-0.5, width - 0.5), rng.uniform(-0.5, height - 0.5)
        if self.placement == "object":
            x, y = _object_centre(sample, rng) or (x, y)
        left = min(max(round(x - (box_width - 1) / 2), 0), width - box_width)
        top = min(max(round(y - (box_height - 1) / 2), 0), height - box_height)
        return PixelBox(left, top, left + box_width, top + box_height)


def _object_centre(
    sample: CameraLidarSample, rng: np.random.Generator
) -> tuple[float, float] | None:
    """Draw the centre [px] of a random object's 2D box; None if there is none."""
    if sample.objects is None:
        return None
    rows = [row for row, name in enumerate(sample.objects.class_names) if name != _NO_OBJECT]
    if not rows:
        return None
    box = sample.objects.boxes2d.tensor[rows[rng.integers(len(rows))]]
    x_min, y_min, x_max, y_max = box.tolist()
    return (x_min + x_max) / 2, (y_min + y_max) / 2

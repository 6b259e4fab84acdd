"""Augmentation of sweeps and their 3D labels for detectors: ground, noise, sizes of objects.

Each function returns a new sample with consistent points and 3D boxes. Image and calibration stay
unchanged: images no longer fit a bent scene.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from sightline.augmentation.sample_changes import sweep_of
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import yaw_rotation
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundShape:
    """Change of the ground's height by position: a tilted and curved surface."""

    height_m: float = 0.0
    """Constant rise [m], like another mounting height of the sensor."""
    slope_x: float = 0.0
    """Rise per metre ahead [m]."""
    slope_y: float = 0.0
    """Rise per metre to the left [m]."""
    curvature_per_m: float = 0.0
    """Rise by the square of the metres ahead: the foot of a hill, or its top."""

    def __post_init__(self) -> None:
        """Check that the numbers are finite."""
        values = (self.height_m, self.slope_x, self.slope_y, self.curvature_per_m)
        if not all(map(math.isfinite, values)):
            raise ValueError(f"the ground's shape needs finite numbers, got {self}")


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundShapeConfig:
    """Standard deviations of normally distributed changes of the ground's shape."""

    mean_height_m: float = 0.05
    """Mean of the height; the other means are 0."""
    height_m: float = 0.08
    """Standard deviation of the height."""
    slope_x: float = 0.008
    """Standard deviation of the slope ahead."""
    slope_y: float = 0.012
    """Standard deviation of the slope to the left."""
    curvature_per_m: float = 8e-5
    """Standard deviation of the curvature."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not math.isfinite(self.mean_height_m):
            raise ValueError(f"mean_height_m must be finite, got {self.mean_height_m}")
        for name in ("height_m", "slope_x", "slope_y", "curvature_per_m"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}")


def draw_ground_shape(config: GroundShapeConfig, rng: np.random.Generator) -> GroundShape:
    """Draw a random shape of the ground."""
    height, slope_x, slope_y, curvature = map(float, rng.normal(size=4))
    return GroundShape(
        height_m=config.mean_height_m + config.height_m * height,
        slope_x=config.slope_x * slope_x,
        slope_y=config.slope_y * slope_y,
        curvature_per_m=config.curvature_per_m * curvature,
    )


def bend_ground(sample: CameraLidarSample, shape: GroundShape) -> CameraLidarSample:
    """Change the shape of the ground.

    Points rise by the shape at their position, boxes by the shape at their centre; boxes stay
    upright, like KITTI's on slopes. Rows of zeros, for objects without a 3D part, stay.
    """
    points, objects = sample.points, sample.objects
    if points is not None:
        points = points.clone()
        points[:, 2] += _rise_m(points, shape).float()
    if objects is not None:
        boxes = objects.boxes3d.tensor.clone()
        boxes[:, 2] += torch.where(objects.has_box3d, _rise_m(boxes, shape).to(boxes.dtype), 0.0)
        objects = replace(objects, boxes3d=Boxes3D(boxes))
    return replace(sample, points=points, objects=objects)


def _rise_m(
    places: Float[Tensor, "num_places fields"], shape: GroundShape
) -> Float[Tensor, " num_places"]:
    x, y = places[:, 0].double(), places[:, 1].double()
    return (
        shape.height_m + shape.slope_x * x + shape.slope_y * y + shape.curvature_per_m * x.square()
    )


def add_range_noise(
    sample: CameraLidarSample, deviation_m: float, rng: np.random.Generator
) -> CameraLidarSample:
    """Add normally distributed range errors along the rays.

    Points stay on their rays, so ring numbers and azimuths stay. A point at the sensor stays, and
    no point moves beyond it. Labels stay.

    Raises:
        ValueError: The sample has no sweep, or the deviation is negative or not finite.
    """
    if not 0 <= deviation_m < math.inf:
        raise ValueError(f"deviation_m must be finite and not negative, got {deviation_m}")
    points = sweep_of(sample).clone()
    rays = points[:, :3].double()
    range_m = rays.norm(dim=1)
    error_m = deviation_m * torch.from_numpy(rng.normal(size=len(points)))
    factor = 1 + error_m / range_m.clamp(min=1e-9)
    points[:, :3] = (rays * factor.clamp(min=0)[:, None]).float()
    return replace(sample, points=points)


def stretch_objects(
    sample: CameraLidarSample, factors: Float64[Tensor, "num_objects 3"]
) -> CameraLidarSample:
    """Scale length, width and height of each object by its own factors.

    The points in an object's 3D box are scaled with it, about the centre of its bottom face, so
    that it stays in place. The visible part of an object then no longer determines its length:
    after Yang et al. 2021 (ST3D), section 3.2, who scale all three sizes equally. 2D boxes stay. A
    point in two boxes moves with the first.

    Args:
        sample: Sample with a sweep and labels.
        factors: Factors of length, width and height. Those of objects without a 3D part are
            ignored.

    Raises:
        ValueError: The sample has no sweep or no labels, or a factor is not positive and finite.
    """
    points, objects = sample.points, sample.objects
    if points is None or objects is None:
        raise ValueError(
            f"sample {sample.sample_id} has no sweep or no labels to change; give it both or leave "
            "out this step"
        )
    if not bool(((factors > 0) & factors.isfinite()).all()):
        raise ValueError("factors must be positive and finite")
    boxes = objects.boxes3d.tensor.double()
    holder = first_box_of_points(points[None, :, :3], boxes[None])[0]
    is_held = holder >= 0
    held, factor = boxes[holder[is_held]], factors[holder[is_held]]
    offset = points[is_held, :3].double() - held[:, :3]
    offset[:, 2] += held[:, 5] / 2
    rotation = yaw_rotation(held[:, 6])
    moved = (factor[:, None] * (offset[:, None] @ rotation)) @ rotation.mT
    moved = moved[:, 0] + held[:, :3]
    moved[:, 2] -= held[:, 5] / 2
    stretched = boxes.clone()
    stretched[:, 3:6] *= factors
    stretched[:, 2] += (stretched[:, 5] - boxes[:, 5]) / 2
    points = points.clone()
    points[is_held, :3] = moved.float()
    boxes = torch.where(objects.has_box3d[:, None], stretched, boxes)
    boxes3d = Boxes3D(boxes.to(objects.boxes3d.tensor.dtype))
    return replace(sample, points=points, objects=replace(objects, boxes3d=boxes3d))

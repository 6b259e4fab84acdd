"""Sweeps changed as the ground and the sensor vary, with their 3D labels: to train detectors on.

Each function gives a new sample in which points and 3D boxes fit together as before. What the
camera sees stays as it is, and so does the calibration: images no longer fit a bent scene.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from sightline.data.augmentation import sweep_of
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import yaw_rotation
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.structures.sample import CameraLidarSample


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundShape:
    """How much higher the ground lies than it did, by the place: a tilted and arched sheet."""

    height_m: float = 0.0
    """Everywhere: another mount of the sensor."""
    slope_x: float = 0.0
    """By each metre ahead [m]."""
    slope_y: float = 0.0
    """By each metre to the left [m]."""
    curvature_per_m: float = 0.0
    """By the square of the metres ahead: the foot of a hill, or its top."""

    def __post_init__(self) -> None:
        """Checks that the numbers are numbers."""
        values = (self.height_m, self.slope_x, self.slope_y, self.curvature_per_m)
        if not all(map(math.isfinite, values)):
            raise ValueError(f"the ground's shape needs finite numbers, got {self}")


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundShapeConfig:
    """How far the ground's shape is changed: deviations of normal draws."""

    mean_height_m: float = 0.05
    """The only mean that is not 0."""
    height_m: float = 0.08
    """Of the height."""
    slope_x: float = 0.008
    """Of the slope ahead."""
    slope_y: float = 0.012
    """Of the slope to the left."""
    curvature_per_m: float = 8e-5
    """Of the curvature."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if not math.isfinite(self.mean_height_m):
            raise ValueError(f"mean_height_m must be finite, got {self.mean_height_m}")
        for name in ("height_m", "slope_x", "slope_y", "curvature_per_m"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be finite and not negative, got {value}")


def draw_ground_shape(config: GroundShapeConfig, rng: np.random.Generator) -> GroundShape:
    """A shape with all four numbers drawn."""
    height, slope_x, slope_y, curvature = map(float, rng.normal(size=4))
    return GroundShape(
        height_m=config.mean_height_m + config.height_m * height,
        slope_x=config.slope_x * slope_x,
        slope_y=config.slope_y * slope_y,
        curvature_per_m=config.curvature_per_m * curvature,
    )


def bend_ground(sample: CameraLidarSample, shape: GroundShape) -> CameraLidarSample:
    """The sample of a scene that stands on other ground.

    Points rise by what the shape says of their place, boxes by what it says of their centre's; they
    stay upright, as KITTI's do on slopes. Rows of zeros, for objects without a 3D part, stay.
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
    """The sample of a LiDAR that measures ranges less exactly: normal errors along the rays.

    Points stay on their rays, so ring numbers and azimuths stay; a point at the sensor stays there,
    and none is moved beyond it. Labels stay.

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
    """The sample of objects longer, wider and higher than they are, each by factors of its own.

    The points in an object's 3D box move with it, about the middle of its bottom, so that it stands
    where it stood. What shows of an object no longer tells how long it must be: after Yang et al.
    2021 (ST3D), section 3.2, who scale all three sizes alike. 2D boxes stay. A point in two boxes
    moves with the first.

    Args:
        sample: With a sweep and labels.
        factors: On length, width and height. Those of objects without a 3D part are not used.

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

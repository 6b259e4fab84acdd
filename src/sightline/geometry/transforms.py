"""Rigid transforms and angles.

A transform is named `target_from_source` and maps points of the source frame to the target frame,
so a chain reads as a proof: `image_from_camera @ camera_from_lidar`.
"""

import math

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from sightline.geometry.wrong_types import named_arguments


def rigid_transform(
    rotation: Float[Tensor, "*batch 3 3"], translation: Float[Tensor, "*batch 3"]
) -> Float[Tensor, "*batch 4 4"]:
    """Make the 4x4 matrix that rotates by `rotation`, then moves by `translation` [m]."""
    upper = torch.cat((rotation, translation[..., None]), dim=-1)
    bottom = upper.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*upper.shape[:-2], 1, 4)
    return torch.cat((upper, bottom), dim=-2)


def rigid_inverse(target_from_source: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """Compute `source_from_target` by the transposed rotation, which is exact."""
    source_from_target_rotation = target_from_source[..., :3, :3].transpose(-1, -2)
    translation = target_from_source[..., :3, 3:]
    return rigid_transform(
        source_from_target_rotation, -(source_from_target_rotation @ translation)[..., 0]
    )


def transform_points(
    target_from_source: Float[Tensor, "*#batch rows 4"],
    points: Float[Tensor, "*#batch num_points 3"],
) -> Float[Tensor, "*#batch num_points 3"]:
    """Apply a 4x4 rigid transform, or the 3x4 upper part of one, to points [m].

    It computes in the wider of the two dtypes and returns the points' dtype, so that a float64
    calibration keeps its precision and float32 sweeps stay float32. Whole numbers become floats.
    """
    dtype = torch.promote_types(target_from_source.dtype, points.dtype)
    matrix = target_from_source[..., :3, :].to(dtype)
    moved = points.to(dtype) @ matrix[..., :3].transpose(-1, -2) + matrix[..., None, :, 3]
    return moved.to(points.dtype) if points.is_floating_point() else moved


def yaw_rotation(yaw: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape 3 3"]:
    """Make the rotation about +z (up) by `yaw` radians, counter-clockwise seen from above."""
    cos, sin = yaw.cos(), yaw.sin()
    zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
    rows = (cos, -sin, zero, sin, cos, zero, zero, zero, one)
    return torch.stack(rows, dim=-1).reshape(*yaw.shape, 3, 3)


@named_arguments
def rotation_about_axes(
    yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0
) -> Float64[Tensor, "3 3"]:
    """Make the matrix of a rotation about x (roll), then y (pitch), then z (yaw).

    Each is counter-clockwise seen from the axis's tip.
    """
    rotation = torch.eye(3, dtype=torch.float64)
    for axis, degrees in enumerate((roll_deg, pitch_deg, yaw_deg)):
        cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        turn = torch.eye(3, dtype=torch.float64)
        second, third = (axis + 1) % 3, (axis + 2) % 3
        turn[second, second] = turn[third, third] = cos
        turn[third, second], turn[second, third] = sin, -sin
        rotation = turn @ rotation
    return rotation


def wrap_angle(angle: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Wrap an angle [rad] to [-pi, pi)."""
    wrapped = torch.remainder(angle + math.pi, 2 * math.pi) - math.pi
    # The sum rounds: without this, an angle just below -pi would become +pi, outside the range.
    return torch.where(wrapped >= math.pi, -torch.full_like(wrapped, math.pi), wrapped)

"""Assignment of points to the boxes that contain them."""

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from sightline.ops.operator import operator
from sightline.ops.point_checks import (
    checked_batch_boxes,
    checked_columns,
    require_boxes,
    require_points,
)
from sightline.ops.points_in_boxes_kernel import find_first_boxes


def first_box_of_points(
    points: Float[Tensor, "batch num_points 3"], boxes: Float[Tensor, "batch num_boxes 7"]
) -> Int64[Tensor, "batch num_points"]:
    """Find for each point [m] the first box (x, y, z, length, width, height, yaw) around it, or -1.

    Faces are included. A box with a size of 0 contains nothing, so sweeps with fewer boxes may be
    padded with rows of zeros. Computed in float64, without gradient: on a CPU by a compiled kernel,
    on other devices by plain PyTorch with some bytes per pair of point and box.

    Raises:
        ValueError: A value is not finite, a size is negative, or batch sizes differ.
    """
    require_points(points, "points")
    require_boxes(boxes, points)
    first: Tensor = _first_box_of_points(points, boxes)
    return first


@operator("first_box_of_points")
def _first_box_of_points(points: Tensor, boxes: Tensor) -> Tensor:
    columns, rows = checked_columns(points, "points"), checked_batch_boxes(boxes, "boxes")
    first = points.new_full(points.shape[:2], -1, dtype=torch.int64)
    for sweep in range(points.shape[0]):
        if columns.is_cpu:
            found = find_first_boxes(columns[sweep].numpy(), rows[sweep].numpy())
            first[sweep] = torch.from_numpy(found)
        elif rows.shape[1] > 0:
            first[sweep] = first_by_torch(columns[sweep], rows[sweep])
    return first


@_first_box_of_points.register_fake
def _(points: Tensor, boxes: Tensor) -> Tensor:
    del boxes
    return points.new_empty(points.shape[:2], dtype=torch.int64)


def first_by_torch(
    columns: Float64[Tensor, "3 num_points"], boxes: Float64[Tensor, "num_boxes 7"]
) -> Int64[Tensor, " num_points"]:
    """Find the first boxes without a kernel; at least one box is needed."""
    is_inside = inside_by_torch(columns, boxes, 0.0)
    number = torch.arange(boxes.shape[0], device=boxes.device)[:, None]
    first = torch.where(is_inside, number, boxes.shape[0]).amin(dim=0)
    return torch.where(first < boxes.shape[0], first, -1)


def inside_by_torch(
    columns: Float64[Tensor, "3 num_points"], boxes: Float64[Tensor, "num_boxes 7"], margin_m: float
) -> Bool[Tensor, "num_boxes num_points"]:
    """Mask of points in boxes, each enlarged by a margin; a box with a size of 0 is empty."""
    dx, dy, dz = (columns[axis] - boxes[:, axis, None] for axis in range(3))
    cos, sin = boxes[:, 6, None].cos(), boxes[:, 6, None].sin()
    half = boxes[:, 3:6] / 2 + margin_m
    is_inside = (
        ((cos * dx + sin * dy).abs() <= half[:, 0, None])
        & ((cos * dy - sin * dx).abs() <= half[:, 1, None])
        & (dz.abs() <= half[:, 2, None])
    )
    return is_inside & (boxes[:, 3:6] > 0).all(dim=1, keepdim=True)

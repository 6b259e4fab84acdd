"""Sampling of a fixed number of points from each region of interest."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from sightline.ops.operator import operator
from sightline.ops.point_checks import (
    checked_batch_boxes,
    checked_columns,
    require_boxes,
    require_points,
)
from sightline.ops.points_in_boxes import inside_by_torch
from sightline.ops.roi_points_kernel import WORD, choose_points, scramble

_LARGEST_SEED = 2**31 - 1


class RoiPoints(NamedTuple):
    """Points sampled from boxes."""

    indices: Int64[Tensor, "batch num_boxes count"]
    """Indices of the points; 0 if the box is empty."""
    num_inside: Int64[Tensor, "batch num_boxes"]
    """Number of points in each box, which may exceed the number drawn."""


def roi_points(
    points: Float[Tensor, "batch num_points 3"],
    boxes: Float[Tensor, "batch num_boxes 7"],
    *,
    margin_m: float,
    count: int,
    seed: int,
) -> RoiPoints:
    """Draw exactly `count` points [m] from each box enlarged by `margin_m`.

    Shi et al. 2019 (PointRCNN), section 3.3. From more points, a random `count` is drawn, in their
    order; of fewer, all are taken and random repetitions fill up. The same seed gives the same
    result on every device; a point's random number depends only on its index and the number of the
    box. Faces are included; a box with a size of 0 is empty, so sweeps with fewer boxes may be
    padded with rows of zeros.

    Computed in float64, without gradient: on a CPU by a compiled kernel, on other devices by plain
    PyTorch with some bytes per pair of point and box.

    Raises:
        ValueError: A value is not finite, a size is negative, batch sizes differ, or a setting is
            out of range.
    """
    require_points(points, "points")
    require_boxes(boxes, points)
    if not 0 <= margin_m < float("inf"):
        raise ValueError(f"margin_m must be finite and not negative, got {margin_m}")
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    if not 0 <= seed <= _LARGEST_SEED:
        raise ValueError(f"seed must be from 0 to {_LARGEST_SEED}, got {seed}")
    index, num_inside = _roi_points(points, boxes, margin_m, count, seed)
    return RoiPoints(index, num_inside)


@operator("roi_points")
def _roi_points(
    points: Tensor, boxes: Tensor, margin_m: float, count: int, seed: int
) -> tuple[Tensor, Tensor]:
    columns, rows = checked_columns(points, "points"), checked_batch_boxes(boxes, "boxes")
    index = points.new_zeros((*boxes.shape[:2], count), dtype=torch.int64)
    num_inside = points.new_zeros(boxes.shape[:2], dtype=torch.int64)
    for sweep in range(points.shape[0]):
        if columns.is_cpu:
            choose_points(
                columns[sweep].numpy(),
                rows[sweep].numpy(),
                margin_m,
                seed,
                index[sweep].numpy(),
                num_inside[sweep].numpy(),
            )
        elif points.shape[1] > 0:
            index[sweep], num_inside[sweep] = choose_by_torch(
                columns[sweep], rows[sweep], margin_m, count, seed
            )
    return index, num_inside


@_roi_points.register_fake
def _(
    points: Tensor, boxes: Tensor, margin_m: float, count: int, seed: int
) -> tuple[Tensor, Tensor]:
    del margin_m, seed
    shape = boxes.shape[:2]
    index = points.new_empty((*shape, count), dtype=torch.int64)
    return index, points.new_empty(shape, dtype=torch.int64)


def choose_by_torch(
    columns: Float64[Tensor, "3 num_points"],
    boxes: Float64[Tensor, "num_boxes 7"],
    margin_m: float,
    count: int,
    seed: int,
) -> tuple[Int64[Tensor, "num_boxes count"], Int64[Tensor, " num_boxes"]]:
    """Draw points as `roi_points` does, without a kernel; at least one point is needed."""
    is_inside = inside_by_torch(columns, boxes, margin_m)
    num_inside = is_inside.sum(dim=1)
    num_points = columns.shape[1]
    number = torch.arange(num_points, device=boxes.device)
    place = torch.arange(count, device=boxes.device)
    box = torch.arange(boxes.shape[0], device=boxes.device)[:, None]
    salt = _scramble(box + scramble(seed))
    # sort by order if all points stay, else at random; points outside come last
    luck = torch.where(num_inside[:, None] > count, _scramble(salt ^ _scramble(number)), 0)
    keys = torch.where(is_inside, (luck << 31) | number, torch.iinfo(torch.int64).max)
    drawn = keys.topk(min(count, num_points), largest=False, sorted=True).indices
    # with few points inside, points outside go to the end
    outside = num_inside[:, None] <= place[: drawn.shape[1]]
    kept = torch.where(outside, num_points, drawn).sort(dim=1).values
    repeated = (_scramble(salt + place) * num_inside[:, None]) >> 32
    source = torch.where(place < num_inside[:, None], place, repeated)
    index = kept.gather(1, source.clamp(max=kept.shape[1] - 1))
    return torch.where(num_inside[:, None] > 0, index, 0), num_inside


def _scramble(numbers: Int64[Tensor, "*shape"]) -> Int64[Tensor, "*shape"]:
    """Apply `scramble` to every number."""
    numbers = numbers & WORD
    numbers = ((numbers ^ (numbers >> 16)) * 0x7FEB352D) & WORD
    numbers = ((numbers ^ (numbers >> 15)) * 0x846CA68B) & WORD
    return numbers ^ (numbers >> 16)

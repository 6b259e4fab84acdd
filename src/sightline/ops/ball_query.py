"""Ball query: the points within a radius of given centres."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, library

from sightline.ops.ball_query_kernel import query_ball
from sightline.ops.point_checks import checked_points, require_points, require_same_batch

_CHUNK = 2**24  # distances held at once by plain PyTorch


class BallQuery(NamedTuple):
    """Points around centres."""

    indices: Int64[Tensor, "batch num_centers count"]
    """Indices of the points, ascending, padded with the first one; 0 if there are none."""
    num_found: Int64[Tensor, "batch num_centers"]
    """Number of points found, up to `count`, without the padding."""


def ball_query(
    points: Float[Tensor, "batch num_points 3"],
    centers: Float[Tensor, "batch num_centers 3"],
    *,
    radius_m: float,
    count: int,
) -> BallQuery:
    """Find the first `count` points nearer to each centre than `radius_m` [m].

    Qi et al. 2017 (PointNet++), section 3.2. From more points, the first ones in the cloud are
    taken, so clouds in a systematic order should be shuffled. Distances are computed in float32,
    the same way on every device. There is no gradient.

    On a CPU a compiled kernel searches a grid; on other devices plain PyTorch computes all
    distances, in parts.

    Raises:
        ValueError: A coordinate is not finite, batch sizes differ, or a setting is out of range.
    """
    require_points(points, "points")
    require_points(centers, "centers")
    require_same_batch(("points", points), ("centers", centers))
    if not 0 < radius_m < float("inf"):
        raise ValueError(f"radius_m must be positive and finite, got {radius_m}")
    if count < 1:
        raise ValueError(f"count must be at least 1, got {count}")
    index, num_found = _ball_query(points, centers, radius_m, count)
    return BallQuery(index, num_found)


@library.custom_op("sightline::ball_query", mutates_args=())
def _ball_query(
    points: Tensor, centers: Tensor, radius_m: float, count: int
) -> tuple[Tensor, Tensor]:
    clouds, around = checked_points(points, "points"), checked_points(centers, "centers")
    squared_radius = torch.tensor(radius_m, dtype=torch.float32).square()
    batch, num_centers = around.shape[:2]
    index = around.new_zeros((batch, num_centers, count), dtype=torch.int64)
    num_found = around.new_zeros((batch, num_centers), dtype=torch.int64)
    if clouds.shape[1] == 0:
        return index, num_found
    for sweep in range(batch):
        if clouds.is_cpu:
            query_ball(
                clouds[sweep].numpy(),
                around[sweep].numpy(),
                np.float32(squared_radius.item()),
                index[sweep].numpy(),
                num_found[sweep].numpy(),
            )
        else:
            query_by_torch(
                clouds[sweep], around[sweep], squared_radius, index[sweep], num_found[sweep]
            )
    return index, num_found


@_ball_query.register_fake
def _(points: Tensor, centers: Tensor, radius_m: float, count: int) -> tuple[Tensor, Tensor]:
    del points, radius_m
    shape = centers.shape[:2]
    index = centers.new_empty((*shape, count), dtype=torch.int64)
    return index, centers.new_empty(shape, dtype=torch.int64)


def query_by_torch(
    points: Float32[Tensor, "num_points 3"],
    centers: Float32[Tensor, "num_centers 3"],
    squared_radius: Float32[Tensor, ""],
    index: Int64[Tensor, "num_centers count"],
    num_found: Int64[Tensor, " num_centers"],
) -> None:
    """Find the points of `ball_query` without a kernel."""
    num_points, count = points.shape[0], index.shape[1]
    numbers = torch.arange(num_points, device=points.device)
    rows = max(_CHUNK // num_points, 1)
    for begin in range(0, centers.shape[0], rows):
        part = slice(begin, begin + rows)
        dx, dy, dz = (points[None] - centers[part, None]).unbind(2)
        is_near = dx * dx + dy * dy + dz * dz < squared_radius.to(points.device)
        # the index if near, else one past the last
        candidates = torch.where(is_near, numbers, num_points)
        first = candidates.topk(min(count, num_points), largest=False, sorted=True).values
        found = (first < num_points).sum(dim=1)
        first = torch.where(first < num_points, first, first[:, :1])
        missing = first[:, :1].expand(-1, count - first.shape[1])
        index[part] = torch.where(found[:, None] > 0, torch.cat((first, missing), dim=1), 0)
        num_found[part] = found

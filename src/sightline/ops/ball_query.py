"""Ball query: the points within a radius of given centres."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.ops.ball_query_kernel import query_ball
from sightline.ops.each_sweep import for_each_sweep
from sightline.ops.operator import operator
from sightline.ops.point_checks import checked_points, require_points, require_same_batch


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
    taken, so clouds in a systematic order should be shuffled. Distances are computed in float32.
    There is no gradient. A compiled kernel on the CPU searches a grid; points on another device are
    copied.

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


@operator("ball_query")
def _ball_query(
    points: Tensor, centers: Tensor, radius_m: float, count: int
) -> tuple[Tensor, Tensor]:
    clouds = checked_points(points, "points").cpu().numpy()
    around = checked_points(centers, "centers").cpu().numpy()
    index = torch.zeros((*centers.shape[:2], count), dtype=torch.int64)
    num_found = torch.zeros(centers.shape[:2], dtype=torch.int64)
    if points.shape[1] > 0:
        squared_radius = np.float32(radius_m) * np.float32(radius_m)
        indices, counts = index.numpy(), num_found.numpy()

        def query(sweep: int) -> None:
            query_ball(clouds[sweep], around[sweep], squared_radius, indices[sweep], counts[sweep])

        for_each_sweep(query, len(clouds))
    return index.to(points.device), num_found.to(points.device)


@_ball_query.register_fake
def _(points: Tensor, centers: Tensor, radius_m: float, count: int) -> tuple[Tensor, Tensor]:
    del points, radius_m
    shape = centers.shape[:2]
    index = centers.new_empty((*shape, count), dtype=torch.int64)
    return index, centers.new_empty(shape, dtype=torch.int64)

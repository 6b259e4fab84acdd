"""Search of the three nearest points of each query."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from sightline.ops.each_sweep import for_each_sweep
from sightline.ops.operator import operator
from sightline.ops.point_checks import checked_points, require_points, require_same_batch
from sightline.ops.three_nearest_kernel import find_three_nearest


class ThreeNearest(NamedTuple):
    """Nearest points of queries, by ascending distance."""

    indices: Int64[Tensor, "batch num_queries 3"]
    """Indices of the points; 0 for missing ones in clouds with fewer than three."""
    squared_distance_m2: Float32[Tensor, "batch num_queries 3"]
    """Squared distances; infinite for missing points."""


def three_nearest(
    points: Float[Tensor, "batch num_points 3"], queries: Float[Tensor, "batch num_queries 3"]
) -> ThreeNearest:
    """Find the three nearest points [m] of each query; at equal distance the first in the cloud.

    Distances are computed in float32. There is no gradient. A compiled kernel on the CPU searches a
    grid; points on another device are copied.

    Raises:
        ValueError: A coordinate is not finite, batch sizes differ, or there are queries but no
            point.
    """
    require_points(points, "points")
    require_points(queries, "queries")
    require_same_batch(("points", points), ("queries", queries))
    if points.shape[1] == 0 and queries.shape[1] > 0:
        raise ValueError("points is empty, expected at least one point; skip empty sweeps")
    index, squared_distance = _three_nearest(points, queries)
    return ThreeNearest(index, squared_distance)


@operator("three_nearest")
def _three_nearest(points: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    clouds = checked_points(points, "points").cpu().numpy()
    places = checked_points(queries, "queries").cpu().numpy()
    index = torch.zeros(queries.shape, dtype=torch.int64)
    squared_distance = torch.full(queries.shape, torch.inf, dtype=torch.float32)
    if places.size > 0:
        indices, squares = index.numpy(), squared_distance.numpy()

        def find(sweep: int) -> None:
            find_three_nearest(clouds[sweep], places[sweep], indices[sweep], squares[sweep])

        for_each_sweep(find, len(clouds))
    return index.to(queries.device), squared_distance.to(queries.device)


@_three_nearest.register_fake
def _(points: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    del points
    index = torch.empty_like(queries, dtype=torch.int64)
    return index, torch.empty_like(queries, dtype=torch.float32)

"""Search of the three nearest points of each query."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, library

from sightline.ops.point_checks import checked_points, require_points, require_same_batch
from sightline.ops.three_nearest_kernel import find_three_nearest

_CHUNK = 2**24  # distances held at once by plain PyTorch


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

    Distances are computed in float32, the same way on every device. There is no gradient. On a CPU
    a compiled kernel searches a grid; on other devices plain PyTorch computes all distances, in
    parts.

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


@library.custom_op("sightline::three_nearest", mutates_args=())
def _three_nearest(points: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    clouds, places = checked_points(points, "points"), checked_points(queries, "queries")
    index = torch.zeros_like(places, dtype=torch.int64)
    squared_distance = torch.full_like(places, torch.inf)
    if places.numel() == 0:
        return index, squared_distance
    for sweep in range(clouds.shape[0]):
        if clouds.is_cpu:
            find_three_nearest(
                clouds[sweep].numpy(),
                places[sweep].numpy(),
                index[sweep].numpy(),
                squared_distance[sweep].numpy(),
            )
        else:
            find_by_torch(clouds[sweep], places[sweep], index[sweep], squared_distance[sweep])
    return index, squared_distance


@_three_nearest.register_fake
def _(points: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
    del points
    index = torch.empty_like(queries, dtype=torch.int64)
    return index, torch.empty_like(queries, dtype=torch.float32)


def find_by_torch(
    points: Float32[Tensor, "num_points 3"],
    queries: Float32[Tensor, "num_queries 3"],
    index: Int64[Tensor, "num_queries 3"],
    squared_distance: Float32[Tensor, "num_queries 3"],
) -> None:
    """Find the nearest points without a kernel."""
    rows = max(_CHUNK // points.shape[0], 1)
    for begin in range(0, queries.shape[0], rows):
        part = slice(begin, begin + rows)
        dx, dy, dz = (points[None] - queries[part, None]).unbind(2)
        distance = dx * dx + dy * dy + dz * dz
        for place in range(min(3, points.shape[0])):
            nearest = distance.amin(dim=1, keepdim=True)
            # argmin does not define which of several it returns
            first = (distance == nearest).int().cumsum(dim=1).eq(0).sum(dim=1, keepdim=True)
            index[part, place], squared_distance[part, place] = first[:, 0], nearest[:, 0]
            distance.scatter_(1, first, torch.inf)

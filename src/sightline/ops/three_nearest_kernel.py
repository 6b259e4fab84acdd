"""Compiled kernel for the three nearest points, without torch."""

from typing import Final

import numpy as np
from jaxtyping import Float32, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled
from sightline.ops.point_grid_kernel import make_grid

_SLACK: Final = 0.99999  # squared distances are rounded: one ring more is searched


@compiled
def find_three_nearest(
    points: Float32[ndarray, "num_points 3"],
    queries: Float32[ndarray, "num_queries 3"],
    index: Int64[ndarray, "num_queries 3"],
    squared_distance: Float32[ndarray, "num_queries 3"],
) -> None:
    """Fill the zeroed `index`, and `squared_distance`, initially infinite.

    The grid is searched in square rings around each query, until no further ring can contain a
    nearer point.
    """
    low_x, low_y, edge, num_x, num_y, starts, order = make_grid(points, 0.0)
    x, y, z = points[order, 0], points[order, 1], points[order, 2]
    for m in range(queries.shape[0]):
        qx, qy, qz = queries[m, 0], queries[m, 1], queries[m, 2]
        # for a query outside the grid, the nearest border cell gives a bound
        ix = int(min(max((qx - low_x) / edge, 0.0), num_x - 1.0))
        iy = int(min(max((qy - low_y) / edge, 0.0), num_y - 1.0))
        best, nearest = index[m], squared_distance[m]
        for ring in range(max(num_x, num_y)):
            safe_distance = (ring - 1) * edge * _SLACK
            if ring > 0 and nearest[2] < safe_distance * safe_distance:
                break
            for row in range(max(iy - ring, 0), min(iy + ring, num_y - 1) + 1):
                is_whole = row == iy - ring or row == iy + ring
                step = 1 if is_whole else max(2 * ring, 1)
                for column in range(ix - ring, ix + ring + 1, step):
                    if 0 <= column < num_x:
                        cell = row * num_x + column
                        for i in range(starts[cell], starts[cell + 1]):
                            dx, dy, dz = x[i] - qx, y[i] - qy, z[i] - qz
                            distance = dx * dx + dy * dy + dz * dz
                            if distance <= nearest[2]:
                                _insert(distance, order[i], best, nearest)


@compiled
def _insert(
    distance: np.float32,
    point: int,
    index: Int64[ndarray, "3"],
    squared_distance: Float32[ndarray, "3"],
) -> None:
    """Insert a point into the three, by distance, then by index."""
    for place in range(3):
        held = squared_distance[place]
        if distance < held or (distance == held and point < index[place]):
            for later in range(2, place, -1):
                squared_distance[later] = squared_distance[later - 1]
                index[later] = index[later - 1]
            squared_distance[place], index[place] = distance, point
            return

"""Compiled kernel for the points within a radius of centres, without torch."""

import math
from typing import Final

import numpy as np
from jaxtyping import Float32, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled
from sightline.ops.point_grid_kernel import make_grid

_SLACK: Final = 1.00001  # squared distances are rounded: the search goes a little beyond the radius


@compiled
def query_ball(
    points: Float32[ndarray, "num_points 3"],
    centers: Float32[ndarray, "num_centers 3"],
    squared_radius: np.float32,
    index: Int64[ndarray, "num_centers count"],
    num_found: Int64[ndarray, " num_centers"],
) -> None:
    """Fill the zeroed `index` and `num_found` from a cloud with at least one point."""
    count = index.shape[1]
    radius = math.sqrt(squared_radius) * _SLACK
    low_x, low_y, edge, num_x, num_y, starts, order = make_grid(points, radius)
    x, y, z = points[order, 0], points[order, 1], points[order, 2]
    hits = np.empty(points.shape[0], dtype=np.int64)
    for m in range(centers.shape[0]):
        cx, cy, cz = centers[m, 0], centers[m, 1], centers[m, 2]
        ix = math.floor(min(max((cx - low_x) / edge, -2.0), num_x + 1.0))
        iy = math.floor(min(max((cy - low_y) / edge, -2.0), num_y + 1.0))
        first_x, last_x = max(ix - 1, 0), min(ix + 1, num_x - 1)
        if first_x > last_x:
            continue
        found = 0
        for row in range(max(iy - 1, 0), min(iy + 1, num_y - 1) + 1):
            for i in range(starts[row * num_x + first_x], starts[row * num_x + last_x + 1]):
                dx, dy, dz = x[i] - cx, y[i] - cy, z[i] - cz
                hits[found] = order[i]
                found += dx * dx + dy * dy + dz * dz < squared_radius
        num_found[m] = min(found, count)
        if found > 0 and count > 0:
            _keep_first(hits[:found], index[m])


@compiled
def _keep_first(hits: Int64[ndarray, " n"], kept: Int64[ndarray, " count"]) -> None:
    """Write the smallest numbers in ascending order, padded with the smallest one."""
    if hits.size > 4 * kept.size:
        hits = np.partition(hits, kept.size - 1)[: kept.size]
    hits.sort()
    for k in range(kept.size):
        kept[k] = hits[k] if k < hits.size else hits[0]

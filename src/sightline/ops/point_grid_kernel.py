"""Compiled sorting of points into the columns of a bird's-eye-view grid, without torch.

Street scenes are flat, so columns divide their points nearly as well as cubes, and fit into memory
for any points.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled


class Grid(NamedTuple):
    """Points sorted into square columns."""

    low_x: float
    """Smallest x of the points [m]."""
    low_y: float
    """Smallest y of the points [m]."""
    edge: float
    """Edge of a column [m]."""
    num_x: int
    """Number of columns along x."""
    num_y: int
    """Number of columns along y."""
    starts: Int64[ndarray, " num_starts"]
    """Start of each column in `order`, and one more; column ix, iy is number iy * num_x + ix."""
    order: Int64[ndarray, " num_points"]
    """Indices of the points column by column, ascending within each."""


@compiled
def make_grid(points: Float[ndarray, "num_points 3"], min_edge_m: float) -> Grid:
    """Sort one or more points into a grid.

    Columns are at least `min_edge_m` wide, and not many more than points.
    """
    num_points = points.shape[0]
    low_x, low_y = float(points[:, 0].min()), float(points[:, 1].min())
    wide, deep = float(points[:, 0].max()) - low_x, float(points[:, 1].max()) - low_y
    edge = max(min_edge_m, math.sqrt(wide * deep / num_points), max(wide, deep) / num_points)
    if edge == 0.0:  # all points coincide
        edge = 1.0
    num_x, num_y = int(wide / edge) + 1, int(deep / edge) + 1
    starts = np.zeros(num_x * num_y + 1, dtype=np.int64)
    column = np.empty(num_points, dtype=np.int64)
    for i in range(num_points):
        ix, iy = int((points[i, 0] - low_x) / edge), int((points[i, 1] - low_y) / edge)
        column[i] = min(iy, num_y - 1) * num_x + min(ix, num_x - 1)
        starts[column[i] + 1] += 1
    for k in range(num_x * num_y):
        starts[k + 1] += starts[k]
    order, filled = np.empty(num_points, dtype=np.int64), starts.copy()
    for i in range(num_points):
        order[filled[column[i]]] = i
        filled[column[i]] += 1
    return Grid(low_x, low_y, edge, num_x, num_y, starts, order)

"""Compiled kernels for the points in boxes, without torch."""

import math
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64, UInt8
from numpy import ndarray

from sightline.ops.compiled import compiled
from sightline.ops.point_grid_kernel import Grid, make_grid

_EDGE_M: Final = 2.0  # edge of a column: a car and its surroundings cover about ten
_WORD: Final = 8  # bytes


class SortedCloud(NamedTuple):
    """Cloud in the columns of a grid, and working memory for one box at a time."""

    grid: Grid
    columns: Float64[ndarray, "3 num_points"]
    """x, y and z in the grid's order."""
    mask: UInt8[ndarray, " num_bytes"]
    """Mask of the points in the box, in the cloud's order; zeros between boxes."""
    found: Int64[ndarray, " num_points_and_one"]
    """Indices of the points in the box."""


@compiled
def sort_cloud(columns: Float64[ndarray, "3 num_points"]) -> SortedCloud:
    """Sort a cloud with at least one point."""
    num_points = columns.shape[1]
    grid = make_grid(columns.T, _EDGE_M)
    return SortedCloud(
        grid,
        columns[:, grid.order],
        np.zeros((num_points + _WORD - 1) // _WORD * _WORD, dtype=np.uint8),
        np.empty(num_points + 1, dtype=np.int64),
    )


@compiled
def find_points_in_box(cloud: SortedCloud, box: Float64[ndarray, "7"], margin: float) -> int:
    """Write the indices of the points in a box to `cloud.found`, ascending; return their number.

    Faces are included. A box with a size of 0 is empty, whatever the margin.
    """
    if not (box[3] > 0.0 and box[4] > 0.0 and box[5] > 0.0):
        return 0
    grid, mask, found = cloud.grid, cloud.mask, cloud.found
    x, y, z = cloud.columns[0], cloud.columns[1], cloud.columns[2]
    half_l, half_w, half_h = 0.5 * box[3] + margin, 0.5 * box[4] + margin, 0.5 * box[5] + margin
    cx, cy, cz = box[0], box[1], box[2]
    cos, sin = math.cos(box[6]), math.sin(box[6])
    reach = math.sqrt(half_l * half_l + half_w * half_w) * (1.0 + 1e-9)
    first_x = _column_number(cx - reach, grid.low_x, grid.edge, grid.num_x)
    last_x = _column_number(cx + reach, grid.low_x, grid.edge, grid.num_x)
    first_y = _column_number(cy - reach, grid.low_y, grid.edge, grid.num_y)
    last_y = _column_number(cy + reach, grid.low_y, grid.edge, grid.num_y)
    for row in range(first_y, last_y + 1):
        start = grid.starts[row * grid.num_x + first_x]
        end = grid.starts[row * grid.num_x + last_x + 1]
        for i in range(start, end):
            dx, dy, dz = x[i] - cx, y[i] - cy, z[i] - cz
            mask[grid.order[i]] = (
                (abs(cos * dx + sin * dy) <= half_l)
                & (abs(cos * dy - sin * dx) <= half_w)
                & (abs(dz) <= half_h)
            )
    # read eight at a time: most points are outside
    words = mask.view(np.uint64)
    count = 0
    for word in range(words.size):
        if words[word] != 0:
            for i in range(word * _WORD, (word + 1) * _WORD):
                found[count] = i
                count += mask[i]
            words[word] = 0
    return count


@compiled
def _column_number(position: float, low: float, edge: float, number: int) -> int:
    """Compute the number of the column at a place, or of the nearest outermost column."""
    return int(min(max((position - low) / edge, 0.0), number - 1.0))


@compiled
def find_first_boxes(
    columns: Float64[ndarray, "3 num_points"], boxes: Float64[ndarray, "num_boxes 7"]
) -> Int64[ndarray, " num_points"]:
    """Find the first box that contains each point; -1 if there is none."""
    first = np.full(columns.shape[1], -1, dtype=np.int64)
    if columns.shape[1] == 0:
        return first
    cloud = sort_cloud(columns)
    for k in range(boxes.shape[0] - 1, -1, -1):
        for i in range(find_points_in_box(cloud, boxes[k], 0.0)):
            first[cloud.found[i]] = k
    return first

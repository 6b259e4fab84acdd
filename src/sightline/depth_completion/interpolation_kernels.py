"""The compiled part of linear interpolation, without torch."""

import math

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled


@compiled
def draw_triangles(
    pixels: Int64[ndarray, "n 2"],
    values: Float64[ndarray, " n"],
    triangles: Int64[ndarray, "m 3"],
    shape: tuple[int, int],
) -> Float64[ndarray, "height width"]:
    """Draw triangles into an image, linear between their corners; 0 outside all of them.

    A pixel belongs to a triangle if it lies inside or on its border; the last triangle wins.

    Args:
        pixels: Rows and columns of the corners.
        values: Value at each corner.
        triangles: Indices of three corners each; triangles without area are left out.
        shape: Height and width of the image; all corners must lie inside.
    """
    image = np.zeros(shape)
    for i in range(len(triangles)):
        a, b, c = triangles[i]
        row, column = pixels[a]
        row_b, column_b = pixels[b, 0] - row, pixels[b, 1] - column
        row_c, column_c = pixels[c, 0] - row, pixels[c, 1] - column
        area = row_b * column_c - column_b * row_c
        if area == 0:
            continue
        rise_b, rise_c = values[b] - values[a], values[c] - values[a]
        per_row = (rise_b * column_c - rise_c * column_b) / area
        per_column = (rise_c * row_b - rise_b * row_c) / area
        for y in range(min(0, row_b, row_c), max(0, row_b, row_c) + 1):
            first, last = _row_span(row_b, column_b, row_c, column_c, y)
            for x in range(first, last + 1):
                image[row + y, column + x] = values[a] + per_row * y + per_column * x
    return image


@compiled
def _row_span(row_b: int, column_b: int, row_c: int, column_c: int, y: int) -> tuple[int, int]:
    """First and last column of row y in the triangle of (0, 0), b and c."""
    low, high = np.inf, -np.inf
    rows, columns = (0, row_b, row_c, 0), (0, column_b, column_c, 0)
    for side in range(3):
        start, end = rows[side], rows[side + 1]
        if start == end or not min(start, end) <= y <= max(start, end):
            continue  # a horizontal side ends where the other two end
        # Whole results are exact: quotients of whole numbers are rounded correctly.
        across = (y - start) * (columns[side + 1] - columns[side]) / (end - start)
        low, high = min(low, columns[side] + across), max(high, columns[side] + across)
    return math.ceil(low), math.floor(high)

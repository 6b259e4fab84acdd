"""Removal of LiDAR noise from the planes of a depth map; edges and bends stay unchanged."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray

from sightline.depth_completion.adaptive_kernels import inverse
from sightline.ops.compiled import compiled

_MIN_SPREAD = 1e-9  # for windows of one row or column, which have no slope


def smooth_planes(
    depth_m: Float32[ndarray, "height width"], *, windows_px: Sequence[int], noise_m: float
) -> Float32[ndarray, "height width"]:
    """Smooth the planes of a depth map with one window size after the other.

    A plane is fitted to the window around each pixel in inverse depth, where planes are linear.
    The pixel moves towards it as Lee 1980 ("Digital Image Enhancement and Noise Filtering by Use
    of Local Statistics") moves pixels towards means: all the way if the window's residuals are
    within the noise, less with larger residuals.

    Args:
        depth_m: Metres, 0 = none. Pixels without depth stay so and count as infinitely far: pixels
            next to them stay unchanged, as at any edge that is large compared with the noise.
        windows_px: Reach of each window to every side of its pixel; clipped at the image's edge.
        noise_m: Standard deviation of the measurements [m].
    """
    inverse_depth = inverse(depth_m)
    for reach in windows_px:
        inverse_depth = _move_to_planes(inverse_depth, reach, noise_m)
    return inverse(inverse_depth)


@compiled
def _move_to_planes(
    inverse_depth: Float32[ndarray, "height width"], reach: int, noise_m: float
) -> Float32[ndarray, "height width"]:
    """Run the smoothing for one window size."""
    height, width = inverse_depth.shape
    smooth = np.empty_like(inverse_depth)
    # float64: the residuals are small compared with the sums.
    sums = np.zeros((3, width))  # over the window's rows, by column: value, square, row times value
    prefix = np.zeros((4, width + 1))  # prefix sums along the row, also of column times value
    for row in range(-reach, height):
        _add_row(inverse_depth, row + reach, 1.0, sums)
        _add_row(inverse_depth, row - reach - 1, -1.0, sums)
        if row < 0:
            continue
        for column in range(width):
            for each in range(3):
                prefix[each, column + 1] = prefix[each, column] + sums[each, column]
            prefix[3, column + 1] = prefix[3, column] + column * sums[0, column]
        top, bottom = max(row - reach, 0), min(row + reach, height - 1)
        rows, middle_row = bottom - top + 1, 0.5 * (top + bottom)
        row_spread = max((rows**2 - 1) / 12, _MIN_SPREAD)  # mean square from the middle
        for column in range(width):
            left, right = max(column - reach, 0), min(column + reach, width - 1)
            columns, middle_column = right - left + 1, 0.5 * (left + right)
            column_spread = max((columns**2 - 1) / 12, _MIN_SPREAD)
            share = 1.0 / (rows * columns)
            mean = (prefix[0, right + 1] - prefix[0, left]) * share
            mean_square = (prefix[1, right + 1] - prefix[1, left]) * share
            down = (prefix[2, right + 1] - prefix[2, left]) * share - middle_row * mean
            across = (prefix[3, right + 1] - prefix[3, left]) * share - middle_column * mean
            down, across = down / row_spread, across / column_spread  # slopes of the plane
            planar = mean**2 + down**2 * row_spread + across**2 * column_spread
            variance = mean_square - planar  # residual variance of the plane
            plane = mean + down * (row - middle_row) + across * (column - middle_column)
            value = np.float64(inverse_depth[row, column])
            if value == 0:
                smooth[row, column] = 0
                continue
            noise = (noise_m * value * value) ** 2  # noise variance of inverse depth
            share_kept = 1 - noise / variance if variance > noise else 0.0
            moved = plane + share_kept * (value - plane)
            smooth[row, column] = moved if moved > 0 else value
    return smooth


@compiled
def _add_row(
    inverse_depth: Float32[ndarray, "height width"],
    row: int,
    sign: float,
    sums: Float64[ndarray, "3 width"],
) -> None:
    """Add a row to the sums or subtract it; rows outside the image are ignored."""
    if 0 <= row < inverse_depth.shape[0]:
        for column in range(inverse_depth.shape[1]):
            value = sign * np.float64(inverse_depth[row, column])
            sums[0, column] += value
            sums[1, column] += value * inverse_depth[row, column]
            sums[2, column] += value * row

"""Planes of a finished depth map smoothed: the last step after depth completion."""

import numpy as np

from kitti_frame import Array


def smooth_planes(inverse: Array, reach: int, noise_m: float) -> Array:
    """Draw each pixel to the plane of its window, the less the worse the plane fits (Lee 1980)."""
    height, width = inverse.shape
    v = inverse.astype(np.float64)
    row, column = np.arange(height)[:, None] - height / 2, np.arange(width) - width / 2
    count, row_sum, column_sum, row_square, column_square, total, square, down, across = (
        window_sums(each * np.ones_like(v), reach)
        for each in (1.0, row, column, row**2, column**2, v, v * v, v * row, v * column)
    )
    middle_row, middle_column, mean = row_sum / count, column_sum / count, total / count
    row_spread = (row_square / count - middle_row**2).clip(1e-9)
    column_spread = (column_square / count - middle_column**2).clip(1e-9)
    down = (down / count - middle_row * mean) / row_spread
    across = (across / count - middle_column * mean) / column_spread
    variance = square / count - mean**2 - down**2 * row_spread - across**2 * column_spread
    plane = mean + down * (row - middle_row) + across * (column - middle_column)
    noise = (noise_m * v * v) ** 2
    kept = np.where(variance > noise, 1 - noise / np.where(variance > noise, variance, 1), 0)
    drawn = plane + kept * (v - plane)
    return np.where(v == 0, 0, np.where(drawn > 0, drawn, v)).astype(np.float32)


def window_sums(values: Array, reach: int) -> Array:
    """Sum the square window around each pixel, as far as the image goes."""
    for _ in range(2):
        total = np.pad(values.cumsum(axis=0), ((1, 0), (0, 0)))
        place = np.arange(len(values))
        values = total[(place + reach + 1).clip(max=len(values))] - total[(place - reach).clip(0)]
        values = values.T
    return values

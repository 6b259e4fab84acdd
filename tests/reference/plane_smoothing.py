"""Planes smoothed pixel by pixel: a plane by least squares, and Lee's weight."""

import numpy as np


def smoothed(depth_m, windows_px, noise_m):
    inverse = np.array([[1 / each if each > 0 else 0.0 for each in row] for row in depth_m])
    for reach in windows_px:
        inverse = np.array(
            [
                [_drawn(inverse, row, column, reach, noise_m) for column in range(inverse.shape[1])]
                for row in range(inverse.shape[0])
            ]
        )
    return np.array([[1 / each if each > 0 else 0.0 for each in row] for row in inverse])


def _drawn(inverse, row, column, reach, noise_m):
    value = inverse[row, column]
    if value == 0:
        return value
    places = [
        (r, c)
        for r in range(row - reach, row + reach + 1)
        for c in range(column - reach, column + reach + 1)
        if 0 <= r < inverse.shape[0] and 0 <= c < inverse.shape[1]
    ]
    design = np.array([[1.0, r - row, c - column] for r, c in places])
    values = np.array([inverse[place] for place in places])
    plane, *_ = np.linalg.lstsq(design, values, rcond=None)
    variance = np.mean((values - design @ plane) ** 2)
    noise = (noise_m * value**2) ** 2
    kept = 1 - noise / variance if variance > noise else 0.0
    drawn = plane[0] + kept * (value - plane[0])
    return drawn if drawn > 0 else value

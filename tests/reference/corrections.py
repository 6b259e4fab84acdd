"""Which corrections of a completion count, pixel by pixel in plain Python."""

import math

import numpy as np


def counted(depth_m, filled_m, is_measured, least, above, beside):
    """The depth with its corrections up to a threshold undone, and in full from twice it on."""
    height, width = depth_m.shape
    result = np.empty_like(depth_m)
    for row in range(height):
        for column in range(width):
            correction = math.log(depth_m[row, column] / filled_m[row, column])
            direction = "nearer" if correction < 0 else "farther"
            threshold = threshold_at(
                row,
                column,
                is_measured,
                least,
                getattr(above, direction),
                getattr(beside, direction),
            )
            size = abs(correction)
            share = 1.0 if size >= 2 * threshold else max(size / threshold - 1, 0.0)
            result[row, column] = filled_m[row, column] * math.exp(share * correction)
    return result


def threshold_at(row, column, is_measured, least, above, beside):
    """By the distance from the nearest measurement, and by the rows above the highest one."""
    away = min(
        (math.hypot(row - each[0], column - each[1]) for each in np.argwhere(is_measured)),
        default=math.inf,
    )
    if away <= 1.2:
        return beside
    if away < 2.5:
        return least + (beside - least) * (2.5 - away) / 1.3
    height, width = is_measured.shape
    near = range(max(column - 7, 0), min(column + 8, width))
    rows = [each for each in range(height) if any(is_measured[each, other] for other in near)]
    rows_above = (rows[0] if rows else height) - row
    if rows_above <= 20:
        return least
    if rows_above >= 30:
        return above
    return least + (above - least) * (rows_above - 20) / 10

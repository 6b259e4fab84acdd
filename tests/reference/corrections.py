"""Which corrections of a completion count, pixel by pixel in plain Python."""

import math

import numpy as np


def counted(depth_m, filled_m, is_measured, least, least_above):
    """The depth with its corrections up to a threshold undone, and in full from twice it on."""
    height, width = depth_m.shape
    result = np.empty_like(depth_m)
    for row in range(height):
        for column in range(width):
            threshold = threshold_at(row, column, is_measured, least, least_above)
            correction = math.log(depth_m[row, column] / filled_m[row, column])
            size = abs(correction)
            share = 1.0 if size >= 2 * threshold else max(size / threshold - 1, 0.0)
            result[row, column] = filled_m[row, column] * math.exp(share * correction)
    return result


def threshold_at(row, column, is_measured, least, least_above):
    """By how many rows a pixel lies above the highest measurement within seven columns."""
    height, width = is_measured.shape
    near = range(max(column - 7, 0), min(column + 8, width))
    rows = [each for each in range(height) if any(is_measured[each, other] for other in near)]
    above = (rows[0] if rows else height) - row
    if above <= 20:
        return least
    if above >= 50:
        return least_above
    return least + (least_above - least) * (above - 20) / 30

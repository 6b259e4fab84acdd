"""Expanded depth by its definition, pixel by pixel over lists of lists; 0 is empty."""

import statistics

import numpy as np
from scipy import ndimage


def fill(depth, *, pick):
    """Empty pixels take, of the measured ones nearest in king's moves, what `pick` says."""
    measured = [
        (y, x, value) for y, row in enumerate(depth) for x, value in enumerate(row) if value
    ]
    return [
        [value or _nearest(y, x, measured, pick) for x, value in enumerate(row)]
        for y, row in enumerate(depth)
    ]


def _nearest(y, x, measured, pick):
    by_moves = {}
    for other_y, other_x, value in measured:
        by_moves.setdefault(max(abs(other_y - y), abs(other_x - x)), []).append(value)
    return pick(by_moves[min(by_moves)]) if by_moves else 0.0


def maximum(depth, side):
    return ndimage.maximum_filter(np.array(depth), size=side, mode="constant", cval=0.0).tolist()


def median(depth, side):
    """Outside the map its outermost pixels repeat."""
    half, height, width = side // 2, len(depth), len(depth[0])

    def window(y, x):
        return [
            depth[min(max(row, 0), height - 1)][min(max(column, 0), width - 1)]
            for row in range(y - half, y + half + 1)
            for column in range(x - half, x + half + 1)
        ]

    return [[statistics.median(window(y, x)) for x in range(width)] for y in range(height)]

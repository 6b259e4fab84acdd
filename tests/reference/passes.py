"""The mean of what passes give for a box, one by one, with angles as complex numbers."""

import cmath
import math


def mean_box(boxes, scores):
    """Rows of x, y, z, length, width, height, yaw of one box, a row a pass; their scores."""
    count = len(boxes)
    centers = [sum(row[place] for row in boxes) / count for place in range(3)]
    sizes = [math.prod(row[place] for row in boxes) ** (1 / count) for place in range(3, 6)]
    axis = cmath.phase(sum(cmath.exp(2j * row[6]) for row in boxes)) / 2
    ends = (axis, axis + math.pi)
    yaw = max(ends, key=lambda end: math.cos(end - boxes[-1][6]))
    return [*centers, *sizes, yaw], sum(scores) / count

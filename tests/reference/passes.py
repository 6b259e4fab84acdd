"""The mean of what passes give for a box, one by one, with angles as complex numbers."""

import cmath
import math


def mean_box(boxes, front_logits):
    """Rows of x, y, z, length, width, height, yaw of one box, a row a pass."""
    count = len(boxes)
    centers = [sum(row[place] for row in boxes) / count for place in range(3)]
    sizes = [math.prod(row[place] for row in boxes) ** (1 / count) for place in range(3, 6)]
    axis = cmath.phase(sum(cmath.exp(2j * row[6]) for row in boxes)) / 2

    def votes(end):
        return sum(
            logit * math.copysign(1, math.cos(row[6] - end))
            for row, logit in zip(boxes, front_logits, strict=True)
        )

    return [*centers, *sizes, max((axis, axis + math.pi), key=votes)]

"""Boxes resized and moved along their own axes, one by one."""

import math


def aligned(boxes, names, name, length_m, towards_m):
    """Rows of x, y, z, length, width, height, yaw."""
    answer = []
    for row, each in zip(boxes, names, strict=True):
        x, y, z, length, width, height, yaw = row
        if each == name:
            length = max(length + length_m, 0.1)
            distance = math.hypot(x, y)
            cosine = math.cos(yaw - math.atan2(y, x)) if distance > 0 else 0.0
            x, y = (
                x - towards_m * cosine * math.cos(yaw),
                y - towards_m * cosine * math.sin(yaw),
            )
        answer.append([x, y, z, length, width, height, yaw])
    return answer

"""Where annotators let a car end that they see from one side."""

import math
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

_LEAST_ANGLE: Final = math.radians(20.0)
"""Between a flank and the line of sight in the views that a car's box is from: it has one size in
all frames of a drive, and most of them show it from behind or ahead."""
_EARLIER: Final = math.radians(25.0)
"""By how much these views are flatter than one from the side. With both, points of the flank reach
as near to the far ends of simulated labels as to those of KITTI's cars."""
_BELOW: Final = 0.5
"""Share of the height below which bodies bulge most and mirrors are not."""


def labelled_ends(
    vertices: Float[np.ndarray, "num_vertices 3"],
    size_lwh: tuple[float, float, float],
    viewpoint: Float64[np.ndarray, "2"],
) -> tuple[float, float]:
    """From where to where along x [m] KITTI's annotators see a car.

    They have its points alone. An end that faces away is round, so the last they see of it is
    where the line of sight leaves the flank: there the box ends, 0.3 m before the bumper or so.
    As one passes a car in a drive, its length changes by some centimetres.

    Args:
        vertices: Of the car in its own frame [m]: x ahead, y left, z up, the origin on the ground.
        size_lwh: Its length, width and height [m].
        viewpoint: x and y of the sensor in that frame [m].
    """
    length, width, height = size_lwh
    body = vertices[vertices[:, 2] < _BELOW * height, :2]
    beside = max(abs(float(viewpoint[1])) - width / 2, 0.0)
    side = math.copysign(1.0, float(viewpoint[1]))
    ends = []
    for way in (-1.0, 1.0):
        away = length / 2 - way * float(viewpoint[0])
        angle = max(math.atan2(beside, away) - _EARLIER, _LEAST_ANGLE)
        last = np.argmax(body @ np.array([way * math.sin(angle), side * math.cos(angle)]))
        seen = min(way * float(body[last, 0]), length / 2)
        ends.append(way * (seen if away > 0 else length / 2))
    return ends[0], ends[1]

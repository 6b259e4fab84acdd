"""Labelled ends of a car viewed from one side, as annotated in KITTI."""

import math
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

_LEAST_ANGLE: Final = math.radians(20.0)
"""Minimum angle between a flank and the line of sight in the views that define a car's box: it has
one size in all frames of a drive, and most show it from behind or ahead."""
_EARLIER: Final = math.radians(25.0)
"""Angle by which these views are flatter than a side view. With both angles, points of the flank
reach as near to the far ends of simulated labels as to those of KITTI's cars."""
_BELOW: Final = 0.5
"""Share of the height below which bodies bulge most and there are no mirrors."""


def labelled_ends(
    vertices: Float[np.ndarray, "num_vertices 3"],
    size_lwh: tuple[float, float, float],
    viewpoint: Float64[np.ndarray, "2"],
) -> tuple[float, float]:
    """Compute a car's rear and front end along x [m] as KITTI's annotators label them.

    Annotators have only the points. An end that faces away is round, so the last visible part is
    where the line of sight leaves the flank: the box ends there, about 0.3 m before the bumper. The
    length of a passing car changes by some centimetres during a drive.

    Args:
        vertices: Car vertices in its own frame [m]: x ahead, y left, z up, the origin on the
            ground.
        size_lwh: Length, width and height [m].
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

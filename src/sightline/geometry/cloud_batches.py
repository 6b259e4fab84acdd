"""Batches of point clouds, told from organised clouds.

Without PyTorch, for checks that start at once.
"""

import math
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Real

from sightline.geometry.echoes import is_echo

_MIN_POINTS: Final = 1000  # in each cloud of a batch
_MIN_ECHOES: Final = 200  # among the compared points of each cloud
_COMPARED_CLOUDS: Final = 16
_COMPARED_POINTS: Final = 4000
_WHOLE_SHARE: Final = 0.75  # of the spreads of all points
_OTHER_DIRECTION_RAD: Final = math.radians(10)
"""Smallest angle between a tenth of the points of one index in separate clouds. It is smaller
between two returns of a ray, and between lasers that scan one pattern side by side."""


def is_batch_of_clouds(array: Real[np.ndarray, "rows *columns fields"]) -> bool:
    """Check if the rows of an array are separate clouds, not rings or columns of an organised one.

    The directions of each spread as far as all, and points of one index lie in unlike directions,
    or all clouds are equal. In doubt the result is False.

    Args:
        array: x, y, z first.
    """
    if array.ndim < 3 or len(array) < 2 or array[0].size < _MIN_POINTS * array.shape[-1]:
        return False
    clouds = array.reshape(len(array), -1, array.shape[-1])
    num_clouds, num_points, _ = clouds.shape
    compared = clouds[:: -(-num_clouds // _COMPARED_CLOUDS), :: -(-num_points // _COMPARED_POINTS)]
    points = compared[..., :3].astype(np.float64)
    has_echo = is_echo(points.reshape(-1, 3)).reshape(points.shape[:2])
    if has_echo.sum(axis=1).min() < _MIN_ECHOES:
        return False
    directions = np.where(has_echo[..., None], points, 1.0)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    whole = _spreads(directions[has_echo])
    for cloud, used in zip(directions, has_echo, strict=True):
        if (_spreads(cloud[used]) < _WHOLE_SHARE * whole).any():
            return False
    is_equal = (points == points[0])[has_echo].all()
    return bool(is_equal) or _are_unlike(directions, has_echo)


def _spreads(directions: Float64[np.ndarray, "num_points 3"]) -> Float64[np.ndarray, "3"]:
    """Standard deviations along the principal axes, ascending; a ring's first is nearly 0."""
    variances = np.linalg.eigvalsh(np.cov(directions.T))
    return np.asarray(np.sqrt(variances.clip(min=0)))


def _are_unlike(
    directions: Float64[np.ndarray, "num_clouds num_points 3"],
    has_echo: Bool[np.ndarray, "num_clouds num_points"],
) -> bool:
    """Check if points of one index lie in unlike directions in the first and most other clouds."""
    num_unlike = 0
    for cloud, used in zip(directions[1:], has_echo[1:], strict=True):
        both = used & has_echo[0]
        cosines = (cloud[both] * directions[0, both]).sum(axis=-1)
        if len(cosines) and np.quantile(cosines, 0.1) < math.cos(_OTHER_DIRECTION_RAD):
            num_unlike += 1
    return 2 * num_unlike >= len(directions) - 1

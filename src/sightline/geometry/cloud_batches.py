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
_SAME_RAY_RAD: Final = math.radians(0.5)  # nine in ten pairs of two sweeps of an organised LiDAR
_NEXT_RAY_RAD: Final = math.radians(0.05)  # smallest step between columns or rings
_MIN_PAIRED_SHARE: Final = 0.5  # of the points with an echo in either cloud
_EQUAL_M: Final = 1e-4
_MAX_EQUAL_SHARE: Final = 0.3  # of the pairs; most rays have the same last and strongest return
_SMALL_M: Final = 0.5  # smaller than the distance between two returns of a ray
_MIN_SMALL_SHARE: Final = 0.01  # of the pairs, of small rises and of small falls


def is_batch_of_clouds(array: Real[np.ndarray, "rows *columns fields"]) -> bool:
    """Check if the rows of an array are separate clouds, not rings or columns of an organised one.

    The directions of each spread as far as all, and points of one index lie in unlike directions,
    or in the same directions with other ranges than two returns of a ray have, or all clouds are
    equal. In doubt the result is False.

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
    return bool(is_equal) or _are_separate(points, directions, has_echo)


def _spreads(directions: Float64[np.ndarray, "num_points 3"]) -> Float64[np.ndarray, "3"]:
    """Standard deviations along the principal axes, ascending; a ring's first is nearly 0."""
    variances = np.linalg.eigvalsh(np.cov(directions.T))
    return np.asarray(np.sqrt(variances.clip(min=0)))


def _are_separate(
    points: Float64[np.ndarray, "num_clouds num_points 3"],
    directions: Float64[np.ndarray, "num_clouds num_points 3"],
    has_echo: Bool[np.ndarray, "num_clouds num_points"],
) -> bool:
    """Check if the first and most other clouds are separate, by their points of one index."""
    num_separate = 0
    for cloud, cloud_directions, used in zip(points[1:], directions[1:], has_echo[1:], strict=True):
        both = used & has_echo[0]
        if not both.any():
            continue
        first, second = directions[0, both], cloud_directions[both]
        angle = float(np.quantile(np.linalg.norm(second - first, axis=-1), 0.9))
        if angle > _OTHER_DIRECTION_RAD:
            num_separate += 1
        elif angle < _SAME_RAY_RAD and both.sum() >= _MIN_PAIRED_SHARE * (used | has_echo[0]).sum():
            is_scanned_again = _are_same_rays(first, second)
            num_separate += is_scanned_again and _has_other_ranges(points[0, both], cloud[both])
    return 2 * num_separate >= len(points) - 1


def _are_same_rays(
    first: Float64[np.ndarray, "num_points 3"], second: Float64[np.ndarray, "num_points 3"]
) -> bool:
    """Check if directions differ by chance only, not by a step to the next column or ring."""
    azimuth = np.arctan2(
        first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0],
        (first[:, :2] * second[:, :2]).sum(axis=-1),
    )
    elevation = second[:, 2] - first[:, 2]
    return bool(max(abs(np.median(azimuth)), abs(np.median(elevation))) < _NEXT_RAY_RAD)


def _has_other_ranges(
    first: Float64[np.ndarray, "num_points 3"], second: Float64[np.ndarray, "num_points 3"]
) -> bool:
    """Check if ranges on the same rays are of separate sweeps, not of two returns of each ray.

    Two returns are equal, or half a metre or more apart, and often the first is always the nearer.
    """
    rise_m = np.linalg.norm(second, axis=-1) - np.linalg.norm(first, axis=-1)
    is_equal = np.abs(rise_m) < _EQUAL_M
    small_rises = (rise_m >= _EQUAL_M) & (rise_m < _SMALL_M)
    small_falls = (rise_m <= -_EQUAL_M) & (rise_m > -_SMALL_M)
    small_share = min(small_rises.mean(), small_falls.mean())
    return bool(is_equal.mean() <= _MAX_EQUAL_SHARE and small_share >= _MIN_SMALL_SHARE)

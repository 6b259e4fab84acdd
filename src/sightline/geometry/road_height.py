"""How high a LiDAR sits above the road, told from what it saw of it. Without PyTorch."""

from collections.abc import Iterable
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

_FROM_M, _TO_M, _CELL_M = 4.0, 30.0, 1.0  # nearer is the car itself, farther hills
_WINDOW_M = 0.2  # of heights among which most cells of a road lie
_SCALES_M = (0.4, 0.3, 0.2, 0.15, 0.1, 0.1)  # of residuals that count, from coarse to fine
_LEAST_CELLS = 30
_PRIOR_CELLS = 5.0  # by which a road is held level, where cells lie too close to tell its slope
_LOWEST_M, _HIGHEST_M = 0.3, 5.0

MIN_LIDAR_HEIGHT_M: Final = 0.1
"""Below any LiDAR on wheels."""
MAX_LIDAR_HEIGHT_M: Final = 10.0
"""Above any; what is higher is in another unit."""


def road_height_m(points: Float[np.ndarray, "num_points fields"]) -> float | None:
    """The LiDAR's height [m] above the road around it; None where hardly any road was seen.

    A plane through the lowest points of cells of one metre, 4 to 30 m away, by least squares that
    are reweighted (Tukey's biweight) from where most of them lie.

    Args:
        points: x, y, z first [m], LiDAR frame with z up; what is not finite is passed over.
    """
    lowest = _lowest_of_cells(points[:, :3].astype(np.float64))
    if len(lowest) < _LEAST_CELLS:
        return None
    z = np.sort(lowest[:, 2])
    in_window = np.searchsorted(z, z + _WINDOW_M, side="right") - np.arange(len(z))
    first = int(in_window.argmax())
    plane = np.array([0.0, 0.0, np.median(z[first : first + in_window[first]])])
    terms = np.column_stack((lowest[:, :2], np.ones(len(lowest))))
    weights = np.zeros(len(lowest))
    for scale_m in _SCALES_M:
        off = (lowest[:, 2] - terms @ plane) / (2 * scale_m)
        weights = np.where(np.abs(off) < 1, (1 - off**2) ** 2, 0.0)
        weighed = terms * weights[:, None]
        level = np.diag([_PRIOR_CELLS, _PRIOR_CELLS, 0.0])
        plane = np.linalg.lstsq(terms.T @ weighed + level, weighed.T @ lowest[:, 2], rcond=None)[0]
    height_m = float(-plane[2])
    is_road = weights.sum() >= _LEAST_CELLS / 2 and _LOWEST_M <= height_m <= _HIGHEST_M
    return height_m if is_road else None


def drive_height_m(sweeps: Iterable[Float[np.ndarray, "_num_points fields"]]) -> float | None:
    """The median of what some sweeps of a drive tell; None where none does."""
    heights_m = [height for sweep in sweeps if (height := road_height_m(sweep)) is not None]
    return float(np.median(heights_m)) if heights_m else None


def _lowest_of_cells(
    xyz: Float64[np.ndarray, "num_points 3"],
) -> Float64[np.ndarray, "num_cells 3"]:
    away_m = np.hypot(xyz[:, 0], xyz[:, 1])
    is_level = np.abs(xyz[:, 2]) < 2 * _HIGHEST_M  # of what is far above or below none is road
    near = xyz[(away_m > _FROM_M) & (away_m < _TO_M) & is_level]
    cells = np.floor(near[:, :2] / _CELL_M)
    order = np.lexsort((near[:, 2], cells[:, 1], cells[:, 0]))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (cells[order][1:] != cells[order][:-1]).any(axis=1)
    lowest: Float64[np.ndarray, "num_cells 3"] = near[order][is_first]
    return lowest

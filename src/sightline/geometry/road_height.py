"""The road's plane in sweeps: how high a LiDAR sits above it, how it is tilted, which way is up.

Without PyTorch.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.geometry.tilt import Tilt

_FROM_M, _TO_M, _CELL_M = 4.0, 30.0, 1.0  # nearer is the car itself, farther hills
_WINDOW_M = 0.2  # of heights among which most cells of a road lie
_SCALES_M = (0.4, 0.3, 0.2, 0.15, 0.1, 0.1)  # of residuals that count, from coarse to fine
_LEAST_CELLS = 30
_PRIOR_CELLS = 5.0  # by which a road is held level, where cells lie too close to tell its slope
_LOWEST_M, _HIGHEST_M = -0.3, 5.0
_LEVEL = Tilt(roll_deg=0.0, pitch_deg=0.0)
_MAX_TILT_DEG, _STEP_DEG = 24.0, 3.0  # of the search, in roll and in pitch
_SEARCHED_CELLS = 600  # are enough to choose a step by
_COARSE_WINDOW_M = 0.5  # a road's heights between two steps of the search
_LEVEL_PREFERENCE = 0.005  # share of the cells by which a degree of tilt must be better
_MORE_CELLS = 1.1  # on a tilted plane than on a level one
_PLAIN_SHARE = 0.5  # of all cells on one plane: there is no other
_DOUBTFUL_SHARE = 0.25  # of all cells on the road: perhaps z is not up
_CLEARLY_MORE = 2.0  # cells on a road that lies in another direction

MIN_LIDAR_HEIGHT_M: Final = -0.3
"""Just below the road: a cloud's origin may lie on it, as in a frame called base_footprint."""
MAX_LIDAR_HEIGHT_M: Final = 10.0
"""Above any LiDAR on wheels; a greater number is in another unit."""

MAX_TILT_DEG: Final = 45.0
"""More than any LiDAR on the road is tilted in roll or pitch; a greater number is no tilt."""

_TILTS_AGREE_DEG, _HEIGHTS_AGREE_M = 4.0, 0.5  # of what is given and what the road says
_LEAST_TILT_DEG = 3.0  # by the median of several sweeps; less is a road's crown, or a hill
_LEAST_TILT_OF_FEW_DEG = 4.0
_SEVERAL = 3

_UPRIGHT: Final = {
    # Which way is up: the rows of a rotation that makes z up, x ahead in the usual conventions.
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-y": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "y": ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class RoadPlane:
    """The road in a sweep."""

    height_m: float
    """Height of the LiDAR above the road [m]."""
    tilt: Tilt
    """Tilt of the LiDAR against the road."""
    num_cells: float
    """Cells of a square metre that lie on it, by their weights."""
    share: float
    """These as a share of all cells that have points."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarPose:
    """How a LiDAR is mounted over the road, as far as its sweeps tell."""

    height_m: float | None
    """Height of the LiDAR above the road [m]; None where hardly any road is seen."""
    tilt: Tilt | None
    """None where it is level, or too little tilted to be told from a road's own shape."""


def mount_doubts(
    sweeps: Sequence[Float[np.ndarray, "_num_points _fields"]],
    height_m: float | None,
    tilt: Tilt | None,
) -> tuple[str, ...]:
    """Differences between the mount that somebody gives for a LiDAR and the road that it sees.

    Args:
        sweeps: x, y, z first [m], LiDAR frame with z about up.
        height_m: As given; None: not given.
        tilt: Likewise.
    """
    doubts = []
    if tilt is not None:
        seen = lidar_pose(sweeps)
        up = (seen.tilt or _LEVEL).up
        apart_deg = math.degrees(math.acos(min(float(tilt.up @ up), 1.0)))
        if seen.height_m is not None and apart_deg > _TILTS_AGREE_DEG:
            doubts.append(
                f"lidar_tilt_deg is {tilt}, by the road that the LiDAR sees it is "
                f"{seen.tilt or 'none'}; give degrees, or leave it out"
            )
    if height_m is not None and not doubts:
        seen_m = lidar_pose(sweeps, tilt).height_m
        if seen_m is not None and abs(seen_m - height_m) > _HEIGHTS_AGREE_M:
            doubts.append(
                f"lidar_height_m is {height_m:g}, by the road that the LiDAR sees it is "
                f"{seen_m:.2f}; correct it, or leave it out"
            )
    return tuple(doubts)


def lidar_pose(
    sweeps: Iterable[Float[np.ndarray, "_num_points _fields"]], tilt: Tilt | None = None
) -> LidarPose:
    """The height and the tilt of a LiDAR by the median of the roads in some sweeps.

    Tilts below 3 degrees count as none, of less than three sweeps those below 4: on 90 frames of
    KITTI, whose LiDAR is level, single sweeps are off by up to 3.4 degrees.

    Args:
        sweeps: x, y, z first [m], LiDAR frame with z about up.
        tilt: Where it is known.
    """
    held = [sweep[:, :3].astype(np.float64) for sweep in sweeps]
    if tilt is None:
        planes = [plane for xyz in held if (plane := road_plane(xyz)) is not None]
        least_deg = _LEAST_TILT_DEG if len(planes) >= _SEVERAL else _LEAST_TILT_OF_FEW_DEG
        if planes:
            found = Tilt.of_up(np.median([plane.tilt.up for plane in planes], axis=0))
            tilt = found if found.angle_deg >= least_deg else None
    if tilt is not None:
        rotation = tilt.level_from_lidar[:3, :3]
        held = [xyz @ rotation.T for xyz in held]
    return LidarPose(height_m=drive_height_m(held), tilt=tilt)


def road_plane(points: Float[np.ndarray, "num_points fields"]) -> RoadPlane | None:
    """The road in a sweep of a LiDAR that is tilted by up to 24 degrees in roll and in pitch.

    The fit of `road_height_m` begins twice: with a level LiDAR, and with the tilt, in steps of 3
    degrees, by which most cells' lowest points lie at one height. The second is taken where a tenth
    more cells lie on its plane. Deterministic.

    Args:
        points: x, y, z first [m], LiDAR frame with z about up; rows that are not finite are passed
            over.

    Returns:
        None where hardly any road is seen.
    """
    xyz = points[:, :3].astype(np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    level = _plane_near(xyz, _LEVEL, fits=1)
    if level is not None and level.share >= _PLAIN_SHARE:
        return level
    coarse = _coarse_tilt(xyz)
    tilted = None if coarse is None else _plane_near(xyz, coarse, fits=3)
    if tilted is None or level is None:
        return level or tilted
    return tilted if tilted.num_cells > _MORE_CELLS * level.num_cells else level


def upright_turn(
    points: Float[np.ndarray, "num_points fields"],
) -> Float64[np.ndarray, "3 3"] | None:
    """The rotation of axes that makes z up in a cloud whose road lies in another direction.

    For clouds of other conventions: z down (x forward, y right), a camera's (x right, y down, z
    forward) and so on.

    Returns:
        None where z is up, or nothing is a road in any direction.
    """
    plane = road_plane(points)
    if plane is not None and plane.share >= _DOUBTFUL_SHARE:
        return None
    best, most = None, 0.0 if plane is None else _CLEARLY_MORE * plane.num_cells
    xyz = points[:, :3].astype(np.float64)
    for rows in _UPRIGHT.values():
        turn = np.array(rows, dtype=np.float64)
        other = road_plane(xyz @ turn.T)
        if other is not None and other.share >= _DOUBTFUL_SHARE and other.num_cells > most:
            best, most = turn, other.num_cells
    return best


def road_height_m(points: Float[np.ndarray, "num_points fields"]) -> float | None:
    """The height [m] of a level LiDAR above the road around it; None where hardly any is seen.

    A plane through the lowest points of cells of one metre, 4 to 30 m away, by least squares that
    are reweighted (Tukey's biweight) from where most of them lie.

    Args:
        points: x, y, z first [m], LiDAR frame with z up; rows that are not finite are passed over.
    """
    fitted = _fit(points[:, :3].astype(np.float64))
    return None if fitted is None else -float(fitted[0][2])


def drive_height_m(sweeps: Iterable[Float[np.ndarray, "_num_points fields"]]) -> float | None:
    """The median of the heights in some sweeps of a drive; None where none shows the road."""
    heights_m = [height for sweep in sweeps if (height := road_height_m(sweep)) is not None]
    return float(np.median(heights_m)) if heights_m else None


def _plane_near(
    xyz: Float64[np.ndarray, "num_points 3"], tilt: Tilt, *, fits: int
) -> RoadPlane | None:
    """The plane that some fits end in, each in the frame that the one before made level."""
    plane = None
    for _ in range(fits):
        rotation = tilt.level_from_lidar[:3, :3]
        fitted = _fit(xyz @ rotation.T)
        if fitted is None:
            return None
        (slope_x, slope_y, z_0), num_cells, share = fitted
        tilt = Tilt.of_up(rotation.T @ np.array((-slope_x, -slope_y, 1.0)))
        plane = RoadPlane(height_m=-float(z_0), tilt=tilt, num_cells=num_cells, share=share)
    return plane


def _fit(
    xyz: Float64[np.ndarray, "num_points 3"],
) -> tuple[Float64[np.ndarray, "3"], float, float] | None:
    """Z = slope_x * x + slope_y * y + z_0 of the road; how many and which share of the cells."""
    lowest = _lowest_of_cells(xyz, max_abs_z_m=2 * _HIGHEST_M)
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
    num_cells = float(weights.sum())
    is_road = num_cells >= _LEAST_CELLS / 2 and _LOWEST_M <= -float(plane[2]) <= _HIGHEST_M
    return (plane, num_cells, num_cells / len(lowest)) if is_road else None


def _coarse_tilt(xyz: Float64[np.ndarray, "num_points 3"]) -> Tilt | None:
    """The tilt, of those in the search's steps, by which most cells lie at one height."""
    reach_m = 2 * _HIGHEST_M + _TO_M * float(np.tan(np.radians(_MAX_TILT_DEG)))
    lowest = _lowest_of_cells(xyz, max_abs_z_m=reach_m)
    if len(lowest) < _LEAST_CELLS:
        return None
    lowest = lowest[:: max(len(lowest) // _SEARCHED_CELLS, 1)]
    angles_deg = np.arange(-_MAX_TILT_DEG, _MAX_TILT_DEG + 1, _STEP_DEG).tolist()
    best, best_score = None, 0.0
    for roll_deg in angles_deg:
        for pitch_deg in angles_deg:
            tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
            z = np.sort(lowest @ tilt.up)
            in_window = np.searchsorted(z, z + _COARSE_WINDOW_M, side="right") - np.arange(len(z))
            in_window[(-z < _LOWEST_M) | (-z > _HIGHEST_M + _COARSE_WINDOW_M)] = 0
            score = float(in_window.max()) * (1 - _LEVEL_PREFERENCE * tilt.angle_deg)
            if score > best_score:
                best, best_score = tilt, score
    return best


def _lowest_of_cells(
    xyz: Float64[np.ndarray, "num_points 3"], *, max_abs_z_m: float
) -> Float64[np.ndarray, "num_cells 3"]:
    away_m = np.hypot(xyz[:, 0], xyz[:, 1])
    is_near = np.abs(xyz[:, 2]) < max_abs_z_m  # far above or below there is no road
    near = xyz[(away_m > _FROM_M) & (away_m < _TO_M) & is_near]
    cells = np.floor(near[:, :2] / _CELL_M)
    order = np.lexsort((near[:, 2], cells[:, 1], cells[:, 0]))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (cells[order][1:] != cells[order][:-1]).any(axis=1)
    lowest: Float64[np.ndarray, "num_cells 3"] = near[order][is_first]
    return lowest

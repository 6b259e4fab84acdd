"""Road plane in sweeps: a LiDAR's height above it, its tilt, and the direction up.

Without PyTorch.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.geometry.tilt import Tilt

_FROM_M, _TO_M, _CELL_M = 4.0, 30.0, 1.0  # nearer points are the car itself, farther ones hills
_WINDOW_M = 0.2  # range of heights that contains most cells of a road
_SCALES_M = (0.4, 0.3, 0.2, 0.15, 0.1, 0.1)  # scales of the residuals, from coarse to fine
_MIN_CELLS = 30
_PRIOR_CELLS = 5.0  # weight of a level road, for cells too close together to determine the slope
_LOWEST_M = -0.3
_LEVEL = Tilt(roll_deg=0.0, pitch_deg=0.0)
_MAX_TILT_DEG, _STEP_DEG = 24.0, 3.0  # limits and step of the search, in roll and in pitch
_SEARCHED_CELLS = 600  # enough to choose a step
_COARSE_WINDOW_M = 0.5  # range of a road's heights between two steps of the search
_LEVEL_PREFERENCE = 0.005  # share of cells that each degree of tilt must gain
_MORE_CELLS = 1.1  # ratio of cells on a tilted plane to those on a level one
_PLAIN_SHARE = 0.5  # share of cells on one plane that excludes another
_DOUBTFUL_SHARE = 0.25  # share of cells on the road below which z may not be up
_CLEARLY_MORE = 2.0  # ratio of cells on a road in another direction

MIN_LIDAR_HEIGHT_M: Final = -0.3
"""Smallest LiDAR height: the origin may lie on the road, as in a frame called base_footprint."""
MAX_LIDAR_HEIGHT_M: Final = 10.0
"""Height above any LiDAR on wheels and most on masts; a greater number is in another unit."""

USUAL_HEIGHT_M: Final = 5.0
"""Height above LiDARs on cars and trucks; a road farther below is searched where none is nearer."""

MAX_TILT_DEG: Final = 45.0
"""Roll and pitch beyond any LiDAR on the road; a greater number is no tilt."""

_FEET_M: Final = (0.3, 0.7)
"""Heights of a car's LiDAR whose points are in feet taken for metres: those of KITTI's 90 frames
are 0.41 to 0.67 (but for one), and no sound one is below 1.5. An origin on the road lies below."""

_FEET_AS_HIGH_M: Final = 6.5
"""Heights from the usual to this one may be those of a car's LiDAR in feet, too."""

_MANY_POINTS: Final = 2000
"""Number of points from which a sweep without a road is no mere remainder of a sweep."""

UNKNOWN_TILT: Final = (
    "too little of the road is visible to find the LiDAR's tilt beside its given height: a level "
    "one is assumed; give lidar_tilt_deg, zeros if it is level"
)
"""Warning for sweeps by `is_road_hidden`."""

_BELOW_ROAD_M = -0.1  # an origin on the road may be measured a little below it

_TILTS_AGREE_DEG = 4.0  # between given and measured mount
_HEIGHTS_AGREE_M = 0.25
"""Difference between given and measured height from which one is doubted. Of KITTI's 90 sweeps, one
differs so much from 1.73 m by itself, and no median of three or more."""
_MIN_TILT_DEG = 3.0  # from the median of several sweeps; less is a road's crown, or a hill
_MIN_TILT_FEW_SWEEPS_DEG = 4.0
_MANY_SWEEPS = 3

_UPRIGHT: Final = {
    # Direction up, with the rotation rows that make z up, and x forward in the usual conventions.
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "-y": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "y": ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
    "x": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "-x": ((0, 1, 0), (0, 0, -1), (-1, 0, 0)),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class RoadPlane:
    """Road plane in a sweep."""

    height_m: float
    """Height of the LiDAR above the road [m]."""
    tilt: Tilt
    """Tilt of the LiDAR against the road."""
    num_cells: float
    """Weighted number of one-metre cells on the plane."""
    share: float
    """Share of these among all cells with points."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarPose:
    """Mount of a LiDAR over the road, as far as its sweeps determine it."""

    height_m: float | None
    """Height of the LiDAR above the road [m]; None if hardly any road is visible."""
    tilt: Tilt | None
    """Tilt; None if it is level, or indistinguishable from a road's own shape."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MountDoubt:
    """Difference between a LiDAR's given mount and the road in its sweeps; `str` joins both."""

    problem: str
    remedy: str
    """Action for the user."""

    def __str__(self) -> str:
        """Format the difference and the remedy."""
        return f"{self.problem}; {self.remedy}"


def mount_doubts(
    sweeps: Sequence[Float[np.ndarray, "_num_points _fields"]],
    height_m: float | None,
    tilt: Tilt | None,
) -> tuple[MountDoubt, ...]:
    """Find differences between a LiDAR's given mount and the road in its sweeps.

    Args:
        sweeps: x, y, z first [m], LiDAR frame with z about up.
        height_m: Given height; None: not given.
        tilt: Given tilt; None: not given.
    """
    doubts = []
    if tilt is not None:
        measured = lidar_pose(sweeps)
        up = (measured.tilt or _LEVEL).up
        apart_deg = math.degrees(math.acos(min(float(tilt.up @ up), 1.0)))
        if measured.height_m is not None and apart_deg > _TILTS_AGREE_DEG:
            doubts.append(
                MountDoubt(
                    problem=f"lidar_tilt_deg is {tilt}, but the road in the sweeps gives "
                    f"{measured.tilt or 'none'}",
                    remedy="correct it (degrees), or omit it",
                )
            )
    if height_m is not None and not doubts:
        measured_m = lidar_pose(sweeps, tilt).height_m
        if measured_m is not None and abs(measured_m - height_m) >= _HEIGHTS_AGREE_M:
            doubts.append(
                MountDoubt(
                    problem=f"lidar_height_m is {height_m:g}, but the road in the sweeps gives "
                    f"{measured_m:.2f}",
                    remedy="correct it, or omit it; keep it if clouds lack the road",
                )
            )
    return tuple(doubts)


def describe_odd_height(height_m: float) -> str:
    """Describe the causes of a height that few LiDARs have, in a clause; empty: plausible."""
    if height_m < _BELOW_ROAD_M:
        return "; no LiDAR is below the road: give lidar_height_m"
    if USUAL_HEIGHT_M < height_m < _FEET_AS_HIGH_M:
        return (
            "; few are so high: give points in metres if these are in feet, else lidar_height_m, "
            "as for a LiDAR on a mast"
        )
    if not _FEET_M[0] < height_m < _FEET_M[1]:
        return ""
    return (
        "; few are so low: give points in metres if these are in feet, else lidar_height_m, as for "
        "points in a vehicle's frame"
    )


def lidar_pose(
    sweeps: Iterable[Float[np.ndarray, "_num_points _fields"]], tilt: Tilt | None = None
) -> LidarPose:
    """Estimate a LiDAR's height and tilt by the median of the road planes in some sweeps.

    A road more than 5 m below counts only if no sweep shows one nearer.
    Tilts below 3 degrees count as none; with less than three sweeps, those below 4. On 90 frames of
    KITTI, whose LiDAR is level, single sweeps are off by up to 3.4 degrees.

    Args:
        sweeps: x, y, z first [m], LiDAR frame with z about up.
        tilt: Known tilt, if any.
    """
    clouds = [sweep[:, :3].astype(np.float64) for sweep in sweeps]
    pose = _pose_up_to(USUAL_HEIGHT_M, clouds, tilt)
    if pose.height_m is not None:
        return pose
    high = _pose_up_to(MAX_LIDAR_HEIGHT_M, clouds, tilt)
    return pose if high.height_m is None else high


def is_road_hidden(
    sweeps: Sequence[Float[np.ndarray, "_num_points _fields"]], pose: LidarPose
) -> bool:
    """Recognise sweeps of many points without a road by which `lidar_pose` would find the pose."""
    return pose.height_m is None and max(map(len, sweeps), default=0) >= _MANY_POINTS


def _pose_up_to(
    highest_m: float, clouds: Sequence[Float64[np.ndarray, "_num_points 3"]], tilt: Tilt | None
) -> LidarPose:
    if tilt is None:
        planes = [plane for xyz in clouds if (plane := road_plane(xyz, highest_m)) is not None]
        min_deg = _MIN_TILT_DEG if len(planes) >= _MANY_SWEEPS else _MIN_TILT_FEW_SWEEPS_DEG
        if planes:
            found = Tilt.from_up(np.median([plane.tilt.up for plane in planes], axis=0))
            tilt = found if found.angle_deg >= min_deg else None
    if tilt is not None:
        rotation = tilt.level_from_lidar[:3, :3]
        clouds = [xyz @ rotation.T for xyz in clouds]
    return LidarPose(height_m=drive_height_m(clouds, highest_m), tilt=tilt)


def road_plane(
    points: Float[np.ndarray, "num_points fields"], highest_m: float = USUAL_HEIGHT_M
) -> RoadPlane | None:
    """Fit the road in a sweep of a LiDAR that is tilted by up to 24 degrees in roll and in pitch.

    The fit of `road_height_m` starts twice: from a level LiDAR, and from the best tilt of a grid in
    steps of 3 degrees, where most cells' lowest points have one height. The second fit is used if
    its plane has a tenth more cells. Deterministic.

    Args:
        points: x, y, z first [m], LiDAR frame with z about up; rows that are not finite are
            ignored.
        highest_m: Greatest height of the LiDAR.

    Returns:
        The plane; None if hardly any road is visible.
    """
    xyz = points[:, :3].astype(np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    level = _plane_near(xyz, _LEVEL, fits=1, highest_m=highest_m)
    if level is not None and level.share >= _PLAIN_SHARE:
        return level
    coarse = _coarse_tilt(xyz, highest_m)
    tilted = None if coarse is None else _plane_near(xyz, coarse, fits=3, highest_m=highest_m)
    if tilted is None or level is None:
        return level or tilted
    return tilted if tilted.num_cells > _MORE_CELLS * level.num_cells else level


def upright_turn(
    points: Float[np.ndarray, "num_points fields"],
) -> Float64[np.ndarray, "3 3"] | None:
    """Find the axis rotation that makes z up in a cloud whose road lies in another direction.

    For clouds of other conventions: z down (x forward, y right), a camera's (x right, y down, z
    forward) and so on.

    Returns:
        The rotation; None if z is up, or there is no road in any direction.
    """
    plane = road_plane(points)
    if plane is not None and plane.share >= _DOUBTFUL_SHARE:
        return None
    below = (plane, road_plane(points, MAX_LIDAR_HEIGHT_M))
    max_cells = _CLEARLY_MORE * max(0.0 if each is None else each.num_cells for each in below)
    best = None
    xyz = points[:, :3].astype(np.float64)
    for rows in _UPRIGHT.values():
        turn = np.array(rows, dtype=np.float64)
        candidate = road_plane(xyz @ turn.T)
        if (
            candidate is not None
            and candidate.share >= _DOUBTFUL_SHARE
            and candidate.num_cells > max_cells
        ):
            best, max_cells = turn, candidate.num_cells
    return best


def road_height_m(
    points: Float[np.ndarray, "num_points fields"], highest_m: float = USUAL_HEIGHT_M
) -> float | None:
    """Estimate the height [m] of a level LiDAR above the road; None if hardly any is visible.

    The fit is a plane through the lowest points of cells of one metre, 4 to 30 m away, by
    iteratively reweighted least squares (Tukey's biweight), starting at the most frequent height.

    Args:
        points: x, y, z first [m], LiDAR frame with z up; rows that are not finite are ignored.
        highest_m: Greatest height.
    """
    fitted = _fit(points[:, :3].astype(np.float64), highest_m)
    return None if fitted is None else -float(fitted[0][2])


def drive_height_m(
    sweeps: Iterable[Float[np.ndarray, "_num_points _fields"]], highest_m: float = USUAL_HEIGHT_M
) -> float | None:
    """Median of the heights in some sweeps of a drive; None if no sweep shows the road."""
    heights_m = [
        height for sweep in sweeps if (height := road_height_m(sweep, highest_m)) is not None
    ]
    return float(np.median(heights_m)) if heights_m else None


def _plane_near(
    xyz: Float64[np.ndarray, "num_points 3"], tilt: Tilt, *, fits: int, highest_m: float
) -> RoadPlane | None:
    """Refine a plane by several fits, each in the frame levelled by the one before."""
    plane = None
    for _ in range(fits):
        rotation = tilt.level_from_lidar[:3, :3]
        fitted = _fit(xyz @ rotation.T, highest_m)
        if fitted is None:
            return None
        (slope_x, slope_y, z_0), num_cells, share = fitted
        tilt = Tilt.from_up(rotation.T @ np.array((-slope_x, -slope_y, 1.0)))
        plane = RoadPlane(height_m=-float(z_0), tilt=tilt, num_cells=num_cells, share=share)
    return plane


def _fit(
    xyz: Float64[np.ndarray, "num_points 3"], highest_m: float
) -> tuple[Float64[np.ndarray, "3"], float, float] | None:
    """Fit z = slope_x * x + slope_y * y + z_0 to the road; also return cells and their share."""
    lowest = _lowest_points(xyz, max_abs_z_m=2 * highest_m)
    if len(lowest) < _MIN_CELLS:
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
    share = num_cells / len(lowest)
    min_share = _DOUBTFUL_SHARE if highest_m > USUAL_HEIGHT_M else 0.0  # so far down lies any noise
    is_road = num_cells >= _MIN_CELLS / 2 and _LOWEST_M <= -float(plane[2]) <= highest_m
    return (plane, num_cells, share) if is_road and share >= min_share else None


def _coarse_tilt(xyz: Float64[np.ndarray, "num_points 3"], highest_m: float) -> Tilt | None:
    """Find the tilt of the search's grid with the most cells at one height."""
    reach_m = 2 * highest_m + _TO_M * float(np.tan(np.radians(_MAX_TILT_DEG)))
    lowest = _lowest_points(xyz, max_abs_z_m=reach_m)
    if len(lowest) < _MIN_CELLS:
        return None
    lowest = lowest[:: max(len(lowest) // _SEARCHED_CELLS, 1)]
    best, best_score = None, 0.0
    for tilt, up, preference in _searched_tilts():
        z = np.sort(lowest @ up)
        in_window = np.searchsorted(z, z + _COARSE_WINDOW_M, side="right") - np.arange(len(z))
        in_window[(-z < _LOWEST_M) | (-z > highest_m + _COARSE_WINDOW_M)] = 0
        score = float(in_window.max()) * preference
        if score > best_score:
            best, best_score = tilt, score
    return best


@cache
def _searched_tilts() -> tuple[tuple[Tilt, Float64[np.ndarray, "3"], float], ...]:
    """Make the search's grid: tilts, their vectors up and the preference for a level LiDAR."""
    angles_deg = np.arange(-_MAX_TILT_DEG, _MAX_TILT_DEG + 1, _STEP_DEG).tolist()
    tilts = [Tilt(roll_deg=roll, pitch_deg=pitch) for roll in angles_deg for pitch in angles_deg]
    return tuple((tilt, tilt.up, 1 - _LEVEL_PREFERENCE * tilt.angle_deg) for tilt in tilts)


def _lowest_points(
    xyz: Float64[np.ndarray, "num_points 3"], *, max_abs_z_m: float
) -> Float64[np.ndarray, "num_cells 3"]:
    away_m = np.hypot(xyz[:, 0], xyz[:, 1])
    is_near = np.abs(xyz[:, 2]) < max_abs_z_m  # no road is far above or below
    near = xyz[(away_m > _FROM_M) & (away_m < _TO_M) & is_near]
    cells = np.floor(near[:, :2] / _CELL_M)
    order = np.lexsort((near[:, 2], cells[:, 1], cells[:, 0]))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (cells[order][1:] != cells[order][:-1]).any(axis=1)
    lowest: Float64[np.ndarray, "num_cells 3"] = near[order][is_first]
    return lowest

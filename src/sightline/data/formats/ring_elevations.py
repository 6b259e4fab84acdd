"""Rings of a spinning LiDAR from the elevations of its points, in any order."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int64

MIN_RINGS: Final = 8
"""Smallest number of rings of a supported LiDAR."""
MAX_RINGS: Final = 135
"""Largest number of rings: 128 lasers, some of which begin twice, straight ahead."""

_BIN_DEG = 0.01
_BLUR_WIDTHS_DEG = (0.32, 0.16, 0.08, 0.04, 0.02, 0.01)  # the widest first, which joins close rings
_MAX_VALLEY_SHARE = 0.2  # largest density between two rings, as a share of the lower ring's
_MAX_SPACING_SHARE = 0.25  # share of the ring spacing beyond which a point is doubtful
_MAX_DOUBTFUL_SHARE = 0.02

_HEIGHTS_M = tuple(np.arange(-0.1, 0.31, 0.01))  # tried heights of the lasers above the origin
# The HDL-64E has two blocks of 32 lasers. KITTI's start 0.20 and 0.12 m above the origin, and the
# plane between the lowest of one and the highest of the other 0.165 m above it.
_UPPER_HEIGHTS_M = tuple(np.arange(0.165, 0.24, 0.005))
_LOWER_HEIGHTS_M = tuple(np.arange(0.085, 0.18, 0.005))
_BORDER_M, _BORDER_DEG = 0.165, -8.87
_MAX_SAMPLED_POINTS = 20_000  # points for the estimate of a height or a lean
_MAX_LEAN_DEG = 1.5
_LEAN_STEPS_DEG = (  # bins of elevations, and the steps that are tried, in turns about both axes
    (0.05, tuple(np.arange(-1.5, 1.55, 0.1))),
    (0.05, tuple(np.arange(-0.3, 0.35, 0.1))),
    (0.02, tuple(np.arange(-0.1, 0.11, 0.02))),
)


def rings_by_elevation(
    points: Float[np.ndarray, "num_points fields"],
    max_doubtful_share: float = _MAX_DOUBTFUL_SHARE,
    *,
    try_leaning: bool = True,
) -> Int64[np.ndarray, " num_points"]:
    """Number the rings of a sweep in any order from the top, by the elevations of its points.

    Elevations cluster at those of the lasers. This requires that the lasers start at the origin, at
    one common height above it, or in two blocks as in the HDL-64E, and that the z axis is the
    lasers' axis of rotation, or leans from it by up to 1.5 degrees, as in sweeps that were levelled
    after they were taken. Rings without a return have no number.

    Args:
        points: Points of the sweep, x, y, z first [m], LiDAR frame.
        max_doubtful_share: Share of the points that may lie between two rings.
        try_leaning: Whether to try leaning axes if an upright one separates no rings; takes
            a second.

    Raises:
        ValueError: Elevations do not separate into 8 to 135 rings.
    """
    best = _upright_rings(points)
    if try_leaning and best.doubtful_share > max_doubtful_share:
        upright = map(_upright, (points, points), _ELEVATIONS)
        found = (
            _separate_rings(elevation) for each in upright for elevation in _laser_elevations(each)
        )
        best = min((best, *found), key=_doubtful_share)
    if best.doubtful_share > max_doubtful_share:
        raise ValueError(
            "the points are not ordered ring by ring as in KITTI's files, and their elevations do "
            f"not separate into rings ({100 * best.doubtful_share:.0f} % of the points are between "
            "rings): give sweeps of one LiDAR in its own frame, tilted by at most "
            f"{_MAX_LEAN_DEG} degrees and not corrected for motion, or with a field ring (.pcd, "
            ".ply), or in the order of KITTI's files"
        )
    borders = (best.rings_deg[1:] + best.rings_deg[:-1]) / 2
    below = np.searchsorted(borders, best.elevation_deg)
    return np.asarray(len(borders) - below, dtype=np.int64)


def share_between_rings(points: Float[np.ndarray, "num_points fields"]) -> float:
    """Compute the share of a sweep's points between its rings, 0 to 1; 1 if it shows no rings.

    It is small only in the LiDAR's own frame, with its axis of rotation upright.
    """
    return _upright_rings(points).doubtful_share


_Elevations = Float64[np.ndarray, " num_points"]


class _RingSeparation(NamedTuple):
    """Elevations of points and of their rings, and the share of points between rings."""

    elevation_deg: Float64[np.ndarray, " num_points"]
    rings_deg: Float64[np.ndarray, " num_rings"]
    doubtful_share: float


def _doubtful_share(separation: _RingSeparation) -> float:
    return separation.doubtful_share


def _upright_rings(points: Float[np.ndarray, "num_points fields"]) -> _RingSeparation:
    """Separate rings around an upright axis, from the laser position that separates them best."""
    return min(map(_separate_rings, _laser_elevations(points)), key=_doubtful_share)


def _separate_rings(elevation_deg: Float64[np.ndarray, " num_points"]) -> _RingSeparation:
    """Separate rings with the widest blur that separates them well, else with the best one."""
    best = _RingSeparation(elevation_deg, np.zeros(0), 1.0)
    for blur_deg in _BLUR_WIDTHS_DEG:
        rings_deg = _cluster_centres_deg(elevation_deg, blur_deg)
        if not MIN_RINGS <= len(rings_deg) <= MAX_RINGS:
            continue
        doubtful_share = _share_between(elevation_deg, rings_deg)
        best = min(
            best, _RingSeparation(elevation_deg, rings_deg, doubtful_share), key=_doubtful_share
        )
        if doubtful_share <= _MAX_DOUBTFUL_SHARE:
            break
    return best


def elevations_deg(
    points: Float[np.ndarray, "num_points fields"], height_m: float = 0.0
) -> Float64[np.ndarray, " num_points"]:
    """Elevations of points [degrees] from a height above the LiDAR's origin."""
    x, y, z = points[:, :3].astype(np.float64).T
    elevations: Float64[np.ndarray, " num_points"] = np.degrees(
        np.arctan2(z - height_m, np.hypot(x, y))
    )
    return elevations


def _laser_elevations(
    points: Float[np.ndarray, "num_points fields"],
) -> Iterator[Float64[np.ndarray, " num_points"]]:
    """Yield elevations for possible laser positions: at the origin, above it, in two blocks."""
    yield elevations_deg(points)
    yield elevations_deg(points, _sharpest_m(points, _HEIGHTS_M))
    is_upper = elevations_deg(points, _BORDER_M) > _BORDER_DEG
    upper_m = _sharpest_m(points[is_upper], _UPPER_HEIGHTS_M)
    lower_m = _sharpest_m(points[~is_upper], _LOWER_HEIGHTS_M)
    yield np.where(is_upper, elevations_deg(points, upper_m), elevations_deg(points, lower_m))


def _in_two_blocks(points: Float[np.ndarray, "num_points fields"]) -> _Elevations:
    """Elevations of points from the middle height of each block of the HDL-64E."""
    is_upper = elevations_deg(points, _BORDER_M) > _BORDER_DEG
    upper, lower = (
        elevations_deg(points, heights_m[len(heights_m) // 2])
        for heights_m in (_UPPER_HEIGHTS_M, _LOWER_HEIGHTS_M)
    )
    return np.where(is_upper, upper, lower)


_ELEVATIONS: Final = (elevations_deg, _in_two_blocks)
"""Laser positions for which a lean is searched."""


def _sharpest_m(
    points: Float[np.ndarray, "num_points fields"], heights_m: Sequence[float]
) -> float:
    """Find the height from which the elevations of points cluster best."""
    sampled = _subsample(points)
    return max(heights_m, key=lambda height_m: _sharpness(elevations_deg(sampled, height_m)))


def _upright(
    points: Float[np.ndarray, "num_points fields"],
    elevations: Callable[[Float64[np.ndarray, "num_points 3"]], _Elevations],
) -> Float64[np.ndarray, "num_points 3"]:
    """Rotate points about y and x so that their elevations cluster best."""
    sampled = _subsample(points)[:, :3].astype(np.float64)
    lean_deg = np.zeros(2)
    for bin_deg, steps_deg in _LEAN_STEPS_DEG:
        for axis in (0, 1):
            tried = [lean_deg + step_deg * np.eye(2)[axis] for step_deg in steps_deg]
            lean_deg = max(
                tried,
                key=lambda each: _sharpness(elevations(sampled @ _tilt(each).T), bin_deg),
            )
    turned: Float64[np.ndarray, "num_points 3"] = points[:, :3] @ _tilt(lean_deg).T
    return turned


def _tilt(lean_deg: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "3 3"]:
    """Rotation about y and then about x."""
    (pitch, roll) = np.radians(lean_deg)
    about_y = [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    about_x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    return np.array(about_x) @ np.array(about_y)


def _subsample(
    points: Float[np.ndarray, "num_points fields"],
) -> Float[np.ndarray, "num_sampled fields"]:
    return points[np.random.default_rng(0).permutation(len(points))[:_MAX_SAMPLED_POINTS]]


def _sharpness(elevation_deg: _Elevations, bin_deg: float = _BIN_DEG) -> float:
    """Sum of the squares of a histogram: the larger, the better elevations cluster."""
    bins = np.floor(elevation_deg / bin_deg).astype(np.int64)
    counts = np.bincount(bins - bins.min(initial=0)).astype(np.float64)
    return float(np.square(counts).sum())


def _cluster_centres_deg(
    elevation_deg: Float64[np.ndarray, " num_points"], blur_deg: float
) -> Float64[np.ndarray, " num_rings"]:
    """Find elevations of clusters, ascending, separated by valleys of the density."""
    from scipy.ndimage import gaussian_filter1d  # takes a third of a second

    lowest = elevation_deg.min(initial=0.0) - 1
    bins = ((elevation_deg - lowest) / _BIN_DEG).astype(np.int64)
    density = gaussian_filter1d(
        np.bincount(bins, minlength=bins.max(initial=0) + 100).astype(np.float64),
        blur_deg / _BIN_DEG,
    )
    inner = density[1:-1]
    tops = np.flatnonzero((inner > density[:-2]) & (inner >= density[2:]) & (inner > 1e-9)) + 1
    kept: list[int] = []
    for top in tops:
        while kept:
            valley = density[kept[-1] : top].min()
            if valley <= _MAX_VALLEY_SHARE * min(density[kept[-1]], density[top]):
                kept.append(int(top))
                break
            if density[top] <= density[kept[-1]]:
                break  # a shoulder of the one before
            kept.pop()
        if not kept:
            kept.append(int(top))
    centres: Float64[np.ndarray, " num_rings"] = lowest + (np.array(kept) + 0.5) * _BIN_DEG
    return centres


def _share_between(
    elevation_deg: Float64[np.ndarray, " num_points"], rings_deg: Float64[np.ndarray, " num_rings"]
) -> float:
    """Share of points between two rings instead of on one of them."""
    first, last = 2 * rings_deg[0] - rings_deg[1], 2 * rings_deg[-1] - rings_deg[-2]
    rungs = np.array([first, *rings_deg, last])
    above = np.searchsorted(rungs, elevation_deg).clip(1, len(rungs) - 1)
    place = (elevation_deg - rungs[above - 1]) / (rungs[above] - rungs[above - 1])
    is_on_one = (np.abs(place) < _MAX_SPACING_SHARE) | (np.abs(place - 1) < _MAX_SPACING_SHARE)
    return float(1 - is_on_one.mean())

"""Rings of a spinning LiDAR, by the order of the points as in KITTI's files, or by elevation."""

import itertools

import numpy as np
from jaxtyping import Float, Float64, Int64
from scipy.ndimage import gaussian_filter1d

NUM_RINGS = 64
"""Lasers of KITTI's sensor (Velodyne HDL-64E), numbered from the top: 0 to 63."""

_SENSORS = (16, 32, 64, 128)  # lasers
_SPARE = 1.06  # a ring that begins twice, straight ahead, is counted twice
_FEWEST = 8  # fewer rings are a sweep in another order
_WIDEST_STEP_DEG = 0.7  # between two rings of 64; those of 32 lie 1.3 apart or so
_SEAM_DEG = 30.0  # inside a ring the azimuth never falls back so far
_TOP_DOWN_SLACK_DEG = 8.0  # a ring on a near object seems higher: lasers sit above the origin

_FEWEST_POINTS = 100  # below which no order can be told
_SCATTERED = 0.004  # of the spread of elevations: KITTI's neighbours differ by up to 0.0006
_BIN_DEG = 0.01
_BLURS_DEG = (0.32, 0.16, 0.08, 0.04, 0.02, 0.01)  # the widest first, which joins what is close
_VALLEY = 0.2  # of the density in the lower of two rings, at most, between them
_BETWEEN = 0.25  # of the way from one ring to the next, from where on a point is doubtful
_DOUBTFUL_SHARE = 0.02


def ring_numbers(
    points: Float[np.ndarray, "num_points fields"],
) -> Int64[np.ndarray, " num_points"]:
    """Numbers the rings of a sweep (x, y, z first [m], LiDAR frame) in KITTI's order, from the top.

    KITTI's files hold one ring after the other, the highest first, each from straight ahead
    counter-clockwise. A whole sweep therefore passes straight ahead once less than it has rings: 63
    times in KITTI. Of a sweep cut to what the camera sees a ring leaves two parts: ahead to the
    left edge, right edge to ahead. There the azimuth jumps back, from the left edge to the right
    one, and there the number goes up.

    So a cut sweep is numbered as the held-out-rings tables are, not by laser: a number holds one
    laser's returns right of straight ahead and the next laser's left of it. It starts at 0 (the
    top laser is in the camera's view of every KITTI frame), and a point's number is its laser's on
    the left and one more on the right, as long as the lasers above have returns near both edges.
    Where all lasers are in view the last one's right half has a number of its own. For numbers by
    laser, number the whole sweep first and cut then.

    Raises:
        ValueError: The points are not in KITTI's order.
    """
    is_whole = _is_whole(points)
    rings = _count_starts(points, is_whole=is_whole)
    num_rings = int(rings[-1]) + 1 if len(rings) else 0
    fewest, most = (_FEWEST, int(_SPARE * _SENSORS[-1])) if is_whole else (0, NUM_RINGS + 1)
    if not fewest <= num_rings <= most:
        raise ValueError(
            f"the azimuth of the sweep starts again {num_rings - 1} times, where KITTI's order has "
            f"{NUM_RINGS - 1} in a whole sweep and no more in a part of one: give the points in "
            "the order of KITTI's own files"
        )
    _check_top_down(_elevations_deg(points, rings))
    return rings


def count_beams(points: Float[np.ndarray, "num_points fields"]) -> int:
    """How many lasers the sensor of a sweep in KITTI's order has: 16, 32, 64 or 128.

    A whole sweep tells by its rings, of which some may have no return at all: those that look into
    the sky. Of a sweep cut to the camera's view the rings say nothing, and it is taken for
    KITTI's; `check_spacing` tells whether it can be.
    """
    if not _is_whole(points):
        return NUM_RINGS
    return sensor_of(int(_count_starts(points, is_whole=True)[-1]) + 1)


def comes_by_firing(points: Float[np.ndarray, "num_points fields"]) -> bool:
    """Tell sweeps whose points come in the order of the lasers' firing, or in none.

    Where rings come one after the other, neighbours are nearly of one elevation.
    """
    if len(points) < _FEWEST_POINTS:
        return False
    elevation = _elevation_deg(points)
    spread = float(np.subtract(*np.quantile(elevation, (0.9, 0.1))))
    return float(np.median(np.abs(np.diff(elevation)))) > _SCATTERED * spread


def rings_of_any_order(
    points: Float[np.ndarray, "num_points fields"],
) -> tuple[Int64[np.ndarray, " num_points"], bool]:
    """Number the rings of a sweep from the top; True beside them where its points lie ring by ring.

    Sweeps in KITTI's order are numbered as `ring_numbers` does, others by elevation.

    Raises:
        ValueError: Neither order nor elevation shows rings.
    """
    fault: ValueError | None = None
    if comes_by_firing(points):
        try:
            return rings_by_elevation(points), False
        except ValueError as error:
            fault = error
    try:
        rings = ring_numbers(points)
    except ValueError as error:
        if fault is not None:
            raise fault from error
        try:
            return rings_by_elevation(points), False
        except ValueError:
            raise error from None
    if fault is not None and int(rings[-1]) + 1 < _FEWEST:
        raise fault
    return rings, True


def rings_by_elevation(
    points: Float[np.ndarray, "num_points fields"],
) -> Int64[np.ndarray, " num_points"]:
    """Number the rings of a sweep in any order from the top, by the elevations of its points.

    Elevations crowd together where a laser looks. That needs lasers that start at one origin, or
    nearly so, and a frame whose z axis is the one they turn about. Rings without a return have no
    number.

    Raises:
        ValueError: Elevations do not part into 8 to 135 rings.
    """
    elevation = _elevation_deg(points)
    doubtful = 1.0
    for blur_deg in _BLURS_DEG:
        rings = _crowds(elevation, blur_deg)
        num_rings = len(rings)
        if not _FEWEST <= num_rings <= int(_SPARE * _SENSORS[-1]):
            continue
        doubtful = min(doubtful, _share_between(elevation, rings))
        if doubtful <= _DOUBTFUL_SHARE:
            borders = (rings[1:] + rings[:-1]) / 2
            return np.asarray(num_rings - 1 - np.searchsorted(borders, elevation), dtype=np.int64)
    raise ValueError(
        "the points are not in the order of KITTI's own files, ring by ring, and their elevations "
        f"do not part into rings either ({100 * doubtful:.0f} % of them lie between any): give "
        "sweeps in the frame of the LiDAR itself, neither tilted nor corrected for motion, or in "
        "the order of KITTI's files"
    )


def sensor_of(num_rings: int) -> int:
    """Beams of the sensor that shows so many rings in whole sweeps: 16, 32, 64 or 128."""
    return next((count for count in _SENSORS if num_rings <= _SPARE * count), _SENSORS[-1])


def _crowds(
    elevation_deg: Float64[np.ndarray, " num_points"], blur_deg: float
) -> Float64[np.ndarray, " num_rings"]:
    """Elevations about which points crowd, rising, parted by valleys of their density."""
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
            if valley <= _VALLEY * min(density[kept[-1]], density[top]):
                kept.append(int(top))
                break
            if density[top] <= density[kept[-1]]:
                break  # a shoulder of the one before
            kept.pop()
        if not kept:
            kept.append(int(top))
    crowds: Float64[np.ndarray, " num_rings"] = lowest + (np.array(kept) + 0.5) * _BIN_DEG
    return crowds


def _share_between(
    elevation_deg: Float64[np.ndarray, " num_points"], rings_deg: Float64[np.ndarray, " num_rings"]
) -> float:
    """Share of points that lie between two rings rather than on one of them."""
    first, last = 2 * rings_deg[0] - rings_deg[1], 2 * rings_deg[-1] - rings_deg[-2]
    rungs = np.array([first, *rings_deg, last])
    above = np.searchsorted(rungs, elevation_deg).clip(1, len(rungs) - 1)
    place = (elevation_deg - rungs[above - 1]) / (rungs[above] - rungs[above - 1])
    is_on_one = (np.abs(place) < _BETWEEN) | (np.abs(place - 1) < _BETWEEN)
    return float(1 - is_on_one.mean())


def _elevation_deg(
    points: Float[np.ndarray, "num_points fields"],
) -> Float64[np.ndarray, " num_points"]:
    x, y, z = points[:, :3].astype(np.float64).T
    elevation: Float64[np.ndarray, " num_points"] = np.degrees(np.arctan2(z, np.hypot(x, y)))
    return elevation


def check_spacing(
    points: Float[np.ndarray, "num_points fields"], rings: Int64[np.ndarray, " num_points"]
) -> None:
    """Refuses a part of a sweep whose rings lie too far apart for a sensor of 64 beams.

    Args:
        points: In KITTI's order; rings may have been left out.
        rings: Their numbers.

    Raises:
        ValueError: They are those of another sensor.
    """
    numbers = np.unique(rings)
    elevations = _elevations_deg(points, rings)
    steps = (elevations[:-1] - elevations[1:]) / np.diff(numbers)
    if len(steps) and np.median(steps) > _WIDEST_STEP_DEG:
        raise ValueError(
            f"the rings of the sweep lie {np.median(steps):.1f} degrees apart, too far for the 64 "
            "beams that a sweep cut to the image is taken to have: give the whole sweeps, whose "
            "beams are counted"
        )


def _is_whole(points: Float[np.ndarray, "num_points fields"]) -> bool:
    return bool((points[:, 0] < 0).any())


def _count_starts(
    points: Float[np.ndarray, "num_points fields"], *, is_whole: bool
) -> Int64[np.ndarray, " num_points"]:
    """For each point how often the azimuth has started again."""
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0], dtype=np.float64))
    from_ahead = azimuth % 360 if is_whole else azimuth
    starts = np.diff(from_ahead, prepend=from_ahead[:1]) < (-180 if is_whole else -_SEAM_DEG)
    return np.cumsum(starts, dtype=np.int64)


def _elevations_deg(
    points: Float[np.ndarray, "num_points fields"], rings: Int64[np.ndarray, " num_points"]
) -> Float64[np.ndarray, " num_rings"]:
    """The median of each ring that has points."""
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    ends = np.searchsorted(rings, [*np.unique(rings), np.iinfo(np.int64).max])
    medians = [np.median(elevation[start:end]) for start, end in itertools.pairwise(ends)]
    return np.array(medians, dtype=np.float64)


def _check_top_down(elevations_deg: Float64[np.ndarray, " num_rings"]) -> None:
    above = np.minimum.accumulate(elevations_deg)[:-1]
    rise = elevations_deg[1:] - above
    if len(rise) and rise.max() > _TOP_DOWN_SLACK_DEG:
        first = int(np.argmax(rise > _TOP_DOWN_SLACK_DEG))
        raise ValueError(
            f"ring {first + 1} of the sweep lies {rise[first]:.1f} degrees above an earlier one, "
            "but KITTI's order has the highest ring first: give the points in the order of "
            "KITTI's own files"
        )

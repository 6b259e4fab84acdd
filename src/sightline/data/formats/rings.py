"""Rings of a spinning LiDAR, from KITTI's order of the points or from elevations."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64, Shaped

from sightline.data.formats.ring_elevations import (
    MAX_RINGS,
    MIN_RINGS,
    elevations_deg,
    rings_by_elevation,
)
from sightline.geometry.echoes import is_echo
from sightline.geometry.intensity_checks import holds_rings

NUM_RINGS = 64
"""Lasers of KITTI's sensor (Velodyne HDL-64E), numbered from the top: 0 to 63."""

_SENSOR_BEAMS = (16, 32, 64, 128)  # lasers
_MAX_RINGS_PER_BEAM = 1.06  # a ring that begins twice, straight ahead, is counted twice
_MAX_STEP_DEG = 0.7  # largest spacing of 64 rings; that of 32 rings is about 1.3
_SEAM_DEG = 30.0  # inside a ring the azimuth never decreases by so much
_TOP_DOWN_SLACK_DEG = 8.0  # a ring on a near object seems higher: lasers sit above the origin

_MIN_POINTS = 100  # with fewer points the order is unknown
_MAX_NEIGHBOUR_SHARE = 0.004  # of the spread of elevations; KITTI's neighbours: up to 0.0006
_MAX_RING_SPREAD_DEG = 3.0  # of a single ring; its laser may sit above the origin
_MIN_EXPLAINED_SHARE = 0.5  # of the elevations' variance, explained by ring numbers
_MAX_START_DEG = 5.0  # largest usual start azimuth of whole sweeps in KITTI's order
_MIN_FALL_DEG, _MAX_FALLS = 0.1, 3  # of the elevation from ring to ring, and azimuths tried
_MAX_STUB_POINTS = 3  # at a seam, where azimuths alternate
_MIN_STEP_RATIO = 0.25  # share of the best order's step between rings that others must reach
_MIN_RING_RATIO = 0.9  # share of its number of rings, likewise
_SECTOR_DEG, _MIN_TURN_SHARE = 10.0, 0.9  # of a whole turn, in which points must lie
_MIN_CORRELATION = 0.9  # correlation of ordered numbers with elevations


def ring_numbers(
    points: Float[np.ndarray, "num_points fields"],
) -> Int64[np.ndarray, " num_points"]:
    """Number the rings of a sweep (x, y, z first [m], LiDAR frame) in KITTI's order, from the top.

    KITTI's files contain one ring after the other, the highest first, each counter-clockwise from
    straight ahead. So the azimuth of a whole sweep passes straight ahead one time less than it has
    rings: 63 times in KITTI. In a sweep cropped to the camera's view, a ring has two parts: ahead
    to the left edge, right edge to ahead. The azimuth jumps back from the left edge to the right
    one, and the number increases there.

    So a cropped sweep is numbered as in the held-out-rings tables, not by laser: a number contains
    one laser's returns right of straight ahead and the next laser's left of it. Numbers start at 0
    (the top laser is in the camera's view of every KITTI frame). A point's number is its laser's on
    the left and one more on the right, if the lasers above have returns near both edges. If all
    lasers are in view, the last one's right half has its own number. For numbers by laser, number
    the whole sweep first and crop it afterwards.

    Raises:
        ValueError: The points are not in KITTI's order.
    """
    is_whole = is_whole_turn(points)
    rings = _count_starts(points, is_whole=is_whole)
    num_rings = int(rings[-1]) + 1 if len(rings) else 0
    min_rings, max_rings = (MIN_RINGS, MAX_RINGS) if is_whole else (0, NUM_RINGS + 1)
    if not min_rings <= num_rings <= max_rings:
        raise ValueError(
            f"the azimuth of the sweep restarts {num_rings - 1} times, expected "
            f"{max(min_rings - 1, 0)} to {max_rings - 1} times, as in KITTI's order: give the "
            "points of one turn of one LiDAR, in the order of KITTI's files"
        )
    if len(points) >= _MIN_POINTS and np.median(np.diff(_azimuth_deg(points))) < 0:
        raise ValueError(
            "the azimuth falls from point to point, expected it to rise inside each ring, as in "
            "KITTI's order: the points are clockwise, or those of a depth map, row by row, which "
            "has no rings; give sweeps in the order of KITTI's files"
        )
    if num_rings == 1 and len(points) >= _MIN_POINTS and _spread_deg(points) > _MAX_RING_SPREAD_DEG:
        raise ValueError(
            f"the azimuth never restarts, but elevations spread over {_spread_deg(points):.0f} "
            "degrees, as in zigzag scans: give sweeps in the order of KITTI's files"
        )
    _check_top_down(_medians_deg(points, rings))
    return rings


def count_rings(points: Float[np.ndarray, "num_points fields"]) -> int:
    """Number of rings with returns of a whole sweep in KITTI's order.

    A sweep cropped to the camera's view is assumed to be KITTI's, of 64; `check_spacing` checks
    this.
    """
    return int(_count_starts(points, is_whole=True)[-1]) + 1 if is_whole_turn(points) else NUM_RINGS


def is_firing_order(points: Float[np.ndarray, "num_points fields"]) -> bool:
    """Whether the points of a sweep are in firing order or unordered, not ring by ring.

    In a sweep ordered by ring, neighbouring points have almost the same elevation.
    """
    if len(points) < _MIN_POINTS:
        return False
    step_deg = float(np.median(np.abs(np.diff(elevations_deg(points)))))
    return step_deg > _MAX_NEIGHBOUR_SHARE * _spread_deg(points)


def _spread_deg(points: Float[np.ndarray, "num_points fields"]) -> float:
    """Spread of most elevations [degrees]."""
    return float(np.subtract(*np.quantile(elevations_deg(points), (0.9, 0.1))))


def rings_of_any_order(
    points: Float[np.ndarray, "num_points fields"],
) -> tuple[Int64[np.ndarray, " num_points"], bool]:
    """Number the rings of a sweep from the top; also returns whether points are ordered by ring.

    Sweeps in KITTI's order are numbered by `ring_numbers`. Other sweeps ordered by ring, with
    another start or clockwise, are also numbered by their order, all others by elevation.

    Raises:
        ValueError: Rings are found neither by order nor by elevation.
    """
    try:
        if is_firing_order(points):
            return rings_by_elevation(points), False
    except ValueError as error:
        rings, is_kitti_order = _rings_by_order(points)
        if rings is None or int(rings[-1]) + 1 < MIN_RINGS:
            raise error from None
        return rings, is_kitti_order
    rings, is_kitti_order = _rings_by_order(points)
    if rings is not None:
        return rings, is_kitti_order
    try:
        return rings_by_elevation(points), False
    except ValueError:
        return ring_numbers(points), True  # raises the error about their order


def _rings_by_order(
    points: Float[np.ndarray, "num_points fields"],
) -> tuple[Int64[np.ndarray, " num_points"] | None, bool]:
    """Rings of a sweep ordered by ring, else None; also whether it is in KITTI's order."""
    kitti_rings = _ring_numbers_or_none(points)
    if kitti_rings is not None and _starts_in_kitti_order(points, kitti_rings):
        return kitti_rings, True
    candidates = [] if kitti_rings is None else [(kitti_rings, kitti_rings)]
    for turned in _other_orders(points):
        rings = _ring_numbers_or_none(turned)
        if rings is not None:
            candidates.append((rings, _without_stubs(rings)))
    found = [
        (_step_down_deg(points, rings), plain)
        for rings, plain in candidates
        if int(rings[-1]) + 1 >= MIN_RINGS
    ]
    if not found:
        return kitti_rings, True
    best = _fewest_rings(found)
    return best, best is kitti_rings


def _fewest_rings(
    found: Sequence[tuple[float, Int64[np.ndarray, " num_points"]]],
) -> Int64[np.ndarray, " num_points"]:
    """Choose the numbering with the fewest rings, as seams inside rings cut some in two.

    Args:
        found: Median decrease of elevation between rings [degrees] and numbers of each candidate.
            If all decreases are noise, the largest decides between equal numbers of rings, else
            the order of the candidates.
    """
    best_step_deg, clearest = max(found, key=lambda each: each[0])
    if best_step_deg <= _MIN_FALL_DEG:
        return min(found, key=lambda each: (int(each[1][-1]), -each[0]))[1]
    sound = [
        rings
        for step_deg, rings in found
        if step_deg >= _MIN_STEP_RATIO * best_step_deg
        and int(rings[-1]) >= _MIN_RING_RATIO * int(clearest[-1])
    ]
    return min(sound, key=lambda rings: int(rings[-1]))


def _starts_in_kitti_order(
    points: Float[np.ndarray, "num_points fields"], rings: Int64[np.ndarray, " num_points"]
) -> bool:
    if len(points) < _MIN_POINTS:
        return True
    if is_whole_turn(points):
        return bool(_azimuth_from_front_deg(points)[0] < _MAX_START_DEG)
    return int(rings[-1]) + 1 >= MIN_RINGS


def _other_orders(
    points: Float[np.ndarray, "num_points fields"],
) -> Iterator[Float[np.ndarray, "num_points fields"]]:
    """Yield rotated and mirrored sweeps, which convert other orders by ring to KITTI's."""
    seams_deg = [0.0]
    if is_whole_turn(points):
        start_deg = float(_azimuth_deg(points)[0])
        seams_deg += [90.0, 180.0, 270.0, start_deg, *_usual_falls_deg(points)]
    for mirror in (1, -1):
        for seam_deg in seams_deg:
            turn = np.radians(-seam_deg)
            x, y = points[:, 0], points[:, 1]
            turned = points.astype(np.float64)
            turned[:, 0] = np.cos(turn) * x - np.sin(turn) * y
            turned[:, 1] = mirror * (np.sin(turn) * x + np.cos(turn) * y)
            yield turned


def _usual_falls_deg(points: Float[np.ndarray, "num_points fields"]) -> Iterator[float]:
    """Yield azimuths at which the elevation falls most often from point to point.

    It falls from ring to ring, though rings start some degrees later where their first points have
    no return; and at edges of near objects, as lasers are beside the origin.
    """
    azimuth_deg = _azimuth_deg(points)
    step_deg = (np.diff(azimuth_deg) + 180) % 360 - 180
    is_fall = -np.diff(elevations_deg(points)) > _MIN_FALL_DEG
    middles_deg = (azimuth_deg[:-1] + step_deg / 2)[is_fall] % 360
    for _ in range(_MAX_FALLS):
        if not len(middles_deg):
            return
        counts, _ = np.histogram(middles_deg, 360, (0.0, 360.0))
        peak_deg = 1.0 + int((counts + np.roll(counts, -1)).argmax())  # between two bins
        from_peak_deg = (middles_deg - peak_deg + 180) % 360 - 180
        is_near = np.abs(from_peak_deg) <= 1.0
        yield peak_deg + float(np.median(from_peak_deg[is_near]))
        middles_deg = middles_deg[~is_near]


def _ring_numbers_or_none(
    points: Float[np.ndarray, "num_points fields"],
) -> Int64[np.ndarray, " num_points"] | None:
    try:
        return ring_numbers(points)
    except ValueError:  # in another order
        return None


def _without_stubs(rings: Int64[np.ndarray, " num_points"]) -> Int64[np.ndarray, " num_points"]:
    """Renumber rings so that the few points before a seam have no own number."""
    counts = np.bincount(rings)
    numbers: Int64[np.ndarray, " num_rings"] = np.cumsum(counts > _MAX_STUB_POINTS) - 1
    return np.asarray(numbers.clip(min=0)[rings], dtype=np.int64)


def _step_down_deg(
    points: Float[np.ndarray, "num_points fields"], rings: Int64[np.ndarray, " num_points"]
) -> float:
    """Median decrease of elevation from the end of a ring to the start of the next."""
    is_step = np.diff(rings) > 0
    return float(np.median(-np.diff(elevations_deg(points))[is_step])) if is_step.any() else 0.0


def in_kitti_order(
    points: Float32[np.ndarray, "num_points 4"], rings: Shaped[np.ndarray, " num_points"]
) -> Float32[np.ndarray, "num_points 4"]:
    """Sort a sweep by its driver's ring numbers into KITTI's order.

    The highest ring comes first, each counter-clockwise from straight ahead. Numbers that are not
    related to elevation are no rings; then nothing changes.

    Args:
        points: Points of the sweep, finite or not.
        rings: Number of each point's laser, from the top or from the bottom or in any order.
    """
    if not holds_rings(rings, points, min_share=_MIN_EXPLAINED_SHARE):
        return points
    has_echo = is_echo(points)
    echo_points = points[has_echo]
    numbers, indices = np.unique(rings[has_echo], return_inverse=True)
    elevation = elevations_deg(echo_points)
    heights_deg = np.array([np.median(elevation[indices == n]) for n in range(len(numbers))])
    # Near points of an HDL-64E may swap the medians of neighbours; numbers in order do not.
    with np.errstate(invalid="ignore", divide="ignore"):  # NaN for equal heights
        trend = float(np.corrcoef(numbers.astype(np.float64), heights_deg)[0, 1])
    from_top = -trend * indices if abs(trend) > _MIN_CORRELATION else -heights_deg[indices]
    order = np.lexsort((_azimuth_from_front_deg(echo_points), from_top))
    return np.concatenate((echo_points[order], points[~has_echo]))


def cut_in_kitti_order(
    points: Float32[np.ndarray, "num_points 4"], lasers: Int64[np.ndarray, " num_points"]
) -> tuple[Int64[np.ndarray, " num_points"], Int64[np.ndarray, " num_points"]]:
    """Sort a sweep cropped to the camera's view into KITTI's order, and number its rings as there.

    Rings keep their lasers' numbers where that order shows none, as in a narrow view.

    Args:
        points: Points in view, in any order.
        lasers: Number of each point's laser, from the top.

    Returns:
        Index of each point in `points`, and its number by `ring_numbers`.
    """
    order = np.lexsort((_azimuth_from_front_deg(points), lasers))
    rings = _ring_numbers_or_none(points[order])
    return order, lasers[order] if rings is None else rings


def turned_in_order(
    points: Float32[np.ndarray, "num_points 4"], turned: Float32[np.ndarray, "num_points 4"]
) -> Float32[np.ndarray, "num_points 4"]:
    """Sort a sweep rotated about z into KITTI's order, if it was in this order before.

    Args:
        points: Points before the rotation.
        turned: The same points after it.
    """
    if is_firing_order(points) or not len(points) or not is_whole_turn(points):
        return turned
    rings = _ring_numbers_or_none(points)
    if rings is None:
        return turned
    return turned[np.lexsort((_azimuth_from_front_deg(turned), rings))]


def beams_of_sensor(num_rings: int) -> int:
    """Number of beams of a sensor by its rings in whole sweeps: 16, 32, 64 or 128.

    Rings into the sky may have no return, so other numbers are rounded up.
    """
    return next(
        (count for count in _SENSOR_BEAMS if num_rings <= _MAX_RINGS_PER_BEAM * count),
        _SENSOR_BEAMS[-1],
    )


def check_spacing(
    points: Float[np.ndarray, "num_points fields"], rings: Int64[np.ndarray, " num_points"]
) -> None:
    """Refuse a part of a sweep whose ring spacing is too large for a sensor of 64 beams.

    Args:
        points: Points in KITTI's order; rings may be left out.
        rings: Ring numbers of the points.

    Raises:
        ValueError: The rings are those of another sensor.
    """
    numbers = np.unique(rings)
    elevations = _medians_deg(points, rings)
    steps = (elevations[:-1] - elevations[1:]) / np.diff(numbers)
    if len(steps) and np.median(steps) > _MAX_STEP_DEG:
        raise ValueError(
            f"the rings of the sweep lie {np.median(steps):.1f} degrees apart, too far for the 64 "
            "beams that are assumed for a sweep cropped to the image: give whole sweeps, whose "
            "beams are counted"
        )


def is_whole_turn(points: Float[np.ndarray, "num_points fields"]) -> bool:
    """Whether a sweep has points behind the LiDAR, so that it is not cropped to the image."""
    return bool((points[:, 0] < 0).any())


def covers_turn(points: Float[np.ndarray, "num_points fields"]) -> bool:
    """Test a sweep for a whole turn: points in 9 of 10 sectors of 10 degrees."""
    sectors = np.unique(np.floor(_azimuth_deg(points) % 360 / _SECTOR_DEG).astype(np.int64))
    return len(sectors) >= _MIN_TURN_SHARE * 360 / _SECTOR_DEG


def _count_starts(
    points: Float[np.ndarray, "num_points fields"], *, is_whole: bool
) -> Int64[np.ndarray, " num_points"]:
    """Number of restarts of the azimuth before each point."""
    azimuth_deg = _azimuth_from_front_deg(points) if is_whole else _azimuth_deg(points)
    starts = np.diff(azimuth_deg, prepend=azimuth_deg[:1]) < (-180 if is_whole else -_SEAM_DEG)
    return np.cumsum(starts, dtype=np.int64)


def _azimuth_from_front_deg(
    points: Float[np.ndarray, "num_points fields"],
) -> Float64[np.ndarray, " num_points"]:
    """Azimuths [deg] from 0, straight ahead, counter-clockwise to 360."""
    return _azimuth_deg(points) % 360


def _azimuth_deg(
    points: Float[np.ndarray, "num_points fields"],
) -> Float64[np.ndarray, " num_points"]:
    azimuth: Float64[np.ndarray, " num_points"] = np.degrees(
        np.arctan2(points[:, 1], points[:, 0], dtype=np.float64)
    )
    return azimuth


def _medians_deg(
    points: Float[np.ndarray, "num_points fields"], rings: Int64[np.ndarray, " num_points"]
) -> Float64[np.ndarray, " num_rings"]:
    """Median elevation [deg] of each ring with points."""
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    ends = np.searchsorted(rings, [*np.unique(rings), np.iinfo(np.int64).max])
    medians = [np.median(elevation[start:end]) for start, end in itertools.pairwise(ends)]
    return np.array(medians, dtype=np.float64)


def _check_top_down(medians_deg: Float64[np.ndarray, " num_rings"]) -> None:
    above = np.minimum.accumulate(medians_deg)[:-1]
    rise = medians_deg[1:] - above
    if len(rise) and rise.max() > _TOP_DOWN_SLACK_DEG:
        first = int(np.argmax(rise > _TOP_DOWN_SLACK_DEG))
        from_top_deg = abs(medians_deg[first + 1] - medians_deg[0])
        is_restart = first + 1 >= MIN_RINGS and from_top_deg <= _TOP_DOWN_SLACK_DEG
        several = (
            "; or if the points are of several LiDARs, give those of one" if is_restart else ""
        )
        raise ValueError(
            f"ring {first + 1} of the sweep lies {rise[first]:.1f} degrees above an earlier one, "
            "but KITTI's order has the highest ring first: give the points in the order of "
            f"KITTI's files{several}"
        )

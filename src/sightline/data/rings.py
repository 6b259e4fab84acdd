"""Rings of a spinning LiDAR, read from the order of the points in KITTI's files."""

import itertools

import numpy as np
from jaxtyping import Float, Int64

NUM_RINGS = 64
"""Lasers of KITTI's sensor (Velodyne HDL-64E), numbered from the top: 0 to 63."""

_SEAM_DEG = 30.0  # inside a ring the azimuth never falls back so far
_TOP_DOWN_SLACK_DEG = 8.0  # a ring on a near object seems higher: lasers sit above the origin


def ring_numbers(
    points: Float[np.ndarray, "num_points fields"],
) -> Int64[np.ndarray, " num_points"]:
    """Numbers the rings of a sweep (x, y, z first [m], LiDAR frame) in KITTI's order, from the top.

    KITTI's files hold one ring after the other, the highest first, each from straight ahead
    counter-clockwise. A whole sweep therefore passes straight ahead 63 times. Of a sweep cut to
    what the camera sees a ring leaves two parts: ahead to the left edge, right edge to ahead. There
    the azimuth jumps back, from the left edge to the right one, and there the number goes up.

    So a cut sweep is numbered as the held-out-rings tables are, not by laser: a number holds one
    laser's returns right of straight ahead and the next laser's left of it. It starts at 0 (the
    top laser is in the camera's view of every KITTI frame), and a point's number is its laser's on
    the left and one more on the right, as long as the lasers above have returns near both edges.
    For numbers by laser, number the whole sweep first and cut then.

    Raises:
        ValueError: The points are not in KITTI's order.
    """
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0], dtype=np.float64))
    is_whole = bool((points[:, 0] < 0).any())
    from_ahead = azimuth % 360 if is_whole else azimuth
    starts = np.diff(from_ahead, prepend=from_ahead[:1]) < (-180 if is_whole else -_SEAM_DEG)
    rings = np.cumsum(starts, dtype=np.int64)
    num_rings = int(rings[-1]) + 1 if len(rings) else 0
    if num_rings > NUM_RINGS or (is_whole and num_rings < NUM_RINGS):
        raise ValueError(
            f"the azimuth of the sweep starts again {num_rings - 1} times, where KITTI's order has "
            f"{NUM_RINGS - 1} in a whole sweep and no more in a part of one: give the points in "
            "the order of KITTI's own files"
        )
    _check_top_down(points, rings, num_rings)
    return rings


def _check_top_down(
    points: Float[np.ndarray, "num_points fields"],
    rings: Int64[np.ndarray, " num_points"],
    num_rings: int,
) -> None:
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    ends = np.searchsorted(rings, np.arange(num_rings + 1))
    medians = [np.median(elevation[start:end]) for start, end in itertools.pairwise(ends)]
    lowest = itertools.accumulate(medians, min)
    for ring, (above, below) in enumerate(zip(lowest, medians[1:], strict=False), start=1):
        if below > above + _TOP_DOWN_SLACK_DEG:
            raise ValueError(
                f"ring {ring} of the sweep lies {below - above:.1f} degrees above an earlier one, "
                "but KITTI's order has the highest ring first: give the points in the order of "
                "KITTI's own files"
            )

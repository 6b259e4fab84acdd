"""Measurements that the LiDAR sees past an edge, which hides them from the camera."""

import numpy as np

from kitti_frame import Array, Steps
from morphology import largest_around, windows


def hidden_in_window(
    inverse: Array, rows: Array, columns: Array, step: int, between: int, rule: Steps
) -> Array:
    """Find measurements with nearer ones both above and below in a window of fixed size."""
    beside = largest_around(inverse, 0, round(rule["hidden_columns"] * step))
    reach = max(round(rule["hidden_rows"] * step), between)
    padded = np.pad(beside, ((reach, reach), (0, 0)))
    around = windows(padded, reach + 1, axis=0).max(axis=-1)[:, columns]
    limit = (rule["hidden_ratio"] * inverse[rows, columns].astype(np.float64)).astype(np.float32)
    places = np.arange(len(rows))
    return np.asarray((around[rows, places] > limit) & (around[rows + reach, places] > limit))


def hidden_by_contrast(
    inverse: Array, rows: Array, columns: Array, step: int, between: int, rule: Steps
) -> Array:
    """Find them within reaches that grow with the difference of inverse depths."""
    units = {"above": between, "below": between, "beside": step}
    reaches = {
        way: (rule["contrast"][way][0] * unit, rule["contrast"][way][1] * step)
        for way, unit in units.items()
    }
    search = rule["search_columns"] * step
    around = largest_around(inverse, max(search, between), search)[rows, columns]
    own = inverse[rows, columns]
    limit = (rule["hidden_ratio"] * own.astype(np.float64)).astype(np.float32)
    open_ = np.flatnonzero(around > limit)
    rows, columns, own, limit = rows[open_], columns[open_], own[open_], limit[open_]
    most = around[open_] - own
    up, down, side = (
        (base + growth * most.astype(np.float64)).astype(int)
        for base, growth in (reaches[way] for way in ("above", "below", "beside"))
    )
    margin = [int(each.max(initial=0)) for each in (up, down, side)]
    padded = np.pad(inverse, ((margin[0], margin[1]), (margin[2], margin[2])))
    above, below = np.zeros(len(rows), bool), np.zeros(len(rows), bool)
    for down_by in range(-margin[0], margin[1] + 1):
        in_rows = np.flatnonzero((-down_by <= up) & (down_by <= down))
        for right_by in range(-int(side[in_rows].max(initial=0)), margin[2] + 1):
            at = in_rows[abs(right_by) <= side[in_rows]]
            value = padded[rows[at] + margin[0] + down_by, columns[at] + margin[2] + right_by]
            nearer = value - own[at]
            is_near = (value > limit[at]) & (abs(right_by) <= reach_of(reaches["beside"], nearer))
            if down_by <= 0:
                above[at] |= is_near & (-down_by <= reach_of(reaches["above"], nearer))
            if down_by >= 0:
                below[at] |= is_near & (down_by <= reach_of(reaches["below"], nearer))
    hidden = np.zeros(len(around), bool)
    hidden[open_] = above & below
    return hidden


def reach_of(reach: tuple[float, float], nearer: Array) -> Array:
    """Compute how far away a measurement may hide one, by how much nearer it is [1/m]."""
    return np.asarray(reach[0] + reach[1] * nearer.astype(np.float64))

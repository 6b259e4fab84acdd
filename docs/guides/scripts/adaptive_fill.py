"""Completion of a sparse depth map between the rings of a sweep: the filled_depth_m of networks."""

import numpy as np

from depth_maps import bridge_rows, fill_columns, smooth_rows
from kitti_frame import Array, Steps

windows = np.lib.stride_tricks.sliding_window_view


def fill(sparse_m: Array, rule: Steps) -> tuple[Array, Array]:
    """Complete a map that measures something; give depth [m] and where it can be trusted."""
    inverse = inverted(sparse_m)  # planes are linear in it
    rows, columns = np.nonzero(inverse)
    widest = rule["widest_spacing_px"]
    gaps = right_neighbours(inverse, rows, columns, widest, widest, rule)[0]
    step = int(np.median(gaps[gaps > 0])) if gaps.any() else 1  # columns along a ring
    tops = largest_beside(inverse, step // 2) > 0
    tops[1:] &= ~tops[:-1].copy()
    column, row = np.nonzero(tops.T)
    counts = np.bincount(np.diff(row)[np.diff(column) == 0], minlength=2).cumsum()
    between = int(np.searchsorted(counts, counts[-1] / 2)) if counts[-1] else step  # of two rings
    # Measurements with nearer ones both above and below belong to what the edge in front hides.
    beside = largest_beside(inverse, round(rule["hidden_columns"] * step))
    reach = max(round(rule["hidden_rows"] * step), between)
    padded = np.pad(beside, ((reach, reach), (0, 0)))
    around = windows(padded, reach + 1, axis=0).max(axis=-1)[:, columns]
    limit = np.float32(rule["surface_ratio"] * inverse[rows, columns].astype(np.float64))
    places = np.arange(len(rows))
    hidden = (around[rows, places] > limit) & (around[rows + reach, places] > limit)
    inverse[rows[hidden], columns[hidden]] = 0
    rows, columns = rows[~hidden], columns[~hidden]
    reaches = round(rule["link_columns"] * step), max(between // 2, 1)
    steps = right_neighbours(inverse, rows, columns, *reaches, rule)
    traced = trace_rings(inverse, rows, columns, *steps, rule["surface_ratio"])
    filled, distance, trusted = fill_columns(traced, between, rule)
    has_ring = np.flatnonzero(filled[0] > 0)
    to_columns = np.abs(has_ring - np.arange(filled.shape[1])[:, None])
    nearest = has_ring[to_columns.argmin(axis=1)]  # the left one at a tie
    to_ring = np.where(filled > 0, distance, np.inf)
    filled, distance = filled[:, nearest], distance[:, nearest]
    least = between + rule["hole_columns"] * step
    depth_m = inverted(bridge_rows(filled, to_ring, trusted, least, rule["widest_hole"]))
    for _ in range(rule["smoothing_passes"]):
        depth_m = smooth_rows(depth_m, (rule["smoothing"] * distance.astype(float)).astype(int))
    depth_m[rows, columns] = sparse_m[rows, columns]
    return depth_m, trusted


def inverted(values: Array) -> Array:
    """Take 1 / value where there is one."""
    return np.where(values > 0, 1 / np.where(values > 0, values, np.float32(1)), np.float32(0))


def largest_beside(inverse: Array, reach: int) -> Array:
    """Find the largest value of the columns around each pixel."""
    return windows(np.pad(inverse, ((0, 0), (reach, reach))), 2 * reach + 1, axis=1).max(axis=-1)


def right_neighbours(
    inverse: Array, rows: Array, columns: Array, reach_columns: int, reach_rows: int, rule: Steps
) -> tuple[Array, Array]:
    """Find columns and rows to the next measurement of the ring on the right; 0 columns: none."""
    padded = np.pad(inverse, ((reach_rows, reach_rows), (0, reach_columns))) > 0
    gaps, offsets = np.zeros_like(rows), np.zeros_like(rows)
    for gap in range(1, reach_columns + 1):
        span = min(1 + int(rule["ring_slope"] * gap), reach_rows)
        for offset in sorted(range(-span, span + 1), key=abs):  # the upper one at a tie
            is_open = np.flatnonzero(gaps == 0)
            at = padded[rows[is_open] + reach_rows + offset, columns[is_open] + gap]
            gaps[is_open[at]], offsets[is_open[at]] = gap, offset
    return gaps, offsets


def trace_rings(
    inverse: Array, rows: Array, columns: Array, gaps: Array, offsets: Array, ratio: float
) -> Array:
    """Draw the line from each measurement to its neighbour; of lines that cross the nearer wins."""
    traced = inverse.copy()
    for step in range(1, gaps.max(initial=0)):
        far = gaps > step
        row, column, gap, offset = rows[far], columns[far], gaps[far], offsets[far]
        share = np.float32(step) / gap.astype(np.float32)
        left, right = inverse[row, column], inverse[row + offset, column + gap]
        low, high = np.minimum(left, right).astype(np.float64), np.maximum(left, right)
        halves = np.where(share < 0.5, left, right)
        value = np.where(high <= ratio * low, left + (right - left) * share, halves)
        at = row + np.floor(offset * share.astype(np.float64) + 0.5).astype(int), column + step
        np.maximum.at(traced, at, np.where(inverse[at] == 0, value, 0))
    return traced

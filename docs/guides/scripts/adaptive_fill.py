"""Completion of a sparse depth map between the rings of a sweep: the filled_depth_m of networks."""

import sys

import numpy as np

from depth_maps import bridge_rows, fill_columns, smooth_rows
from hidden_returns import hidden_by_contrast, hidden_in_window
from kitti_frame import Array, Steps
from morphology import largest_around, mix_with_morphology, soften


def fill(sparse_m: Array, rule: Steps) -> tuple[Array, Array]:
    """Complete a map that measures something; give depth [m] and where it can be trusted."""
    if rule["method"] == "street":
        sys.exit("this network guesses depth from the image; use onnx_image_depth.py")
    inverse = inverted(sparse_m)  # planes are linear in it
    rows, columns = np.nonzero(inverse)
    widest = rule["widest_spacing_px"]
    gaps = right_neighbours(inverse, rows, columns, widest, widest, rule)[0]
    step = int(np.median(gaps[gaps > 0])) if gaps.any() else 1  # columns along a ring
    tops = largest_around(inverse, 0, step // 2) > 0
    tops[1:] &= ~tops[:-1].copy()
    column, row = np.nonzero(tops.T)
    counts = np.bincount(np.diff(row)[np.diff(column) == 0], minlength=2).cumsum()
    between = int(np.searchsorted(counts, counts[-1] / 2)) if counts[-1] else step  # of two rings
    if rule["hidden_rule"] == "window":
        hidden = hidden_in_window(inverse, rows, columns, step, between, rule)
    else:
        hidden = hidden_by_contrast(inverse, rows, columns, step, between, rule)
    inverse[rows[hidden], columns[hidden]] = 0
    rows, columns = rows[~hidden], columns[~hidden]
    reaches = round(rule["link_columns"] * step), max(between // 2, 1)
    steps = right_neighbours(inverse, rows, columns, *reaches, rule)
    traced = trace_rings(inverse, rows, columns, *steps, rule["surface_ratio"])
    filled, distance, trusted = fill_columns(traced, step, between, rule)
    has_ring = np.flatnonzero(filled[0] > 0)
    to_columns = np.abs(has_ring - np.arange(filled.shape[1])[:, None])
    nearest = has_ring[to_columns.argmin(axis=1)]  # the left one at a tie
    to_ring = np.where(filled > 0, distance, np.inf)
    filled, distance = filled[:, nearest], distance[:, nearest]
    least = between + rule["hole_columns"] * step
    depth_m = inverted(bridge_rows(filled, to_ring, trusted, least, rule["widest_hole"]))
    for _ in range(rule["smoothing_passes"]):
        depth_m = smooth_rows(depth_m, (rule["smoothing"] * distance.astype(float)).astype(int))
    if rule["softening"] is not None:
        depth_m = soften(depth_m, rule)
    if rule["classical_share"] and between <= rule["classical_rows"]:
        depth_m = mix_with_morphology(depth_m, sparse_m, rule)
    depth_m[rows, columns] = sparse_m[rows, columns]
    return depth_m, trusted


def inverted(values: Array) -> Array:
    """Take 1 / value where there is one."""
    return np.where(values > 0, 1 / np.where(values > 0, values, np.float32(1)), np.float32(0))


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

"""Depth maps filled along columns and rows, and smoothed: steps around depth completion."""

import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from kitti_frame import Array, Steps


def fill_columns(traced: Array, step: int, between: int, rule: Steps) -> tuple[Array, Array, Array]:
    """Fill columns between rings; give inverse depth, rows to the ring, and what is trusted."""
    height, width = traced.shape
    row = np.arange(height)[:, None]
    is_ring, columns = traced > 0, np.arange(width)
    above = np.maximum.accumulate(np.where(is_ring, row, -1), axis=0)
    below = np.minimum.accumulate(np.where(is_ring, row, height)[::-1], axis=0)[::-1]
    start, end = np.maximum(above, 0), np.minimum(below, height - 1)
    start = np.where(above < 0, end, start)  # above the top ring its depth goes on
    first, last = traced[start, columns], traced[end, columns]
    slope = (last - first) / (below - above).clip(1).astype(np.float32)
    filled = np.where(is_ring, traced, first + slope * (row - above).astype(np.float32))
    if rule["nearer_share"] >= 0 and between <= rule["dense_rings"] * step:
        # Between two surfaces the nearer one goes on for a share of the gap.
        near, far, gap = np.maximum(first, last), np.minimum(first, last), below - above
        ground = rule["ground_slope"] * rule["kitti_columns"] / step * gap
        is_one = near <= rule["surface_ratio"] * far.astype(np.float64)
        is_one |= is_ring | ((last > first) & (last - first <= ground))
        from_near = np.where(first > last, row - above, below - row)
        filled = np.where(
            is_one, filled, np.where(from_near <= rule["nearer_share"] * gap, near, far)
        )
    distance = np.where(above < 0, below - row, np.minimum(row - above, below - row))
    gap_limit = rule["trusted_rings"] * between
    trusted = (distance <= between) | ((above >= 0) & (below - above <= gap_limit))
    # Below the lowest ring the slope of the last gap goes on if it comes nearer: the ground does.
    lowest = above[-1]
    ends = is_ring & ~np.vstack((is_ring[1:], np.zeros((1, width), bool)))
    before = np.where(ends & (row < lowest), row, -1).max(axis=0)
    value, has_two = traced[lowest.clip(0), columns], before >= 0
    gap = np.where(has_two, lowest - before, 0)
    rise = (value - traced[before.clip(0), columns]) / gap.clip(1).astype(np.float32)
    rows = np.minimum(row - lowest, rule["growth_below"] * gap).astype(np.float32)
    grown = value + np.where(has_two, rise.clip(0), np.float32(0)) * rows
    reach = np.where(has_two, np.maximum(between, np.minimum(gap, gap_limit)), between)
    is_under = (below == height) & (row > lowest) & (lowest >= 0)
    filled = np.where(is_under, grown, filled)
    distance = np.where(is_under, row - lowest, distance)
    trusted = np.where(is_under, row - lowest <= reach, trusted) & (lowest >= 0)
    has_ring = lowest >= 0
    return filled * has_ring, (distance * has_ring).astype(np.float32), trusted


def bridge_rows(filled: Array, to_ring: Array, trusted: Array, least: float, widest: int) -> Array:
    """Fill holes along their rows, linear between the trusted pixels on either side."""
    bridged = filled.copy()
    is_above = np.isfinite(to_ring[0]) & ~np.logical_or.accumulate(to_ring == 0, axis=0)
    for row, known in enumerate(trusted):
        places, untrusted = np.flatnonzero(known), np.cumsum(is_above[row] & ~known)
        for left, right in pairwise(places):
            gap = int(right - left - 1)
            above = untrusted[right] - untrusted[left]
            if not gap or (gap > widest * len(places) and 2 * above > gap):
                continue
            if min(to_ring[row, left + 1], to_ring[row, right - 1]) < least:
                continue
            start = filled[row, left]
            slope = (filled[row, right] - start) / np.float32(right - left)
            bridged[row, left + 1 : right] = start + slope * np.arange(1, gap + 1, dtype=np.float32)
    return bridged


def smooth_rows(depth_m: Array, reach: Array) -> Array:
    """Average each pixel over so many columns to either side."""
    total = np.pad(depth_m.cumsum(axis=1, dtype=np.float64), ((0, 0), (1, 0)))
    column, width = np.arange(depth_m.shape[1]), depth_m.shape[1]
    start, end = (column - reach).clip(0), (column + reach + 1).clip(max=width)
    sums = np.take_along_axis(total, end, axis=1) - np.take_along_axis(total, start, axis=1)
    return np.where(reach > 0, sums / (end - start), depth_m).astype(np.float32)


def write_maps(path: str, maps: dict[str, Any]) -> None:
    """Write arrays to a file that numpy.load opens, under exactly this name."""
    try:
        with Path(path).open("wb") as file:  # numpy would append .npz to another name
            np.savez_compressed(file, **maps)
    except OSError as error:
        sys.exit(f"{path} cannot be written: {error.strerror}; name a file in a folder that exists")

"""Depth maps filled along columns and rows, and smoothed: steps around depth completion."""

from itertools import pairwise

import numpy as np

from kitti_frame import Array, Steps


def fill_columns(traced: Array, between: int, rule: Steps) -> tuple[Array, Array, Array]:
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


def smooth_planes(inverse: Array, reach: int, noise_m: float) -> Array:
    """Draw each pixel to the plane of its window, the less the worse the plane fits (Lee 1980)."""
    height, width = inverse.shape
    v = inverse.astype(np.float64)
    row, column = np.arange(height)[:, None] - height / 2, np.arange(width) - width / 2
    count, row_sum, column_sum, row_square, column_square, total, square, down, across = (
        window_sums(each * np.ones_like(v), reach)
        for each in (1.0, row, column, row**2, column**2, v, v * v, v * row, v * column)
    )
    middle_row, middle_column, mean = row_sum / count, column_sum / count, total / count
    row_spread = (row_square / count - middle_row**2).clip(1e-9)
    column_spread = (column_square / count - middle_column**2).clip(1e-9)
    down = (down / count - middle_row * mean) / row_spread
    across = (across / count - middle_column * mean) / column_spread
    variance = square / count - mean**2 - down**2 * row_spread - across**2 * column_spread
    plane = mean + down * (row - middle_row) + across * (column - middle_column)
    noise = (noise_m * v * v) ** 2
    kept = np.where(variance > noise, 1 - noise / np.where(variance > noise, variance, 1), 0)
    drawn = plane + kept * (v - plane)
    return np.where(v == 0, 0, np.where(drawn > 0, drawn, v)).astype(np.float32)


def window_sums(values: Array, reach: int) -> Array:
    """Sum the square window around each pixel, as far as the image goes."""
    for _ in range(2):
        total = np.pad(values.cumsum(axis=0), ((1, 0), (0, 0)))
        place = np.arange(len(values))
        values = total[(place + reach + 1).clip(max=len(values))] - total[(place - reach).clip(0)]
        values = values.T
    return values

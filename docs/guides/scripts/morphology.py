"""Morphological depth completion, medians and blurs: steps of the completion between rings."""

import numpy as np

from kitti_frame import Array, Steps

windows = np.lib.stride_tricks.sliding_window_view


def largest_around(values: Array, rows: int, columns: int) -> Array:
    """Find the largest value within so many rows and columns of each pixel."""
    padded = np.pad(values, ((rows, rows), (columns, columns)), constant_values=-np.inf)
    rows_first = windows(padded, 2 * rows + 1, axis=0).max(axis=-1)
    return np.asarray(windows(rows_first, 2 * columns + 1, axis=1).max(axis=-1))


def soften(depth_m: Array, rule: Steps) -> Array:
    """Move depths that differ from the blurred median around them to it."""
    weights = np.exp(-(np.arange(-2, 3) ** 2) / (2 * rule["gauss_sigma_px"] ** 2))
    smooth = blur(median(depth_m), weights / weights.sum())
    return move_towards(depth_m, smooth, smooth > 0, rule["softening"], 1.0)


def mix_with_morphology(depth_m: Array, sparse_m: Array, rule: Steps) -> Array:
    """Take the mean with morphological completion near and above measurements."""
    filtered = complete(sparse_m, rule["classical_largest_m"])
    measured, reach = (sparse_m > 0).astype(np.float32), rule["near_px"] // 2
    beside = largest_around(measured, 0, reach) > 0
    is_near = largest_around(measured, reach, reach) > 0
    is_above = beside.argmax(axis=0) > np.arange(len(beside))[:, None]
    chosen = (is_near | is_above) & (filtered > 0)
    return move_towards(
        depth_m, filtered, chosen, rule["classical_difference"], rule["classical_share"]
    )


def move_towards(
    depth: Array, other: Array, chosen: Array, tolerance: float, share: float
) -> Array:
    """Move chosen depths by a share of the way to others that differ by more than a tolerance."""
    difference = other - depth
    is_moved = chosen & (np.abs(difference) > np.float32(tolerance) * depth)
    return np.where(is_moved, depth + np.float32(share) * difference, depth)


def complete(sparse_m: Array, largest_m: float) -> Array:
    """Complete a map by morphology on inverted depth (Ku et al. 2018)."""
    is_kept = (sparse_m > 0.1) & (sparse_m < largest_m - 0.1)
    values = np.where(is_kept, np.float32(largest_m) - sparse_m, np.float32(0))
    padded, (height, width) = np.pad(values, 2), values.shape
    offsets = [(y, x) for y in range(5) for x in range(5) if abs(y - 2) + abs(x - 2) <= 2]
    values = np.max([padded[y : y + height, x : x + width] for y, x in offsets], axis=0)
    values = -largest_around(-largest_around(values, 2, 2), 2, 2)
    values = np.where(values > 0.1, values, largest_around(values, 3, 3))
    top = (values > 0.1).argmax(axis=0)
    is_above = np.arange(height)[:, None] < top
    values = np.where(is_above, values[top, np.arange(width)], values)
    values = np.where(values > 0.1, values, largest_around(values, 15, 15))
    values = median(values)
    values = np.where(values > 0.1, blur(values, np.array([1, 4, 6, 4, 1]) / 16), values)
    return np.where(values > 0.1, np.float32(largest_m) - values, np.float32(0))


def median(values: Array) -> Array:
    """Take the median of the 5x5 square around each pixel."""
    padded, (height, width) = np.pad(values, 2, mode="edge"), values.shape
    around = [padded[y : y + height, x : x + width] for y in range(5) for x in range(5)]
    return np.asarray(np.median(around, axis=0), np.float32)


def blur(values: Array, weights: Array) -> Array:
    """Blur by five weights along rows and columns; the border is mirrored."""
    padded, (height, width) = np.pad(values, 2, mode="reflect"), values.shape
    rows = np.sum([w * padded[y : y + height] for y, w in enumerate(weights)], axis=0)
    both = np.sum([w * rows[:, x : x + width] for x, w in enumerate(weights)], axis=0)
    return np.asarray(both, np.float32)

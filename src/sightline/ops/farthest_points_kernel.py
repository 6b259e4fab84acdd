"""Compiled kernel for farthest point sampling over the leaves of a k-d tree, without torch.

After Han et al. 2023 (QuickFPS): nearby points share a leaf, which stores its bounding box and its
farthest point, the one with the largest distance to the selected points. A new selected point
changes nothing in a leaf whose box is farther from it than that distance. If it does not affect the
farthest point itself, the update of the leaf may wait. Both tests use the same roundings as the
distances, which never decrease from a box to a point in it: the result is exactly that of the plain
method.

The farthest point of a leaf is one 64-bit key: the bits of its squared distance (which sort like
the numbers, since none is negative), then its distance from the end of the cloud. So the largest
key is the farthest point, the first of several, and the search is vectorised.
"""

from typing import Final

import numpy as np
from jaxtyping import Float32, Int8, Int32, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled
from sightline.ops.selection_kernel import select_smallest

_LEAF_POINTS: Final = 128
_MAX_WAITING: Final = 24
_INDEX_BITS: Final = 32
_INDEX_MASK: Final = (1 << _INDEX_BITS) - 1


@compiled
def sample_farthest(
    points: Float32[ndarray, "num_points 3"], count: int
) -> Int64[ndarray, "{count}"]:
    """Select `count` points of a non-empty cloud, starting with point 0."""
    num_points = points.shape[0]
    order, starts = _leaves(points)
    num_leaves = starts.size - 1
    xyz = np.empty((3, num_points), dtype=np.float32)  # leaf by leaf
    place = np.empty(num_points, dtype=np.int64)  # place of each point in that order
    from_end = np.empty(num_points, dtype=np.int64)
    for i in range(num_points):
        place[order[i]] = i
        from_end[i] = num_points - 1 - order[i]
        for axis in range(3):
            xyz[axis, i] = points[order[i], axis]
    low, high = np.empty((3, num_leaves), dtype=np.float32), np.empty((3, num_leaves), np.float32)
    for leaf in range(num_leaves):
        for axis in range(3):
            low[axis, leaf] = xyz[axis, starts[leaf] : starts[leaf + 1]].min()
            high[axis, leaf] = xyz[axis, starts[leaf] : starts[leaf + 1]].max()
    nearest = np.full(num_points, np.inf, dtype=np.float32)  # squared, to the selected points
    nearest_bits = nearest.view(np.int32)
    farthest, farthest_distance = low.copy(), np.full(num_leaves, np.inf, dtype=np.float32)
    keys = np.zeros(num_leaves, dtype=np.int64)
    waiting = np.empty((num_leaves, _MAX_WAITING), dtype=np.int64)
    num_waiting = np.zeros(num_leaves, dtype=np.int64)
    reached = np.empty(num_leaves, dtype=np.int8)
    taken = np.empty(count, dtype=np.int64)
    current = 0
    for step in range(count):
        taken[step] = current
        at = place[current]
        _mark_reached(xyz[:, at], low, high, farthest, farthest_distance, reached)
        for leaf in range(num_leaves):
            if reached[leaf] == 0:
                continue
            waiting[leaf, num_waiting[leaf]] = at
            num_waiting[leaf] += 1
            if reached[leaf] == 1 and num_waiting[leaf] < _MAX_WAITING:
                continue
            start, end = starts[leaf], starts[leaf + 1]
            for k in range(num_waiting[leaf]):
                _lower(xyz, waiting[leaf, k], start, nearest[start:end])
            num_waiting[leaf] = 0
            keys[leaf] = _largest_key(nearest_bits[start:end], from_end[start:end])
            found = place[num_points - 1 - (keys[leaf] & _INDEX_MASK)]
            farthest[:, leaf] = xyz[:, found]
            farthest_distance[leaf] = nearest[found]
        current = num_points - 1 - (_largest(keys) & _INDEX_MASK)
    return taken


@compiled
def _leaves(
    points: Float32[ndarray, "num_points 3"],
) -> tuple[Int64[ndarray, " num_points"], Int64[ndarray, " num_starts"]]:
    """Sort points by leaf, and find each leaf's start: parts are halved along their widest side."""
    num_points = points.shape[0]
    num_leaves = 1
    while num_points > num_leaves * _LEAF_POINTS:
        num_leaves *= 2
    columns = points.T.copy()
    order = np.arange(num_points)
    starts = np.zeros(num_leaves + 1, dtype=np.int64)
    starts[num_leaves] = num_points
    step = num_leaves
    while step > 1:
        for leaf in range(0, num_leaves, step):
            start, end = starts[leaf], starts[leaf + step]
            middle = (start + end) // 2
            values = columns[_widest_axis(columns, order[start:end])]
            select_smallest(values, order, start, end - 1, middle)
            starts[leaf + step // 2] = middle
        step //= 2
    return order, starts


@compiled
def _widest_axis(columns: Float32[ndarray, "3 num_points"], chosen: Int64[ndarray, " n"]) -> int:
    widest, axis = np.float32(-1), 0
    for candidate in range(3):
        low = high = columns[candidate, chosen[0]]
        for i in chosen:
            low, high = min(low, columns[candidate, i]), max(high, columns[candidate, i])
        if high - low > widest:
            widest, axis = high - low, candidate
    return axis


@compiled
def _mark_reached(
    point: Float32[ndarray, "3"],
    low: Float32[ndarray, "3 num_leaves"],
    high: Float32[ndarray, "3 num_leaves"],
    farthest: Float32[ndarray, "3 num_leaves"],
    farthest_distance: Float32[ndarray, " num_leaves"],
    reached: Int8[ndarray, " num_leaves"],
) -> None:
    """Write 0 if a new point changes nothing, 1 if it may, 2 if it changes the farthest."""
    x, y, z = point[0], point[1], point[2]
    low_x, low_y, low_z = low[0], low[1], low[2]
    high_x, high_y, high_z = high[0], high[1], high[2]
    far_x, far_y, far_z = farthest[0], farthest[1], farthest[2]
    zero = np.float32(0)
    for leaf in range(reached.size):
        dx = max(low_x[leaf] - x, x - high_x[leaf], zero)
        dy = max(low_y[leaf] - y, y - high_y[leaf], zero)
        dz = max(low_z[leaf] - z, z - high_z[leaf], zero)
        to_box = dx * dx + dy * dy + dz * dz
        dx, dy, dz = far_x[leaf] - x, far_y[leaf] - y, far_z[leaf] - z
        to_farthest = dx * dx + dy * dy + dz * dz
        limit = farthest_distance[leaf]
        reached[leaf] = np.int8(to_box < limit) + np.int8(to_farthest < limit)


@compiled
def _lower(
    xyz: Float32[ndarray, "3 num_points"], taken: int, start: int, nearest: Float32[ndarray, " n"]
) -> None:
    """Update the distances in the leaf that begins at `start` for a new point."""
    end = start + nearest.size
    x, y, z = xyz[0, start:end], xyz[1, start:end], xyz[2, start:end]  # contiguous: vectorised
    px, py, pz = xyz[0, taken], xyz[1, taken], xyz[2, taken]
    for i in range(nearest.size):
        dx, dy, dz = x[i] - px, y[i] - py, z[i] - pz
        nearest[i] = min(dx * dx + dy * dy + dz * dz, nearest[i])


@compiled
def _largest_key(bits: Int32[ndarray, " n"], from_end: Int64[ndarray, " n"]) -> np.int64:
    best = np.int64(-1)
    for i in range(bits.size):
        best = max(best, (np.int64(bits[i]) << _INDEX_BITS) | from_end[i])
    return best


@compiled
def _largest(keys: Int64[ndarray, " n"]) -> np.int64:
    best = np.int64(-1)
    for i in range(keys.size):
        best = max(best, keys[i])
    return best

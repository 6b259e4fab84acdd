"""Compiled kernel for sampling a fixed number of points from each box, without torch."""

from typing import Final

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled
from sightline.ops.points_in_boxes_kernel import find_points_in_box, sort_cloud

WORD: Final = 0xFFFFFFFF
"""Mask of 32 bits."""
_INDEX_BITS: Final = 31  # low bits of a key, after 32 random bits
_INDEX_MASK: Final = (1 << _INDEX_BITS) - 1
_HISTOGRAM_BITS: Final = 10
_BIN_SHIFT: Final = _INDEX_BITS + 32 - _HISTOGRAM_BITS


@compiled
def scramble(number: int) -> int:
    """Map 32-bit numbers one-to-one to random-looking 32-bit numbers (Wellons 2018).

    The constants are those of his "lowbias32". Products are cut to 32 bits, so that wider
    arithmetic, signed or not, gives the same result.
    """
    number &= WORD
    number = ((number ^ (number >> 16)) * 0x7FEB352D) & WORD
    number = ((number ^ (number >> 15)) * 0x846CA68B) & WORD
    return number ^ (number >> 16)


@compiled
def choose_points(
    columns: Float64[ndarray, "3 num_points"],
    boxes: Float64[ndarray, "num_boxes 7"],
    margin: float,
    seed: int,
    index: Int64[ndarray, "num_boxes count"],
    num_inside: Int64[ndarray, " num_boxes"],
) -> None:
    """Fill the zeroed `index` and `num_inside`."""
    num_points, count = columns.shape[1], index.shape[1]
    if num_points == 0:
        return
    cloud = sort_cloud(columns)
    found = cloud.found
    scrambled, keys = np.empty(num_points, np.int64), np.empty(num_points, dtype=np.int64)
    for i in range(num_points):
        scrambled[i] = scramble(i)
    for k in range(boxes.shape[0]):
        inside = find_points_in_box(cloud, boxes[k], margin)
        num_inside[k] = inside
        salt = scramble(scramble(seed) + k)
        if inside > count:
            for i in range(inside):
                keys[i] = (scramble(salt ^ scrambled[found[i]]) << _INDEX_BITS) | found[i]
            _keep_smallest(keys[:inside], index[k])
        elif inside > 0:
            index[k, :inside] = found[:inside]
            for place in range(inside, count):
                index[k, place] = found[(scramble(salt + place) * inside) >> 32]


@compiled
def _keep_smallest(keys: Int64[ndarray, " n"], kept: Int64[ndarray, " count"]) -> None:
    """Write the indices of the smallest keys, in their order, from more keys than are kept.

    The keys' leading random bits are uniform, so a histogram of their first bits leaves few to
    sort.
    """
    histogram = np.zeros(1 << _HISTOGRAM_BITS, dtype=np.int64)
    for i in range(keys.size):
        histogram[keys[i] >> _BIN_SHIFT] += 1
    last_bin, below = 0, 0
    while below + histogram[last_bin] < kept.size:
        below += histogram[last_bin]
        last_bin += 1
    in_bin, filled = np.empty(histogram[last_bin], dtype=np.int64), 0
    for i in range(keys.size):
        if keys[i] >> _BIN_SHIFT == last_bin:
            in_bin[filled] = keys[i]
            filled += 1
    in_bin.sort()
    limit, count = in_bin[kept.size - below - 1], 0
    for i in range(keys.size):
        if keys[i] <= limit:
            kept[count] = keys[i] & _INDEX_MASK
            count += 1

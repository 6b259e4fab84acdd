"""Which points lie in which box: the compiled kernels, without torch."""

import math

import numpy as np
from jaxtyping import Float64, Int64, UInt8
from numpy import ndarray

from sightline.ops.compiled import compiled

_WORD = 8  # bytes


@compiled
def padded_mask(num_points: int) -> UInt8[ndarray, " num_bytes"]:
    """Working memory for `find_points_in_box`."""
    return np.zeros((num_points + _WORD - 1) // _WORD * _WORD, dtype=np.uint8)


@compiled
def find_points_in_box(
    columns: Float64[ndarray, "3 num_points"],
    box: Float64[ndarray, "7"],
    margin: float,
    mask: UInt8[ndarray, " num_bytes"],
    found: Int64[ndarray, " num_points"],
) -> int:
    """Writes the indices of the points in a box to `found`, ascending, and returns their number.

    Faces are included. A box with a size of 0 holds nothing, whatever the margin.
    """
    if not (box[3] > 0.0 and box[4] > 0.0 and box[5] > 0.0):
        return 0
    half_l, half_w, half_h = 0.5 * box[3] + margin, 0.5 * box[4] + margin, 0.5 * box[5] + margin
    cos, sin = math.cos(box[6]), math.sin(box[6])
    x, y, z = columns[0], columns[1], columns[2]
    cx, cy, cz = box[0], box[1], box[2]
    # all tests in one loop without branches, which is vectorised; then eight at a time are read
    for i in range(x.size):
        dx, dy, dz = x[i] - cx, y[i] - cy, z[i] - cz
        mask[i] = (
            (abs(cos * dx + sin * dy) <= half_l)
            & (abs(cos * dy - sin * dx) <= half_w)
            & (abs(dz) <= half_h)
        )
    words = mask.view(np.uint64)
    count = 0
    for word in range(words.size):
        if words[word] != 0:
            for i in range(word * _WORD, (word + 1) * _WORD):
                found[count] = i
                count += mask[i]
    return count


@compiled
def find_first_boxes(
    columns: Float64[ndarray, "3 num_points"], boxes: Float64[ndarray, "num_boxes 7"]
) -> Int64[ndarray, " num_points"]:
    """The first box that holds each point; -1 where none does."""
    num_points = columns.shape[1]
    first = np.full(num_points, -1, dtype=np.int64)
    mask, found = padded_mask(num_points), np.empty(num_points + 1, dtype=np.int64)
    for k in range(boxes.shape[0] - 1, -1, -1):
        for i in range(find_points_in_box(columns, boxes[k], 0.0, mask, found)):
            first[found[i]] = k
    return first

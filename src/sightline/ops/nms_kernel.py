"""Compiled kernels for greedy non-maximum suppression, without torch."""

import numpy as np
from jaxtyping import Float64, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled
from sightline.ops.rotated_iou_kernel import circumradius, iou_of_rows


@compiled
def suppress_axis_aligned(
    boxes: Float64[ndarray, "n 4"],
    labels: Int64[ndarray, " n"],
    iou_threshold: float,
    max_detections: int,
) -> Int64[ndarray, " kept"]:
    """Select rows of boxes, sorted by descending score; return the kept rows in order."""
    n = boxes.shape[0]
    gone, kept = np.zeros(n, dtype=np.bool_), np.empty(n, dtype=np.int64)
    count = 0
    for i in range(n):
        if gone[i]:
            continue
        if count == max_detections:
            break
        kept[count] = i
        count += 1
        x_min, y_min, x_max, y_max = boxes[i]
        area = (x_max - x_min) * (y_max - y_min)
        for j in range(i + 1, n):
            width = min(x_max, boxes[j, 2]) - max(x_min, boxes[j, 0])
            height = min(y_max, boxes[j, 3]) - max(y_min, boxes[j, 1])
            if width > 0.0 and height > 0.0 and not gone[j] and labels[i] == labels[j]:
                shared = width * height
                union = area + (boxes[j, 2] - boxes[j, 0]) * (boxes[j, 3] - boxes[j, 1]) - shared
                gone[j] = union > 0.0 and shared / union > iou_threshold
    return kept[:count]


@compiled
def suppress_rotated(
    boxes: Float64[ndarray, "n 7"],
    labels: Int64[ndarray, " n"],
    iou_threshold: float,
    max_detections: int,
) -> Int64[ndarray, " kept"]:
    """Select rows of upright 3D boxes (rectangles: z 0, height 1) in the same way."""
    n = boxes.shape[0]
    gone, kept = np.zeros(n, dtype=np.bool_), np.empty(n, dtype=np.int64)
    radii = np.empty(n)
    for i in range(n):
        radii[i] = circumradius(boxes[i, 3], boxes[i, 4])
    count = 0
    for i in range(n):
        if gone[i]:
            continue
        if count == max_detections:
            break
        kept[count] = i
        count += 1
        x, y, radius = boxes[i, 0], boxes[i, 1], radii[i]
        for j in range(i + 1, n):
            dx, dy, reach = boxes[j, 0] - x, boxes[j, 1] - y, radii[j] + radius
            near = dx * dx + dy * dy < reach * reach
            if near and not gone[j] and labels[i] == labels[j]:
                gone[j] = iou_of_rows(boxes[i], boxes[j]) > iou_threshold
    return kept[:count]

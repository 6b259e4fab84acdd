"""Overlaps of KITTI's boxes in the image, on the ground and in space; compiled, in float64.

A box is a row of 11 numbers as in KITTI's files: x_min, y_min, x_max, y_max [px], height, width,
length, x, y, z of the bottom centre [m], rotation_y [rad].
"""

import numpy as np
from jaxtyping import Float64

from sightline.ops.compiled import compiled
from sightline.ops.rotated_iou_kernel import intersection_area

Box = Float64[np.ndarray, "11"]


@compiled
def image_overlap(a: Box, b: Box) -> float:
    """Compute the intersection over union in the image, without "+ 1"."""
    intersection = _image_intersection(a, b)
    if intersection == 0.0:
        return 0.0
    area_a = (a[2] - a[0]) * (a[3] - a[1])
    area_b = (b[2] - b[0]) * (b[3] - b[1])
    # summed in this order for equal rounding
    return float(intersection / (area_a + area_b - intersection))


@compiled
def image_cover(a: Box, b: Box) -> float:
    """Compute the share of `a` covered by `b` in the image."""
    intersection = _image_intersection(a, b)
    if intersection == 0.0:
        return 0.0
    return float(intersection / ((a[2] - a[0]) * (a[3] - a[1])))


@compiled
def ground_and_space_overlap(a: Box, b: Box) -> tuple[float, float]:
    """Compute the IoU of the rectangles on the ground, and of the upright boxes."""
    shared = _ground_intersection(a, b)
    if shared == 0.0:
        return 0.0, 0.0
    area_a, area_b = a[6] * a[5], b[6] * b[5]
    ground = shared / (area_a + area_b - shared)
    volume = shared * _shared_height(a, b)
    if volume == 0.0:
        return ground, 0.0
    return ground, volume / (a[4] * area_a + b[4] * area_b - volume)


@compiled
def ground_and_space_cover(a: Box, b: Box) -> tuple[float, float]:
    """Compute the share of `a` covered by `b`, on the ground and in space."""
    shared = _ground_intersection(a, b)
    if shared == 0.0:
        return 0.0, 0.0
    area = a[6] * a[5]
    volume = shared * _shared_height(a, b)
    if volume == 0.0:
        return shared / area, 0.0
    return shared / area, volume / (a[4] * area)


@compiled
def _image_intersection(a: Box, b: Box) -> float:
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    if width <= 0.0 or height <= 0.0:
        return 0.0
    return float(width * height)


@compiled
def _ground_intersection(a: Box, b: Box) -> float:
    """Compute the intersection area of the rectangles; 0 if one of them has no area.

    A box without 3D part has length and width -1. Like the official program, we treat it as a
    square of 1 m, so that two of them at the same place overlap. With a size of 0 the program
    crashes, and one negative size is meaningless: both have no area here.
    """
    if a[6] * a[5] <= 0.0 or b[6] * b[5] <= 0.0:
        return 0.0
    # rotation_y turns from z to x, a yaw in the x-z plane from x to z
    return intersection_area(
        a[7], a[9], abs(a[6]), abs(a[5]), -a[10], b[7], b[9], abs(b[6]), abs(b[5]), -b[10]
    )


@compiled
def _shared_height(a: Box, b: Box) -> float:
    """Compute the intersection length of both [y - h, y]; 0 if a height is negative."""
    return float(max(0.0, min(a[8], b[8]) - max(a[8] - a[4], b[8] - b[4])))

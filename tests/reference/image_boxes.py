"""Bounds of a 3D box's edges within the image, edge by edge in exact fractions."""

import math
from fractions import Fraction

NEAR_M = Fraction(0.1)


def corners_of(size_hwl, bottom, rotation_y):
    """Corners of a box that stands upright in the camera frame, by their place on it."""
    height, width, length = size_hwl
    corners = {}
    for ahead in (-1, 1):
        for aside in (-1, 1):
            for top in (0, 1):
                x, z = ahead * length / 2, aside * width / 2
                corners[ahead, aside, top] = (
                    bottom[0] + x * math.cos(rotation_y) + z * math.sin(rotation_y),
                    bottom[1] - top * height,
                    bottom[2] - x * math.sin(rotation_y) + z * math.cos(rotation_y),
                )
    return corners


def image_box(size_hwl, bottom, rotation_y, image_from_camera, image_size):
    """x_min, y_min, x_max, y_max, or None where the image shows no edge."""
    corners = corners_of(size_hwl, bottom, rotation_y)
    places = list(corners)
    pixels = []
    for start in places:
        for end in places:
            is_edge = sum(a != b for a, b in zip(start, end, strict=True)) == 1
            if is_edge and start < end:
                pixels += _shown_ends(corners[start], corners[end], image_from_camera, image_size)
    if not pixels:
        return None
    xs, ys = zip(*pixels, strict=True)
    return [float(value) for value in (min(xs), min(ys), max(xs), max(ys))]


def _shown_ends(start, end, image_from_camera, image_size):
    """Both ends of the part of a line that the image shows; none where it shows nothing."""
    height, width = image_size
    first, last = Fraction(0), Fraction(1)
    a, b = (_homogeneous(point, image_from_camera) for point in (start, end))
    conditions = (
        lambda x, y, w: w - NEAR_M,  # noqa: ARG005
        lambda x, y, w: x,  # noqa: ARG005
        lambda x, y, w: (width - 1) * w - x,  # noqa: ARG005
        lambda x, y, w: y,  # noqa: ARG005
        lambda x, y, w: (height - 1) * w - y,  # noqa: ARG005
    )
    for condition in conditions:  # each must not be negative, and is linear along the line
        at_start, at_end = condition(*a), condition(*b)
        if at_start < 0 and at_end < 0:
            return []
        if at_start < 0:
            first = max(first, at_start / (at_start - at_end))
        elif at_end < 0:
            last = min(last, at_start / (at_start - at_end))
    if first > last:
        return []
    ends = []
    for share in (first, last):
        x, y, w = (p + share * (q - p) for p, q in zip(a, b, strict=True))
        ends.append((x / w, y / w))
    return ends


def _homogeneous(point, image_from_camera):
    exact = [Fraction(value) for value in point] + [Fraction(1)]
    return [
        sum(Fraction(weight) * value for weight, value in zip(row, exact, strict=True))
        for row in image_from_camera
    ]

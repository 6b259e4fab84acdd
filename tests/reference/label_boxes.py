"""KITTI's 2D boxes by walking along the edges of a 3D box; shares no code with what it checks."""

import itertools
import math


def project_box(location, size_hwl, rotation_y, image_from_camera, image_size, steps=2000):
    """Bounds of the places seen within the image (None: no place is) and the share outside it.

    The share is 1 where a corner is behind the camera. An edge is looked at in `steps` places, so
    the bounds are too small by up to one step.
    """
    height, width, length = size_hwl
    seen, corners = [], []
    for first, second in _edges():
        for step in range(steps + 1):
            along, down, across = (
                a + (b - a) * step / steps for a, b in zip(first, second, strict=True)
            )
            # A box of rotation 0 faces +x; one of pi / 2 faces -z, towards the camera.
            ahead, aside = along * length, across * width
            x = location[0] + ahead * math.cos(rotation_y) + aside * math.sin(rotation_y)
            y = location[1] + down * height
            z = location[2] - ahead * math.sin(rotation_y) + aside * math.cos(rotation_y)
            u, v, depth = (r[0] * x + r[1] * y + r[2] * z + r[3] for r in image_from_camera)
            is_corner = step in (0, steps)
            if depth < 0.1:
                corners += [None] if is_corner else []
                continue
            place = u / depth, v / depth
            corners += [place] if is_corner else []
            if 0 <= place[0] <= image_size[1] - 1 and 0 <= place[1] <= image_size[0] - 1:
                seen.append(place)
    if not seen:
        return None, 1.0
    box = _bounds(seen)
    if None in corners:
        return box, 1.0
    return box, 1 - _area(box) / _area(_bounds(corners))


def _edges():
    """Pairs of corners that differ in one of (along, down, across)."""
    corners = list(itertools.product((-0.5, 0.5), (-1, 0), (-0.5, 0.5)))
    for first, second in itertools.combinations(corners, 2):
        if sum(a != b for a, b in zip(first, second, strict=True)) == 1:
            yield first, second


def _bounds(places):
    xs, ys = zip(*places, strict=True)
    return min(xs), min(ys), max(xs), max(ys)


def _area(box):
    return (box[2] - box[0]) * (box[3] - box[1])

"""Rays against triangles, each against each in double precision (Moeller, Trumbore 1997)."""

import numpy as np


def crossing(origin, direction, corners):
    """(distance, u, v) where a ray meets the plane of a triangle; None if it runs along it."""
    first, along, up = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    across = np.cross(direction, up)
    scale = along @ across
    if abs(scale) < 1e-12:
        return None
    to_origin = origin - first
    u = to_origin @ across / scale
    around = np.cross(to_origin, along)
    return up @ around / scale, u, direction @ around / scale


def first_hit(origin, direction, triangles):
    """(face, distance) of the nearest triangle ahead; None if there is none."""
    nearest = None
    for face, corners in enumerate(triangles):
        met = crossing(origin, direction, corners)
        if met is None or met[0] <= 0 or min(met[1], met[2], 1 - met[1] - met[2]) < 0:
            continue
        if nearest is None or met[0] < nearest[1]:
            nearest = (face, met[0])
    return nearest


def margin(origin, direction, triangles):
    """How near the ray comes to an edge of any triangle or to its plane's horizon, in its u, v."""
    least = np.inf
    for corners in triangles:
        met = crossing(origin, direction, corners)
        if met is None:
            return 0.0
        distance, u, v = met
        least = min(least, abs(u), abs(v), abs(1 - u - v), abs(distance))
    return least

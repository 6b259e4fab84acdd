"""Rays, planes and boxes written out one by one, in plain numpy."""

import math

import numpy as np


def first_hit(vertices, faces, origin, direction):
    """(face, distance) of the nearest triangle along a ray, or (-1, inf): solves each for itself.

    The distance is in lengths of the direction.
    """
    best = (-1, math.inf)
    for index, (a, b, c) in enumerate(vertices[face].astype(np.float64) for face in faces):
        system = np.stack((b - a, c - a, -np.asarray(direction, np.float64)), axis=1)
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        u, v, distance = np.linalg.solve(system, np.asarray(origin) - a)
        if u >= 0 and v >= 0 and u + v <= 1 and 0 < distance < best[1]:
            best = (index, distance)
    return best


def pixel_ray(column, row, image_from_camera, camera_from_lidar):
    """(origin, direction) of a pixel in the LiDAR frame.

    The origin is the camera's centre; the direction ends where the depth is one metre.
    """
    image_from_lidar = image_from_camera @ camera_from_lidar
    rotation, offset = image_from_lidar[:, :3], image_from_lidar[:, 3]
    origin = np.linalg.solve(rotation, -offset)
    return origin, np.linalg.solve(rotation, np.array([column, row, 1.0]) - offset) - origin


def depth_of_plane(column, row, normal, distance, image_from_lidar):
    """Depth at which a pixel sees the plane normal . x = distance: three planes that meet."""
    across = image_from_lidar[0] - column * image_from_lidar[2]
    along = image_from_lidar[1] - row * image_from_lidar[2]
    point = np.linalg.solve(
        np.stack((across[:3], along[:3], normal)), np.array([-across[3], -along[3], distance])
    )
    return image_from_lidar[2] @ np.append(point, 1.0)


def segment_meets_box(start, direction, low, high):
    """Whether a ray meets a box that stands along the axes: the slabs it passes overlap."""
    first, last = 0.0, math.inf
    for axis in range(3):
        ends = sorted(
            (limit[axis] - start[axis]) / (direction[axis] or 1e-300) for limit in (low, high)
        )
        first, last = max(first, ends[0]), min(last, ends[1])
    return first <= last


def covered_share(position, width, period, thickness, steps=4000):
    """Share of an interval that lies on lines which start at every multiple of a period."""
    places = position + ((np.arange(steps) + 0.5) / steps - 0.5) * width
    return float(np.mean(np.mod(places, period) < thickness))

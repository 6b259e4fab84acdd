"""Geometry written out number by number, in plain Python."""

import math


def box_corners(box):
    """Eight corners of (x, y, z, length, width, height, yaw), bottom four first."""
    x, y, z, length, width, height, yaw = box
    corners = []
    for up in (-height / 2, height / 2):
        for ahead, left in (
            (length / 2, width / 2),
            (length / 2, -width / 2),
            (-length / 2, -width / 2),
            (-length / 2, width / 2),
        ):
            corners.append(
                (
                    x + ahead * math.cos(yaw) - left * math.sin(yaw),
                    y + ahead * math.sin(yaw) + left * math.cos(yaw),
                    z + up,
                )
            )
    return corners


def box_contains(box, point):
    """Whether a point lies in the box: along its heading, across it and in height."""
    x, y, z, length, width, height, yaw = box
    dx, dy, dz = point[0] - x, point[1] - y, point[2] - z
    ahead = dx * math.cos(yaw) + dy * math.sin(yaw)
    left = -dx * math.sin(yaw) + dy * math.cos(yaw)
    return abs(ahead) <= length / 2 and abs(left) <= width / 2 and abs(dz) <= height / 2


def project(point, image_from_camera, camera_from_lidar):
    """(x, y, depth) of a LiDAR point, or None where it is not in front of the camera."""
    camera = [
        sum(camera_from_lidar[row][k] * (*point, 1.0)[k] for k in range(4)) for row in range(3)
    ]
    image = [
        sum(image_from_camera[row][k] * (*camera, 1.0)[k] for k in range(4)) for row in range(3)
    ]
    if image[2] <= 0:
        return None
    return image[0] / image[2], image[1] / image[2], image[2]


def sparse_depth_map(points, image_from_camera, camera_from_lidar, height, width):
    """A list of rows; each pixel holds the smallest depth that falls on it, 0 where none does."""
    rows = [[0.0] * width for _ in range(height)]
    for point in points:
        found = project(point[:3], image_from_camera, camera_from_lidar)
        if found is None:
            continue
        column, row = math.floor(found[0] + 0.5), math.floor(found[1] + 0.5)
        if 0 <= row < height and 0 <= column < width:
            there = rows[row][column]
            rows[row][column] = found[2] if there == 0 else min(there, found[2])
    return rows


def iou2d(a, b):
    """Overlap of two boxes x_min, y_min, x_max, y_max."""

    def area(box):
        return max(0.0, box[2] - box[0]) * max(0.0, box[3] - box[1])

    common = area((max(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), min(a[3], b[3])))
    union = area(a) + area(b) - common
    return common / union if union > 0 else 0.0

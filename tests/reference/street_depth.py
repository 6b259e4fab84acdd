"""Depth of a plain street, pixel by pixel."""

import numpy as np

HORIZON_M, CEILING_M, LEAST_CAMERA_M = 30.0, 6.0, 0.5


def street_depth(matrix, camera_from_level, size, lidar_height_m):
    """Follow the ray of each pixel through the level frame."""
    level_from_camera = np.linalg.inv(camera_from_level)
    camera_m = max(lidar_height_m + level_from_camera[2, 3], LEAST_CAMERA_M)
    depth_m = np.zeros(size)
    for row in range(size[0]):
        for column in range(size[1]):
            ray = np.linalg.solve(matrix, [column, row, 1.0])  # one metre along the optical axis
            rise = (level_from_camera[:3, :3] @ ray)[2]
            inverse = 1 / HORIZON_M
            inverse += -rise / camera_m if rise < 0 else rise / CEILING_M
            depth_m[row, column] = 1 / inverse
    return depth_m

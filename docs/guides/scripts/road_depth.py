"""Depth of an image box by the road under its lower edge, and by the returns within it."""

import numpy as np

from joined_scene import Scene
from kitti_frame import Array

LIDAR_HEIGHT_M = 1.73


def depth_on_road(scene: Scene, box: Array, length_m: float) -> float | None:
    """Depth [m] of the centre of an object whose lower edge stands on the flat road."""
    camera, mounting = scene.frame.camera, scene.frame.mounting
    ray = np.linalg.solve(camera[:, :3], np.array([(box[0] + box[2]) / 2, box[3], 1]))
    origin = -np.linalg.solve(camera[:, :3], camera[:, 3])
    up = mounting[:3, 2]
    height, falling = (origin - mounting[:3, 3]) @ up + LIDAR_HEIGHT_M, ray @ up
    if falling >= -1e-3:
        return None
    return float((origin[2] + ray[2] * height / -falling + 0.3 * length_m).clip(2, 90))


def depths_of_returns(scene: Scene, box: Array, depth_m: float, thickness_m: float) -> Array:
    """Depths [m] of the densest near layer of returns inside the box."""
    margin = np.array([0.12, 0.08]) * (box[2:] - box[:2])
    inside = (scene.pixels > box[:2] + margin) & (scene.pixels < box[2:] - margin)
    mounting = scene.frame.mounting
    depths = scene.points[inside.all(axis=1)] @ mounting[2, :3] + mounting[2, 3]
    depths = np.sort(depths[np.abs(depths - depth_m) < 0.35 * depth_m + 2])
    if not len(depths):
        return depths
    places = np.arange(len(depths))
    counts = np.searchsorted(depths, depths + thickness_m, "right") - places
    first = int(np.argmax(counts - 0.01 * places))
    return depths[first : first + counts[first]]

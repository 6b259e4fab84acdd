"""Bad regions of sensors: blocks of the image, cells ahead of the LiDAR."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from sightline.health.camera_checks import blank_blocks
from sightline.health.lidar_checks import cell_counts
from sightline.health.sphere import to_sphere

_SMALLEST_HOLE = 12  # connected cells; fewer are glass or a dark car


def bad_image_regions(
    image: UInt8[np.ndarray, "height width 3"],
) -> Bool[np.ndarray, "rows columns"]:
    """Mark blocks, about `camera_checks.BLOCK_PX` wide, that are black or blinded."""
    return blank_blocks(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


def bad_sweep_regions(
    points: Float32[np.ndarray, "num_points 4"],
) -> Bool[np.ndarray, "rows columns"]:
    """Mark `lidar_checks.CELL_DEG` cells below the horizon in large holes without points."""
    _, azimuth_deg, elevation_deg = to_sphere(points)
    empty = (cell_counts(azimuth_deg, elevation_deg) == 0).astype(np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(empty, connectivity=4)
    large = statistics[:, cv2.CC_STAT_AREA] >= _SMALLEST_HOLE
    large[0] = False  # label of the cells that are not empty
    bad: Bool[np.ndarray, "rows columns"] = large[labels]
    return bad

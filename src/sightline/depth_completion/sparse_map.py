"""Input check of the completion methods; where a sweep measured, and where it saw nothing."""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from scipy import ndimage

BESIDE_SHARE: Final = 0.025
"""Distance from the nearest column with a return at which a hole begins, as a share of the width:
two thirds of a degree of KITTI's camera on each side hold a column in any sound sweep."""


def check_sparse_depth(sparse_depth_m: Float32[np.ndarray, "height width"]) -> None:
    """Refuse a map with invalid depths.

    Raises:
        ValueError: The map is not of float32 and height, width, a pixel is negative or not finite,
            or there is none.
    """
    if sparse_depth_m.dtype != np.float32 or sparse_depth_m.ndim != 2:
        raise ValueError(
            f"the sparse depth map is {sparse_depth_m.dtype} of shape {sparse_depth_m.shape}, "
            "expected float32 of height, width; give metres as float32, one map at a time"
        )
    if not sparse_depth_m.size:
        raise ValueError(
            f"the sparse depth map has the shape {sparse_depth_m.shape}, which holds no pixel; "
            "give one of the image's height and width"
        )
    is_depth = (sparse_depth_m >= 0) & (sparse_depth_m < np.inf)  # NaN compares false
    if not is_depth.all():
        row, column = np.argwhere(~is_depth)[0]
        raise ValueError(
            f"the sparse depth map holds {sparse_depth_m[row, column]} in row {row}, column "
            f"{column}; depths are metres above 0, and 0 stands for no measurement: set it to 0"
        )


def inside_hull(is_measured: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    """Pixels in or on the convex hull of the measured ones; all false where none is measured."""
    inside = np.zeros(is_measured.shape, np.uint8)
    points = cv2.findNonZero(is_measured.astype(np.uint8))
    if points is not None:
        cv2.fillConvexPoly(inside, cv2.convexHull(points), 1)
    return inside.astype(bool)


def find_holes(
    sparse_depth_m: Float32[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Mark the columns of a sweep without any return in and beside them.

    The road returns something in every direction, even below the sky, so there a part of the sweep
    is lost or hidden, or outside of the LiDAR's field of view.

    Args:
        sparse_depth_m: The sweep in the image; 0 = no return.
    """
    is_hit: Bool[np.ndarray, " width"] = np.any(sparse_depth_m > 0, axis=0)
    reach = max(1, round(BESIDE_SHARE * sparse_depth_m.shape[1]))
    is_near = ndimage.binary_dilation(is_hit, iterations=reach)
    return np.broadcast_to(~is_near, sparse_depth_m.shape).copy()

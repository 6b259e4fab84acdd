"""Columns of the image in which the LiDAR saw nothing."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32
from scipy import ndimage

BESIDE_SHARE: Final = 0.025
"""Distance from the nearest column with a return at which a hole begins, as a share of the width:
two thirds of a degree of KITTI's camera on each side hold a column in any sound sweep."""


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

"""Crop of sweeps to the camera's view."""

import numpy as np
from jaxtyping import Bool, Float, Float64


def is_in_view(
    points: Float[np.ndarray, "num_points fields"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    image_size: tuple[int, int],
) -> Bool[np.ndarray, " num_points"]:
    """Mask of the points in KITTI's reduced sweeps, exact on its own files.

    For six frames with whole and reduced sweeps it keeps exactly the same points. It is not the
    image's area, whose first pixel starts at -0.5: the crop begins at the centres of the first
    pixels and ends half a pixel beyond the last ones.

    Args:
        points: Points in the LiDAR frame, x, y, z first [m].
        image_from_lidar: Projection of a `Calibration`.
        image_size: Height and width [px].

    Returns:
        Mask of the points in front of the camera, with 0 <= x < width and 0 <= y < height [px].
        False for NaN.
    """
    height, width = image_size
    homogeneous = points[:, :3].astype(np.float64) @ image_from_lidar[:, :3].T
    homogeneous += image_from_lidar[:, 3]
    depth = np.where(homogeneous[:, 2] > 0, homogeneous[:, 2], np.nan)
    x, y = homogeneous[:, 0] / depth, homogeneous[:, 1] / depth
    # NaN, for points without a pixel, compares false.
    shown: Bool[np.ndarray, " num_points"] = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return shown

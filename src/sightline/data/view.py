"""Which points of a sweep the camera's image shows."""

import numpy as np
from jaxtyping import Bool, Float, Float64


def is_in_view(
    points: Float[np.ndarray, "num_points fields"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    image_size: tuple[int, int],
) -> Bool[np.ndarray, " num_points"]:
    """The cut that KITTI's reduced sweeps were made with, exact on its own files.

    Of six frames whose whole and reduced sweeps are both at hand it keeps the same points, all of
    them and no other. It is not the image's area, whose first pixel reaches from -0.5: the cut
    begins at the centres of the first pixels and ends half a pixel beyond the last ones.

    Args:
        points: LiDAR frame, x, y, z first [m].
        image_from_lidar: As a `Calibration` has it.
        image_size: Height and width [px].

    Returns:
        Whether the point lies in front of the camera, at x from 0 to below the width and y from 0
        to below the height [px]. False for NaN.
    """
    height, width = image_size
    homogeneous = points[:, :3].astype(np.float64) @ image_from_lidar[:, :3].T
    homogeneous += image_from_lidar[:, 3]
    depth = np.where(homogeneous[:, 2] > 0, homogeneous[:, 2], np.nan)
    x, y = homogeneous[:, 0] / depth, homogeneous[:, 1] / depth
    # NaN, where there is no pixel, compares false with everything.
    shown: Bool[np.ndarray, " num_points"] = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return shown

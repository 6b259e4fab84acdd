"""Pairing of images and sweeps by time."""

import numpy as np
from jaxtyping import Int64


def pair_nearest(
    camera_ns: Int64[np.ndarray, " num_images"],
    lidar_ns: Int64[np.ndarray, " num_sweeps"],
    max_gap_ns: int,
) -> Int64[np.ndarray, "num_pairs 2"]:
    """Find images and sweeps that are mutual nearest neighbours in time, in order.

    So none is used twice, and the best images of a camera faster than the LiDAR are used. The
    earlier of two equally near ones wins.

    Args:
        camera_ns: Times of the images, ascending.
        lidar_ns: Times of the sweeps, ascending.
        max_gap_ns: Largest time difference of a pair.

    Returns:
        Indices of image and sweep.
    """
    if not len(camera_ns) or not len(lidar_ns):
        return np.empty((0, 2), np.int64)
    image_of_sweep = _nearest(lidar_ns, camera_ns)
    sweep_of_image = _nearest(camera_ns, lidar_ns)
    sweeps = np.arange(len(lidar_ns))
    is_mutual = sweep_of_image[image_of_sweep] == sweeps
    is_near = np.abs(camera_ns[image_of_sweep] - lidar_ns) <= max_gap_ns
    kept = sweeps[is_mutual & is_near]
    return np.stack((image_of_sweep[kept], kept), axis=1).astype(np.int64)


def _nearest(
    times_ns: Int64[np.ndarray, " count"], others_ns: Int64[np.ndarray, " other_count"]
) -> Int64[np.ndarray, " count"]:
    """Index of the nearest other time for each time."""
    after = np.searchsorted(others_ns, times_ns).clip(0, len(others_ns) - 1)
    before = (after - 1).clip(0)
    is_before = np.abs(others_ns[before] - times_ns) <= np.abs(others_ns[after] - times_ns)
    nearest_ns = others_ns[np.where(is_before, before, after)]
    return np.searchsorted(others_ns, nearest_ns)  # the first of several equal times

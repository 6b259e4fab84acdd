"""Spherical coordinates of LiDAR points."""

import numpy as np
from jaxtyping import Float32


def to_sphere(
    points: Float32[np.ndarray, "num_points 4"],
) -> tuple[
    Float32[np.ndarray, " num_points"],
    Float32[np.ndarray, " num_points"],
    Float32[np.ndarray, " num_points"],
]:
    """Compute range [m], azimuth (counter-clockwise from ahead) and elevation [degrees]."""
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    flat = np.hypot(x, y)
    return np.hypot(flat, z), np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, flat))

"""LiDAR echoes: the minimum power for detection."""

import numpy as np
from jaxtyping import Float64

from sightline.corruptions.corruption import Sweep
from sightline.corruptions.sensor import SpinningLidar

_LIMIT_REFLECTANCE = 0.9  # reflectance of a target just detected at the maximum range


def faintest_power(lidar: SpinningLidar) -> float:
    """Compute the minimum detectable power, as reflectance / range^2: Kilic et al. 2021, LISA.

    This is the power of a target of reflectance 0.9 at the maximum range.
    """
    return _LIMIT_REFLECTANCE / lidar.max_range_m**2


def clear_air_reflectances(
    points: Sweep,
    ranges_m: Float64[np.ndarray, " num_points"],
    lidar: SpinningLidar,
    rng: np.random.Generator,
) -> Float64[np.ndarray, " num_points"]:
    """Estimate the reflectances of points in clear air, where their echoes were detected.

    A reading below the minimum power, such as the many readings of 0, is replaced by an echo above
    it. The logarithm of their ratio is drawn from an exponential distribution: each stretch of fog
    then removes the same share of the remaining points.
    """
    read = points[:, 3].double().numpy()
    margins = np.exp(np.minimum(rng.standard_exponential(len(points)), 50))
    reflectances: Float64[np.ndarray, " num_points"] = np.maximum(
        read, faintest_power(lidar) * ranges_m**2 * margins
    )
    return reflectances

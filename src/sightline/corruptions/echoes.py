"""What a LiDAR receives: how strong an echo must be to be found."""

import numpy as np
from jaxtyping import Float64

from sightline.corruptions.corruption import Sweep
from sightline.corruptions.sensor import SpinningLidar

_LIMIT_REFLECTANCE = 0.9  # of the target that is just seen at the largest range


def faintest_power(lidar: SpinningLidar) -> float:
    """Power of the faintest echo that is found, as reflectance / range^2: Kilic et al. 2021, LISA.

    That of a target of reflectance 0.9 at the largest range.
    """
    return _LIMIT_REFLECTANCE / lidar.max_range_m**2


def clear_air_reflectances(
    points: Sweep,
    ranges_m: Float64[np.ndarray, " num_points"],
    lidar: SpinningLidar,
    rng: np.random.Generator,
) -> Float64[np.ndarray, " num_points"]:
    """Reflectances of points, which were found in clear air: their echoes were strong enough.

    A point whose reading says that its echo was too faint, such as the many that read 0, is given
    an echo that is stronger than the faintest by a factor whose logarithm is drawn from an
    exponential distribution: so each stretch of fog costs the same share of those that are left.
    """
    read = points[:, 3].double().numpy()
    margins = np.exp(np.minimum(rng.standard_exponential(len(points)), 50))
    reflectances: Float64[np.ndarray, " num_points"] = np.maximum(
        read, faintest_power(lidar) * ranges_m**2 * margins
    )
    return reflectances

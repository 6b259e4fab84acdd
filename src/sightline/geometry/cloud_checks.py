"""What is usable of a point cloud as users have it, and what is wrong where nothing is.

Without PyTorch, for checks that start at once.
"""

from typing import Final

import numpy as np
from jaxtyping import Float

from sightline.geometry.mount import MAX_RANGE_M

_MAX_COLUMNS: Final = 64
"""Of a row of numbers; drivers write up to some twenty fields for each point."""
_BRIGHTER_SHARE: Final = 0.01  # of a sweep's points: retroreflectors exceed many sensors' scales


def rows_of(array: np.ndarray) -> Float[np.ndarray, "num_points columns"] | None:
    """Numbers in rows of three or more, the rows of an organised cloud in order; else None.

    None as well for more than 64 points that are written column by column, 4 x num_points.
    """
    is_cloud = array.ndim >= 2 and 3 <= array.shape[-1] <= _MAX_COLUMNS
    if not is_cloud or array.dtype.kind not in "fiu":
        return None
    rows: Float[np.ndarray, "num_points columns"] = array.reshape(-1, array.shape[-1])
    return rows


def echoes(points: Float[np.ndarray, "num_points 4"]) -> Float[np.ndarray, "num_echoes 4"]:
    """The points that an echo made.

    Where none came back, drivers write values that are not finite, the largest that there are, or
    the sensor's own place.
    """
    with np.errstate(over="ignore"):  # what float32, a sweep's type, cannot hold becomes infinite
        is_finite = np.isfinite(points.astype(np.float32)).all(axis=1)
    made: Float[np.ndarray, "num_echoes 4"] = points[is_finite & points[:, :3].any(axis=1)]
    return made


def cloud_fault(
    points: Float[np.ndarray, "num_points 4"], max_intensity: float
) -> tuple[str, str] | None:
    """Why finite points are no cloud in metres with intensities from 0 to max_intensity.

    One point in a hundred may be brighter, as retroreflectors are; none may be darker than 0.

    Returns:
        The problem, as the rest of a sentence, and the remedy; None where there is no fault.
    """
    if not len(points):
        return None
    middle_m = float(np.median(np.linalg.norm(points[:, :3].astype(np.float64), axis=1)))
    if middle_m > MAX_RANGE_M:
        problem = (
            f"{len(points)} points, half of them farther away than {middle_m:.4g} m, expected up "
            f"to {MAX_RANGE_M:.0f} m: they are probably in millimetres"
        )
        return problem, "write them in metres"
    intensities = points[:, 3]
    if intensities.min() < 0 or (intensities > max_intensity).mean() > _BRIGHTER_SHARE:
        problem = (
            f"intensities from {intensities.min():.4g} to {intensities.max():.4g}, expected 0 to "
            f"{max_intensity:.6g}"
        )
        if intensities.min() < 0:
            return problem, "write them from 0 on, or leave them out"
        return problem, (
            "set max_intensity (of an import: --max-intensity) to what stands for a reflectance of "
            "1, often 255"
        )
    return None


def reflectances(
    intensities: Float[np.ndarray, " num_points"], max_intensity: float
) -> Float[np.ndarray, " num_points"]:
    """Intensities as reflectances in [0, 1]; 1 of what is brighter than max_intensity."""
    return (intensities / max_intensity).clip(0, 1)

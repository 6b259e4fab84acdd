"""Recognition of distances along each pixel's ray in depth maps, by their ratio to true depths.

A distance is sqrt(1 + r^2 / f^2) times the depth, r being the distance [px] from the principal
point, which is near the centre of the image, and f the focal length [px].
"""

from typing import Final

import numpy as np
from jaxtyping import Float64, Int64

_RINGS: Final = 6
"""Number of rings about the centre, with equal steps of r^2, each in a left and a right half."""
_MAX_LOG: Final = 1.0
"""Largest logarithm of a ratio that enters a mean unchanged."""
_MIN_PIXELS: Final = 20  # of half a ring
_SQUARED_TANGENTS: Final = np.geomspace(0.05, 8, 80)
"""Squared tangents of the half angle of view, of cameras from 25 to 140 degrees."""
_MIN_RISE: Final = 0.08
"""Smallest logarithm of the ratio at the border; real maps' mean logarithms are within 0.03."""
_MAX_MISFIT: Final = 0.12
"""Largest root mean square of what the fit leaves, as a share of that logarithm."""


def ring_sums(
    log_ratios: Float64[np.ndarray, " pixels"],
    rows: Int64[np.ndarray, " pixels"],
    columns: Int64[np.ndarray, " pixels"],
    size: tuple[int, int],
) -> Float64[np.ndarray, "half_rings 2"]:
    """Count the pixels of each half ring, and sum the logarithms of their ratios.

    Args:
        log_ratios: Logarithms of predicted over true depth.
        rows: Their rows.
        columns: Their columns.
        size: Height and width of the image.
    """
    x, y = columns - (size[1] - 1) / 2, rows - (size[0] - 1) / 2
    rings = (_RINGS * (x**2 + y**2) / (max(size) / 2) ** 2).astype(np.int64)
    is_in = rings < _RINGS
    halves = (rings + _RINGS * (x > 0))[is_in]
    values = np.clip(log_ratios[is_in], -_MAX_LOG, _MAX_LOG)
    counts, sums = (np.bincount(halves, each, 2 * _RINGS) for each in (None, values))
    return np.stack((counts, sums), axis=1).astype(np.float64)


def fit_rays(sums: Float64[np.ndarray, "half_rings 2"]) -> tuple[float, bool] | None:
    """Fit the focal length by which one of two sets of maps holds distances along rays.

    Args:
        sums: Sums of `ring_sums` over all images.

    Returns:
        Focal length as a share of the longer side, and whether the predictions are distances, not
        the ground truth; None: neither is.
    """
    counts, totals = sums.T
    is_seen = counts >= _MIN_PIXELS
    if is_seen[:_RINGS].sum() < _RINGS - 1 or is_seen[_RINGS:].sum() < _RINGS - 1:
        return None
    means = totals[is_seen] / counts[is_seen]
    is_longer = bool(means.mean() > 0)
    places = (np.tile(np.arange(_RINGS), 2)[is_seen] + 0.5) / _RINGS
    expected = np.log1p(_SQUARED_TANGENTS[:, None] * places) / 2
    rises = means if is_longer else -means
    misfits = np.sqrt(((rises - expected) ** 2).mean(axis=1))
    best = int(misfits.argmin())
    rise = float(np.log1p(_SQUARED_TANGENTS[best]) / 2)
    if rise < _MIN_RISE or misfits[best] > _MAX_MISFIT * rise:
        return None
    return float(0.5 / np.sqrt(_SQUARED_TANGENTS[best])), is_longer

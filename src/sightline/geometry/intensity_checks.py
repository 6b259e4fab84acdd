"""Checks of the intensities of users' point clouds: scale, and other numbers in their place.

Without PyTorch, for checks that start at once.
"""

import math
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Shaped

from sightline.geometry.echoes import is_echo
from sightline.geometry.user_warning import warn_user

_MIN_POINTS_TO_WARN: Final = 100
_LEAST_BYTE = -128  # of eight bits with a sign
_BRIGHTER_SHARE: Final = 0.01  # of a sweep's points: retroreflectors exceed many scales
_DARK_SHARE: Final = 0.01  # share of max_intensity: for 255, about 1 for the scale [0, 1]
_MIN_DISTINCT: Final = 50  # distances and times in a cloud
_MAX_FALLS: Final = 0.02  # per rise of times, which restart in each ring; 1 in intensities
_DISTANCE_SHARE: Final = 1e-3  # largest error of a distance in place of an intensity
_DISTANCE_ROUNDING_M: Final = 0.02
_WHOLE_ROUNDING: Final = 2.0  # also for numbers that were cut off, which lowers the factor
_PERCENT: Final = 100.0
_BYTE: Final = 255.0
_USUAL_SCALES: Final = (1.0, _PERCENT, _BYTE, 1023.0, 4095.0, 65535.0)
"""Usual intensities of a reflectance of 1."""
_MIN_RINGS: Final = 4
_MAX_RING: Final = 1e6
_RING_SHARE: Final = 0.95  # of the variance of elevations that rings explain
_POINTS_A_RING: Final = 20  # enough points to avoid an explanation by chance
_MAX_RINGS: Final = 128
_MIN_EVEN_RINGS: Final = 8
_EVEN_SPREAD: Final = 0.5  # largest variation of the points in a ring; KITTI's sweeps have 0.23


def intensity_fault(
    points: Float[np.ndarray, "num_points 4"], max_intensity: float
) -> tuple[str, str] | None:
    """Check that finite points have intensities from 0 to max_intensity, and no ring numbers.

    One point in a hundred may be brighter, as retroreflectors are; none may be darker than 0.

    Returns:
        The problem, as the rest of a sentence, and the remedy; None if there is no fault.
    """
    intensities = points[:, 3]
    if intensities.max() > 1 and holds_rings(
        intensities, points, min_share=_RING_SHARE, points_a_ring=_POINTS_A_RING
    ):
        return (
            f"ring numbers ({intensities.min():.0f} to {intensities.max():.0f}, by elevation) "
            "instead of intensities",
            "give columns in the order x, y, z, intensity",
        )
    if intensities.min() < 0 or exceeds_scale(intensities > max_intensity):
        problem = (
            f"intensities from {intensities.min():.4g} to {intensities.max():.4g}, expected 0 to "
            f"{max_intensity:.6g}"
        )
        is_signed = (intensities == np.rint(intensities)).all() and intensities.min() >= _LEAST_BYTE
        if intensities.min() < 0 and is_signed and 1 < intensities.max() <= ~_LEAST_BYTE:
            return (
                f"{problem}: probably bytes of 0 to 255 that are declared as signed (int8)",
                "declare them as unsigned (uint8), or write zeros for an unknown intensity",
            )
        if intensities.min() < 0:
            return problem, (
                "write intensities from 0 on, or zeros, and columns in the order x, y, z, intensity"
            )
        if _are_evenly_spread(intensities):
            return (
                f"whole numbers from {intensities.min():.0f} to {intensities.max():.0f} "
                "instead of intensities, each about equally often: they look like ring numbers",
                "give columns in the order x, y, z, intensity, and zeros for an unknown intensity",
            )
        return problem, (
            "set max_intensity (import: --max-intensity) to the intensity of a reflectance of 1, "
            f"probably {_likely_scale(intensities):.6g}"
        )
    return None


def exceeds_scale(is_above: Bool[np.ndarray, " num_points"]) -> bool:
    """Check if more points are above a scale than retroreflectors are: one in a hundred."""
    return bool(len(is_above) and is_above.mean() > _BRIGHTER_SHARE)


def warn_of_intensities(points: Float[np.ndarray, "num_points 4"], max_intensity: float) -> None:
    """Warn about the doubts of `intensity_doubt`; all zeros mean that the cloud has none."""
    doubt = intensity_doubt(points, max_intensity)
    if doubt is not None and points[:, 3].any():
        problem, remedy = doubt
        warn_user(f"{problem}; {remedy}")


def intensity_doubt(
    points: Float[np.ndarray, "num_points 4"], max_intensity: float
) -> tuple[str, str] | None:
    """Find intensities that are distances or times, all equal, or far below max_intensity.

    Returns:
        The problem, a sentence about intensities, and the remedy; None if there is none, or fewer
        than a hundred points.
    """
    if len(points) < _MIN_POINTS_TO_WARN:
        return None
    intensities = points[:, 3]
    kind = (
        "are the points' distances from the LiDAR, times a constant"
        if _are_distances(points)
        else "only rise along the cloud or its rings: times, or a cloud that was sorted by them"
        if _are_times(intensities)
        else None
    )
    if kind is not None:
        return (
            f"intensities {kind}",
            "give columns in the order x, y, z, intensity, zeros for an unknown intensity, and "
            "points in the order of measurement",
        )
    darkest, brightest = float(intensities.min()), float(intensities.max())
    if darkest == brightest:
        return (
            f"all intensities are {brightest:.4g}, so reflectances carry no information, but "
            "detectors were trained with them",
            "give measured intensities, or zeros if there are none"
            if brightest
            else "give measured intensities if the LiDAR has them",
        )
    measured = intensities[intensities != 0]
    is_dark = not exceeds_scale(measured > _DARK_SHARE * max_intensity)
    if not math.isinf(max_intensity) and is_dark:
        return (
            f"intensities are below a hundredth of max_intensity, {max_intensity:.6g}, for 99 of "
            "100 measured ones, so reflectances are nearly 0",
            "scale them to reflectances from 0 to 1; where an import divided them, set its "
            "--max-intensity lower"
            if max_intensity == 1
            else "set max_intensity of the recording (import: --max-intensity) to the intensity of "
            "a reflectance of 1, or scale them; for intensities from 0 to 1 it is 1",
        )
    return None


def _are_distances(points: Float[np.ndarray, "num_points 4"]) -> bool:
    """Check if the fourth column is the distance from the LiDAR times a constant, also rounded."""
    for few in (points[:_MIN_POINTS_TO_WARN], points):  # the first are enough mostly
        values = few[:, 3].astype(np.float64)
        distance_m = np.linalg.norm(few[:, :3].astype(np.float64), axis=1)
        factor = float(values @ distance_m) / max(float(distance_m @ distance_m), 1e-9)
        tolerance = factor * (_DISTANCE_SHARE * distance_m + _DISTANCE_ROUNDING_M)
        if (values == np.rint(values)).all():
            tolerance += _WHOLE_ROUNDING
        if (np.abs(values - factor * distance_m) > tolerance).any():
            return False
    return len(np.unique(points[:, 3])) >= _MIN_DISTINCT


def _are_times(numbers: Float[np.ndarray, " num_points"]) -> bool:
    """Check if numbers only rise, in many steps, but for rare restarts, as in each ring."""
    steps = np.diff(numbers)
    num_rises = int(np.count_nonzero(steps > 0))
    num_falls = int(np.count_nonzero(steps < 0))
    return num_rises >= _MIN_DISTINCT and num_falls <= _MAX_FALLS * num_rises


def _likely_scale(intensities: Float[np.ndarray, " num_points"]) -> float:
    """Choose the smallest usual scale that a hundredth of the points exceed at most, or one above.

    Whole numbers beyond 100 that fit into a byte are bytes, however dark. Raw counts beyond all
    usual scales suggest the level that a hundredth of the points exceed.
    """
    if _PERCENT < intensities.max() <= _BYTE and (intensities == np.rint(intensities)).all():
        return _BYTE
    bright = float(np.quantile(intensities, 1 - _BRIGHTER_SHARE))
    return next((scale for scale in _USUAL_SCALES if bright <= scale), float(math.ceil(bright)))


def _are_evenly_spread(numbers: Float[np.ndarray, " num_points"]) -> bool:
    """Check whether numbers are 0 (or 1) to at most 128, each about as often, as rings are."""
    if (numbers != np.rint(numbers)).any() or numbers.min() > 1 or numbers.max() > _MAX_RINGS:
        return False
    counts = np.bincount(numbers.astype(np.int64))[int(numbers.min()) :]
    is_enough = len(counts) >= _MIN_EVEN_RINGS and counts.mean() >= _POINTS_A_RING
    return bool(is_enough and counts.all() and counts.std() < _EVEN_SPREAD * counts.mean())


def holds_rings(
    numbers: Shaped[np.ndarray, " num_points"],
    points: Float[np.ndarray, "num_points 4"],
    *,
    min_share: float,
    points_a_ring: int = 1,
) -> bool:
    """Check whether numbers are ring numbers: whole numbers that separate points by elevation.

    Args:
        numbers: One for each point.
        points: x, y, z first; points without an echo are ignored.
        min_share: Smallest share of the variance of elevations that rings explain, 0 to 1.
        points_a_ring: Smallest mean number of points in a ring.
    """
    has_echo = is_echo(points)
    chosen = numbers[has_echo].astype(np.float64)
    if not len(chosen) or not (np.abs(chosen) <= _MAX_RING).all():
        return False
    if (chosen != np.rint(chosen)).any():
        return False
    rings, ring_index = np.unique(chosen, return_inverse=True)
    if not _MIN_RINGS <= len(rings) <= min(_MAX_RINGS, len(chosen) / points_a_ring):
        return False
    x, y, z = points[has_echo, :3].astype(np.float64).T
    elevation = np.arctan2(z, np.hypot(x, y))
    within = elevation - (np.bincount(ring_index, elevation) / np.bincount(ring_index))[ring_index]
    whole = float(np.square(elevation - elevation.mean()).sum())
    return whole > 0 and 1 - float(np.square(within).sum()) / whole >= min_share


def reflectances(
    intensities: Float[np.ndarray, " num_points"], max_intensity: float
) -> Float[np.ndarray, " num_points"]:
    """Scale intensities to reflectances in [0, 1]; 1 for values above max_intensity."""
    return (intensities / max_intensity).clip(0, 1)

"""Checks of users' point clouds: usable points, and likely mistakes.

Without PyTorch, for checks that start at once.
"""

import math
import warnings
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Float64, Real, Shaped

from sightline.geometry.mount import MAX_RANGE_M

_MAX_COLUMNS: Final = 64
"""Largest number of columns in a row; drivers write up to about twenty fields for each point."""
_LEAST_BYTE = -128  # of eight bits with a sign
_BRIGHTER_SHARE: Final = 0.01  # of a sweep's points: retroreflectors exceed many scales

USUAL_LOSS: Final = 0.5
"""Share of points without an echo in a cloud that may include rays into the sky."""

_MIN_POINTS_TO_WARN: Final = 100
_DARK_SHARE: Final = 0.01  # share of max_intensity: for 255, about 1 for the scale [0, 1]
_MIN_DISTINCT: Final = 50  # distances and times in a cloud
_DISTANCE_SHARE: Final = 1e-3  # largest error of a distance in place of an intensity
_DISTANCE_ROUNDING_M: Final = 0.02
_WHOLE_ROUNDING: Final = 2.0  # also for numbers that were cut off, which lowers the factor
_MIN_POINTS: Final = 20
"""Smallest number of points to work with; the sparsest automotive radars have hundreds."""
_DISTINCT_SHARE: Final = 0.4
"""Smallest share of distinct positions; 0.9 or more on 213 real sweeps of three sensors."""
_MAX_NEAREST_M: Final = 30.0  # sweeps of a road begin before 10 m
_MIN_REACH_M: Final = 1.0
"""Smallest reach of a cloud in metres; every LiDAR on a road sees farther."""
_USUAL_SCALES: Final = (1.0, 100.0, 255.0, 1023.0, 4095.0, 65535.0)
"""Usual intensities of a reflectance of 1."""
_MAX_MEDIAN_CM: Final = 4000.0
"""Largest median range in centimetres; that of real sweeps is 6 to 18 m."""
_MAX_MEDIAN_MM: Final = 100_000.0
_MAX_NUMBER_M: Final = 1e9
"""Largest median range in any unit and frame: a map in nanometres would be beyond."""
_SHORT_BYTES: Final = 2
_MIN_RINGS: Final = 4
_MAX_RING: Final = 1e6
_RING_SHARE: Final = 0.95  # of the variance of elevations that rings explain
_POINTS_A_RING: Final = 20  # enough points to avoid an explanation by chance
_MAX_RINGS: Final = 128
_MIN_EVEN_RINGS: Final = 8
_EVEN_SPREAD: Final = 0.5  # largest variation of the points in a ring; KITTI's sweeps have 0.23


def as_point_rows(array: np.ndarray) -> Real[np.ndarray, "num_points columns"] | None:
    """Convert an array to rows of three or more numbers, an organised cloud row by row; else None.

    Also None for more than 64 points that are written column by column, 4 x num_points.
    """
    is_cloud = array.ndim >= 2 and 3 <= array.shape[-1] <= _MAX_COLUMNS
    if not is_cloud or array.dtype.kind not in "fiu":
        return None
    rows: Real[np.ndarray, "num_points columns"] = array.reshape(-1, array.shape[-1])
    return rows


def echoes(points: Float[np.ndarray, "num_points 4"]) -> Float[np.ndarray, "num_echoes 4"]:
    """Keep the points with an echo: x, y, z are finite and not all zero.

    For missing echoes, drivers write values that are not finite, the largest possible ones, or the
    sensor's own place. An intensity that is not finite becomes 0, as if there were none: `losses`
    counts both.
    """
    kept: Float[np.ndarray, "num_echoes 4"] = points[is_echo(points)]
    unusable = ~_is_finite(kept[:, 3])
    if unusable.any():
        kept[unusable, 3] = 0
    return kept


def losses(
    points: Float[np.ndarray, "num_points 4"], *, usual_share: float = USUAL_LOSS
) -> tuple[str, ...]:
    """List the unusual losses of `echoes`, each with counts, as the rest of a sentence.

    Points without an echo are usual, up to half of a cloud with rays into the sky; an intensity
    that is not finite is not.

    Args:
        points: x, y, z and intensity.
        usual_share: Share of points without an echo up to which their loss is not listed.
    """
    has_echo = is_echo(points)
    num_left = int(np.count_nonzero(has_echo))
    num_lost = len(points) - num_left
    messages = []
    if num_lost > usual_share * len(points):
        num_not_finite = np.count_nonzero(~_is_finite(points[:, :3]).all(axis=1))
        messages.append(
            f"{num_lost} of {len(points)} points are left out, {num_not_finite} with x, y, z not "
            f"finite and {num_lost - num_not_finite} at 0, 0, 0: "
            + (f"{num_left} are left" if num_left else "none is left, the cloud is empty")
        )
    num_without_intensity = np.count_nonzero(~_is_finite(points[has_echo, 3]))
    if num_without_intensity:
        messages.append(
            f"{num_without_intensity} of {num_left} points have an intensity that is not "
            "finite: it is set to 0"
        )
    return tuple(messages)


def warn_of_columns(num_columns: int, num_points: int) -> None:
    """Warn about missing or additional columns besides x, y, z and intensity.

    The message does not name a cloud: it appears once for all clouds with that number of columns.
    """
    if num_points and num_columns == 3:
        warnings.warn(
            "clouds have three columns, x, y, z: the reflectance of their points is set to 0; add "
            "intensities as the fourth column, or zeros if there are none",
            stacklevel=3,
        )
    elif num_points and num_columns > 4:
        warnings.warn(
            f"clouds have {num_columns} columns: the first four are read as x, y, z, intensity, "
            "the others are dropped; remove them, or write a .pcd, .ply or structured .npy, whose "
            "field ring is used",
            stacklevel=3,
        )


def warn_of_integers(dtype: np.dtype[Any], num_points: int) -> None:
    """Warn about coordinates of unsigned or short integers, in which metres are rounded or lost."""
    is_unsigned = dtype.kind == "u"
    if num_points and (is_unsigned or (dtype.kind == "i" and dtype.itemsize <= _SHORT_BYTES)):
        lost = ", and no place behind, right of or below the LiDAR is possible" * is_unsigned
        warnings.warn(
            f"clouds have x, y, z of type {dtype.name}: they are in whole metres{lost}; write them "
            "as float32",
            stacklevel=3,
        )


def warn_of_intensities(points: Float[np.ndarray, "num_points 4"], max_intensity: float) -> None:
    """Warn about the doubts of `intensity_doubt`; all zeros mean that the cloud has none."""
    doubt = intensity_doubt(points, max_intensity)
    if doubt is not None and points[:, 3].any():
        problem, remedy = doubt
        warnings.warn(f"{problem}; {remedy}", stacklevel=3)


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
        else "only rise along the cloud, as times of measurement do"
        if _are_times(intensities)
        else None
    )
    if kind is not None:
        return (
            f"intensities {kind}",
            "give columns in the order x, y, z, intensity, and zeros for an unknown intensity",
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
    if not math.isinf(max_intensity) and 0 < brightest <= _DARK_SHARE * max_intensity:
        return (
            f"intensities are below a hundredth of max_intensity, {max_intensity:.6g}, so "
            "reflectances are nearly 0",
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
    """Check if numbers only rise, and in many steps."""
    steps = np.diff(numbers)
    return bool((steps >= 0).all() and np.count_nonzero(steps) >= _MIN_DISTINCT)


def hollow_doubt(points: Float[np.ndarray, "num_points fields"]) -> tuple[str, str] | None:
    """Find a cloud of few points, few distinct positions, without height or within a metre.

    An empty cloud is no problem.

    Args:
        points: x, y, z first.

    Returns:
        The problem, as the rest of a sentence, and the remedy; None if there is none.
    """
    if not len(points):
        return None
    if len(points) < _MIN_POINTS:
        return (
            f"holds only {len(points)} points, expected thousands",
            "check the LiDAR's data and its conversion",
        )
    # One number per position: sorting rows takes ten times as long.
    places = points[:, :3].astype(np.float64) @ (1.0, math.pi * 1e3, math.e * 1e6)
    num_places = len(np.unique(places))
    if num_places >= _DISTINCT_SHARE * len(points):
        return shape_doubt(points[:, :3])
    place_count = "one place" if num_places == 1 else f"{num_places} places"
    return (
        f"holds {len(points)} points at only {place_count}",
        "check its conversion: points of a LiDAR have distinct positions",
    )


def shape_doubt(places: Float[np.ndarray, "num_points 3"]) -> tuple[str, str] | None:
    """Find a cloud that is flat, in whole metres, or all within a metre or all far away.

    Args:
        places: x, y, z of points.

    Returns:
        The problem, as the rest of a sentence, and the remedy; None if there is none, or fewer than
        a hundred points.
    """
    if len(places) < _MIN_POINTS_TO_WARN:
        return None
    low, high = places.min(axis=0), places.max(axis=0)
    flat = np.flatnonzero(low == high)
    if len(flat):
        axis, value = "xyz"[flat[0]], low[flat[0]] + 0.0  # -0 becomes 0
        return (
            f"holds {len(places)} points with {axis} = {value:.4g}: the cloud is flat",
            f"write the measured {axis}; a scan of a single plane shows no road and no objects",
        )
    reach_m = float(np.abs(places).max())
    if reach_m < _MIN_REACH_M:
        return (
            f"holds {len(places)} points within {reach_m:.4g} m of the LiDAR: they are probably in "
            "kilometres, or scaled to 1",
            "write x, y, z in metres",
        )
    nearest_m = math.sqrt(float(np.square(places.astype(np.float64)).sum(axis=1).min()))
    if nearest_m > _MAX_NEAREST_M:
        return (
            f"holds {len(places)} points, none nearer than {nearest_m:.4g} m: they are perhaps in "
            "decimetres or another unit",
            "write x, y, z in metres",
        )
    if not (places[:100] % 1).any() and not (places % 1).any():  # the first are enough mostly
        return (
            f"holds {len(places)} points at whole metres: their coordinates were rounded",
            "write x, y, z in metres, with decimals",
        )
    return None


def warn_of_losses(
    points: Float[np.ndarray, "num_points 4"], source: str, *, usual_share: float = USUAL_LOSS
) -> None:
    """Warn about the losses of `losses`, with the name of the cloud's file or topic."""
    for loss in losses(points, usual_share=usual_share):
        warnings.warn(f"{source}: {loss}", stacklevel=3)


def is_echo(points: Float[np.ndarray, "num_points fields"]) -> Bool[np.ndarray, " num_points"]:
    """Mask of the points with an echo: x, y, z, the first fields, are finite and not all zero."""
    places = points[:, :3]
    has_echo = np.logical_and(_is_finite(places).all(axis=1), places.any(axis=1))
    return np.asarray(has_echo)


def _is_finite(values: Float[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
    with np.errstate(over="ignore"):  # values beyond float32, a sweep's type, become infinite
        return np.isfinite(values.astype(np.float32))


def _counts_rows(column: Float[np.ndarray, " num_points"]) -> bool:
    """Test a column of a point cloud for row numbers: rising whole numbers, perhaps with gaps."""
    return bool((np.diff(column) >= 1).all() and (column == np.floor(column)).all())


def cloud_fault(
    points: Float[np.ndarray, "num_points 4"], max_intensity: float
) -> tuple[str, str] | None:
    """Check that finite points form a cloud in metres with intensities from 0 to max_intensity.

    Ring numbers are no intensities. One point in a hundred may be brighter, as retroreflectors are;
    none may be darker than 0.

    Returns:
        The problem, as the rest of a sentence, and the remedy; None if there is no fault.
    """
    if not len(points):
        return None
    if len(points) >= _MIN_POINTS_TO_WARN and _counts_rows(points[:, 0]):
        first = ", ".join(f"{each:.0f}" for each in points[:3, 0])
        return (
            f"a first column of {first}, .. that counts its rows",
            "leave it out: give columns in the order x, y, z, intensity",
        )
    far = _range_fault(points[:, :3].astype(np.float64))
    if far is not None:
        return far
    intensities = points[:, 3]
    if intensities.max() > 1 and holds_rings(
        intensities, points, min_share=_RING_SHARE, points_a_ring=_POINTS_A_RING
    ):
        return (
            f"ring numbers ({intensities.min():.0f} to {intensities.max():.0f}, by elevation) "
            "instead of intensities",
            "give columns in the order x, y, z, intensity",
        )
    if intensities.min() < 0 or (intensities > max_intensity).mean() > _BRIGHTER_SHARE:
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


def _likely_scale(intensities: Float[np.ndarray, " num_points"]) -> float:
    """Choose the smallest usual scale that a hundredth of the points exceed at most, or one above.

    Raw counts beyond all usual scales suggest the level that a hundredth of the points exceed.
    """
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


def _range_fault(places: Float64[np.ndarray, "num_points 3"]) -> tuple[str, str] | None:
    """Problem and remedy of points mostly out of a sensor's range; None if there is none."""
    middle_m = float(np.median(np.linalg.norm(places, axis=1)))
    if middle_m <= MAX_RANGE_M:
        return None
    problem = (
        f"{len(places)} points, half of them farther away than {middle_m:.4g} m, expected up to "
        f"{MAX_RANGE_M:.0f} m"
    )
    if middle_m > _MAX_NUMBER_M:
        return (
            f"{problem}: these are no coordinates, but bytes in the wrong order or of other fields",
            "correct the byte order (is_bigendian of PointCloud2) or the fields' offsets and types",
        )
    spread_m = float(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
    if spread_m <= MAX_RANGE_M:
        return (
            f"{problem}: they lie together, half of them within {spread_m:.4g} m, but far from the "
            "LiDAR, so they are probably in a map's or world's frame",
            "move them into the LiDAR's own frame (subtract its position and undo its rotation)",
        )
    if middle_m > _MAX_MEDIAN_MM:
        return f"{problem}: they are in another unit", "write them in metres"
    unit, factor = ("centimetres", 100) if middle_m <= _MAX_MEDIAN_CM else ("millimetres", 1000)
    return f"{problem}: they are probably in {unit}", f"write them in metres, divided by {factor}"


def reflectances(
    intensities: Float[np.ndarray, " num_points"], max_intensity: float
) -> Float[np.ndarray, " num_points"]:
    """Scale intensities to reflectances in [0, 1]; 1 for values above max_intensity."""
    return (intensities / max_intensity).clip(0, 1)

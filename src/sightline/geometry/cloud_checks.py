"""Checks of users' point clouds: layout, units, shape, and likely mistakes in them.

Without PyTorch, for checks that start at once.
"""

import math
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float64, Real

from sightline.geometry.intensity_checks import intensity_fault
from sightline.geometry.mount import MAX_RANGE_M
from sightline.geometry.user_warning import warn_user

_MAX_COLUMNS: Final = 64
"""Largest number of columns in a row; drivers write up to about twenty fields for each point."""
_MIN_POINTS_TO_WARN: Final = 100
_MIN_POINTS: Final = 20
"""Smallest number of points to work with; the sparsest automotive radars have hundreds."""
_DISTINCT_SHARE: Final = 0.4
"""Smallest share of distinct positions; 0.9 or more on 213 real sweeps of three sensors."""
_MAX_NEAREST_M: Final = 30.0  # sweeps of a road begin before 10 m
_MAX_SPREAD_M: Final = 40.0
"""Largest median distance from the centre of a sweep in metres; real ones have 3 to 13 m, those of
which no point is nearer than 30 m in decimetres 56 m or more."""
_WORLD_REMEDY: Final = (
    "take clouds in the LiDAR's own frame, or move them there (subtract its position and undo its "
    "rotation)"
)
_MIN_REACH_M: Final = 1.0
"""Smallest reach of a cloud in metres; every LiDAR on a road sees farther."""
_MAX_MEDIAN_CM: Final = 4000.0
"""Largest median range in centimetres; that of real sweeps is 6 to 18 m."""
_MAX_MEDIAN_MM: Final = 100_000.0
_MAX_NUMBER_M: Final = 1e11
"""Largest median range in any unit and frame: coordinates of UTM in millimetres have 5e9."""
_SHORT_BYTES: Final = 2


def as_point_rows(array: np.ndarray) -> Real[np.ndarray, "num_points columns"] | None:
    """Convert an array to rows of three or more numbers, an organised cloud row by row; else None.

    Also None for more than 64 points that are written column by column, 4 x num_points.
    """
    is_cloud = array.ndim >= 2 and 3 <= array.shape[-1] <= _MAX_COLUMNS
    if not is_cloud or array.dtype.kind not in "fiu":
        return None
    rows: Real[np.ndarray, "num_points columns"] = array.reshape(-1, array.shape[-1])
    return rows


def warn_of_columns(num_columns: int, num_points: int) -> None:
    """Warn about missing or additional columns besides x, y, z and intensity.

    The message does not name a cloud: it appears once for all clouds with that number of columns.
    """
    if num_points and num_columns == 3:
        warn_user(
            "clouds have three columns, x, y, z: the reflectance of their points is set to 0; add "
            "intensities as the fourth column, or zeros if there are none",
        )
    elif num_points and num_columns > 4:
        warn_user(
            f"clouds have {num_columns} columns: the first four are read as x, y, z, intensity, "
            "the others are dropped; remove them, or write a .pcd, .ply or structured .npy, whose "
            "field ring is used",
        )


def warn_of_integers(dtype: np.dtype[Any], num_points: int) -> None:
    """Warn about coordinates of unsigned or short integers, in which metres are rounded or lost."""
    is_unsigned = dtype.kind == "u"
    if num_points and (is_unsigned or (dtype.kind == "i" and dtype.itemsize <= _SHORT_BYTES)):
        lost = ", and no place behind, right of or below the LiDAR is possible" * is_unsigned
        warn_user(
            f"clouds have x, y, z of type {dtype.name}: they are in whole metres{lost}; write them "
            "as float32",
        )


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
        problem = f"holds {len(places)} points, none nearer than {nearest_m:.4g} m"
        centre_m, spread_m = _centre_and_spread_m(places.astype(np.float64))
        if spread_m < min(centre_m, _MAX_SPREAD_M):
            return (
                f"{problem}, half of them within {spread_m:.4g} m of their centre: they are "
                "probably in a map's or world's frame",
                _WORLD_REMEDY,
            )
        return (
            f"{problem}: they are perhaps in decimetres or another unit",
            "write x, y, z in metres",
        )
    if not (places[:100] % 1).any() and not (places % 1).any():  # the first are enough mostly
        return (
            f"holds {len(places)} points at whole metres: their coordinates were rounded",
            "write x, y, z in metres, with decimals",
        )
    return None


def _counts_rows(column: Float[np.ndarray, " num_points"]) -> bool:
    """Test a column of a point cloud for row numbers: rising whole numbers, perhaps with gaps."""
    with np.errstate(over="ignore"):  # of absurd values, which are no row numbers
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
    return intensity_fault(points, max_intensity)


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
    _, spread_m = _centre_and_spread_m(places)
    if spread_m <= MAX_RANGE_M:
        return (
            f"{problem}: they lie together, half of them within {spread_m:.4g} m, but far from the "
            "LiDAR, so they are probably in a map's or world's frame",
            _WORLD_REMEDY,
        )
    if middle_m > _MAX_MEDIAN_MM:
        return f"{problem}: they are in another unit", "write them in metres"
    unit, factor = ("centimetres", 100) if middle_m <= _MAX_MEDIAN_CM else ("millimetres", 1000)
    return f"{problem}: they are probably in {unit}", f"write them in metres, divided by {factor}"


def _centre_and_spread_m(places: Float64[np.ndarray, "num_points 3"]) -> tuple[float, float]:
    """Distance of the median place from the origin, and median distance of the places from it."""
    centre = np.median(places, axis=0)
    spread_m = np.median(np.linalg.norm(places - centre, axis=1))
    return float(np.linalg.norm(centre)), float(spread_m)

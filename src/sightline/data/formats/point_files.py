"""Reader of point clouds of recordings: .npy, .pcd, .ply and KITTI's .bin."""

import io
import math
import stat
import warnings
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.formats.point_formats import read_pcd, read_ply
from sightline.data.formats.point_rows import (
    INTENSITY_NAMES,
    MAX_BYTES,
    REMEDY,
    RING_NAMES,
    plain_name,
    warn_of_repeated,
)
from sightline.data.formats.rings import in_kitti_order
from sightline.data.formats.velodyne import sweep_rows
from sightline.files.plain_file import read_bytes
from sightline.files.problem import FileError
from sightline.geometry.cloud_batches import is_batch_of_clouds
from sightline.geometry.cloud_checks import (
    as_point_rows,
    cloud_fault,
    warn_of_columns,
    warn_of_integers,
)
from sightline.geometry.echoes import echoes, warn_of_losses
from sightline.geometry.intensity_checks import reflectances
from sightline.geometry.user_warning import warn_user

CLOUD_SUFFIXES: Final = (".bin", ".npy", ".pcd", ".ply")
"""Suffixes of the files for `read_cloud`, in any case."""
_ZIP_MARK: Final = b"PK"
_MAX_EMPTY_BYTES: Final = 2048  # longer files hold points beside their header


def read_cloud(path: Path | str, max_intensity: float = 1.0) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z [m] (LiDAR frame) and reflectance [0, 1].

    `.bin`: float32 x, y, z, intensity as in KITTI. `.npy`: rows of at least three numbers, the
    fourth is the intensity, or a structured array with the field names of a PCD file. `.pcd`, and
    vertices of a `.ply`: fields x, y, z and optionally intensity (`columns_of`). Without an
    intensity, reflectance is 0, with a warning. Points keep the order of the file; if a field
    contains their rings (`RING_NAMES`), they are sorted by ring as in KITTI's files
    (`in_kitti_order`).

    Points without an echo (x, y, z not finite or all zero) are left out, with a warning if they are
    most of the cloud. Non-finite intensities become 0, with a warning. Intensities above
    max_intensity, such as of retroreflectors, become 1. Doubtful ones are found when a recording is
    opened or checked (`intensity_doubt`).

    Args:
        path: The file.
        max_intensity: Intensity of a reflectance of 1.

    Raises:
        FileError: The file cannot be read or is truncated, lacks a coordinate, is not in metres, or
            an intensity is negative, or more than one in a hundred is above max_intensity.
    """
    return checked_cloud(cloud_rows(path), max_intensity, path)


def cloud_rows(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z and intensity (0 if missing) unchanged, including points without an echo.

    Raises:
        FileError: The file cannot be read or is truncated, or lacks a coordinate.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".bin":
        return sweep_rows(path)
    if suffix == ".npy":
        return _read_npy(path)
    return columns_of(read_ply(path) if suffix == ".ply" else read_pcd(path), path)


def holds_no_point(path: Path) -> bool:
    """Whether a point cloud file is sound but has no points; long files are not read."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > _MAX_EMPTY_BYTES:
            return False
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its reader warns when the frame is read
            return not len(cloud_rows(path))
    except (FileError, OSError):
        return False


def checked_cloud(
    points: Float32[np.ndarray, "num_points 4"],
    max_intensity: float,
    source: Path | str,
    *,
    warn_losses: bool = True,
) -> Float32[np.ndarray, "num_echoes 4"]:
    """Select points with an echo, with reflectances in [0, 1]; warns of unusual losses.

    Raises:
        FileError: Points are not in metres, or intensities do not fit the scale (`cloud_fault`);
            names `source`, a file or a topic.
    """
    if warn_losses:
        warn_of_losses(points, str(source))
    points = echoes(points)
    fault = cloud_fault(points, max_intensity)
    if fault is not None:
        problem, remedy = fault
        raise FileError(source, f"holds {problem}", remedy)
    points[:, 3] = reflectances(points[:, 3], max_intensity)
    return points


def columns_of(fields: np.ndarray, source: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z and intensity (0 if missing) from a structured array by its field names.

    The intensity is the first existing field of `INTENSITY_NAMES` with one number per point and not
    only zeros; a warning is given if there are several or none. If there is a field of ring
    numbers, points are sorted by it.

    Raises:
        FileError: A coordinate is missing, or a field does not have one number per point; names
            `source`.
    """
    names = fields.dtype.names or ()
    warn_of_repeated(names)
    by_plain_name = {plain_name(name): name for name in reversed(names)}
    by_plain_name |= {name: name for name in names if name == plain_name(name)}
    missing = [name for name in ("x", "y", "z") if name not in by_plain_name]
    if missing:
        raise FileError(
            source,
            f"has the fields {', '.join(names)[:400] or 'none'}, but not {', '.join(missing)}",
            REMEDY,
        )
    points = np.zeros((fields.size, 4), np.float32)
    for column, name in enumerate(("x", "y", "z")):
        points[:, column] = _values(fields, by_plain_name[name], source)
    warn_of_integers(fields.dtype[by_plain_name["x"]], fields.size)
    intensity_fields = [by_plain_name[name] for name in INTENSITY_NAMES if name in by_plain_name]
    for name in _chosen_intensity(fields, intensity_fields):
        points[:, 3] = _values(fields, name, source)
    for name in RING_NAMES:
        ring = by_plain_name.get(name)
        if ring is not None and _has_one_number_per_point(fields, ring):
            return in_kitti_order(points, fields[ring].ravel())
    return points


def _values(
    fields: np.ndarray, name: str, source: Path | str
) -> Float32[np.ndarray, " num_points"]:
    """Read one number per point; infinite if beyond float32: such points are left out."""
    if not _has_one_number_per_point(fields, name):
        kind = str(fields.dtype[name])[:40]
        problem = f"has the field {name} of {kind}, expected one number per point"
        raise FileError(source, problem, REMEDY)
    with np.errstate(over="ignore"):
        return fields[name].ravel().astype(np.float32)


def _chosen_intensity(fields: np.ndarray, names: list[str]) -> list[str]:
    """Select the first field with usable intensities, in a list; empty: there is none."""
    if not names and fields.size:
        listed = ", ".join(fields.dtype.names or ())[:200]
        warnings.warn(  # without the file's name: one warning for all clouds with these fields
            f"clouds have no intensity field among {listed}: the reflectance of their points is 0; "
            "name the field intensity, or add a field of zeros if there is none",
            stacklevel=1,
        )
    if len(names) < 2:
        return names
    numeric = [name for name in names if _has_one_number_per_point(fields, name)]
    non_zero = [name for name in numeric if np.any(np.isfinite(fields[name]) & (fields[name] != 0))]
    chosen = (non_zero or numeric or names)[0]
    others = ", ".join(name for name in names if name != chosen)
    warnings.warn(  # without the file's name: one warning for all clouds with these fields
        f"clouds have several intensity fields: {chosen} is used, not {others}; remove {chosen} "
        "from the clouds to use another",
        stacklevel=1,
    )
    return [chosen]


def _has_one_number_per_point(fields: np.ndarray, name: str) -> bool:
    return fields[name].shape == fields.shape and fields.dtype[name].kind in "fiu"


def _read_npy(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    array = _npy_array(read_bytes(path, max_bytes=MAX_BYTES, remedy=REMEDY), path)
    if array.dtype.names:
        return columns_of(array, path)
    rows = as_point_rows(array)
    if rows is None:
        raise FileError(
            path,
            f"holds {array.dtype} of shape {array.shape}, expected rows of x, y, z (, intensity), "
            "one per point",
            REMEDY,
        )
    if is_batch_of_clouds(array):
        raise FileError(
            path,
            f"holds {len(array)} clouds by its shape {array.shape}, expected one",
            f"write one file for each, or .reshape(-1, {rows.shape[1]}) if they are parts of one "
            "sweep",
        )
    warn_of_columns(rows.shape[1], len(rows))
    warn_of_integers(rows.dtype, len(rows))
    points = np.zeros((len(rows), 4), np.float32)
    with np.errstate(over="ignore"):  # overflow becomes infinite, and is left out
        points[:, : min(rows.shape[1], 4)] = rows[:, :4]
    return points


def _npy_array(content: bytes, path: Path | str) -> np.ndarray:
    """Read the array of a .npy file as a view of its bytes, so that its header allocates nothing.

    Not with `np.load`, which also accepts archives of arrays.
    """
    file = io.BytesIO(content)
    try:
        major = np.lib.format.read_magic(file)[0]
        read = np.lib.format.read_array_header_1_0
        if major > 1:  # version 3 differs from 2 in the names of fields that are not ASCII alone
            read = np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = read(file)
    except Exception as error:  # of the library, of any type
        if content.startswith(_ZIP_MARK):
            problem = "is an archive of arrays (.npz), expected one array"
            raise FileError(path, problem, "write the cloud by numpy.save") from error
        raise FileError(path, "is no whole .npy file", REMEDY) from error
    if dtype.hasobject:
        raise FileError(path, "is no .npy file of numbers: it holds Python objects", REMEDY)
    count, start = math.prod(shape), file.tell()
    num_bytes_left = len(content) - start
    if min(shape, default=0) < 0 or not dtype.itemsize or count * dtype.itemsize > num_bytes_left:
        raise FileError(
            path,
            f"is no whole .npy file: {num_bytes_left} bytes follow its header, expected "
            f"{str(dtype)[:99]} of shape {str(shape)[:99]}",
            REMEDY,
        )
    if num_more := num_bytes_left - count * dtype.itemsize:
        warn_user(
            f"{path}: {num_more} bytes follow the array of shape {shape}: they are left out; write "
            "one array per file, with all points",
        )
    if not count:
        return np.zeros(shape, dtype)
    array = np.frombuffer(content, dtype, count, start)
    return array.reshape(shape, order="F" if is_fortran else "C")

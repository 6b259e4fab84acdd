"""Point clouds of recordings that are not KITTI's: .npy, .pcd, .ply and KITTI's own .bin."""

import io
import math
import warnings
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.plain_file import read_bytes
from sightline.data.point_formats import (
    INTENSITY_NAMES,
    MAX_BYTES,
    REMEDY,
    plain_name,
    read_pcd,
    read_ply,
)
from sightline.data.problem import FileError
from sightline.data.velodyne import sweep_rows
from sightline.geometry.cloud_checks import (
    cloud_fault,
    echoes,
    reflectances,
    rows_of,
    warn_of_losses,
)

CLOUD_SUFFIXES: Final = (".bin", ".npy", ".pcd", ".ply")
"""Endings of the files that `read_cloud` reads; capitals count as well."""


def read_cloud(path: Path | str, max_intensity: float = 1.0) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z [m] (LiDAR frame) and reflectance [0, 1].

    `.bin`: float32 x, y, z, intensity as KITTI has it. `.npy`: rows of three numbers or more, the
    fourth of which is the intensity, or a structured array with the names of a PCD's fields.
    `.pcd`, and vertices of a `.ply`: with fields x, y, z and perhaps intensity (`columns_of`).
    Without one, reflectance is 0. Organised clouds are read row by row.

    Points whose x, y, z are not finite or all zero, which drivers write where no echo came back,
    are left out, with a warning where they are most of the cloud; an intensity that is not finite
    becomes 0, with a warning. What is brighter than max_intensity, as retroreflectors are, gets 1.

    Args:
        path: The file.
        max_intensity: What stands for a reflectance of 1.

    Raises:
        FileError: The file cannot be read or is cut short, lacks a coordinate, is not in metres, or
            an intensity is negative, or more than one in a hundred above max_intensity.
    """
    return checked_cloud(cloud_rows(path), max_intensity, path)


def cloud_rows(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z and intensity of every row that a file holds, whether it is a point or not.

    Raises:
        FileError: The file cannot be read or is cut short, or lacks a coordinate.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".bin":
        return sweep_rows(path)
    if suffix == ".npy":
        return _read_npy(path)
    if suffix == ".ply":
        return columns_of(read_ply(path), path)
    return columns_of(read_pcd(path), path)


def checked_cloud(
    points: Float32[np.ndarray, "num_points 4"], max_intensity: float, source: Path | str
) -> Float32[np.ndarray, "num_echoes 4"]:
    """Points that an echo made, with reflectances in [0, 1]; warns of losses beyond the usual.

    Raises:
        FileError: Points are not in metres, or intensities are not on this scale (`cloud_fault`);
            names `source`, a file or a topic.
    """
    warn_of_losses(points, str(source))
    points = echoes(points)
    fault = cloud_fault(points, max_intensity)
    if fault is not None:
        problem, remedy = fault
        raise FileError(source, f"holds {problem}", remedy)
    points[:, 3] = reflectances(points[:, 3], max_intensity)
    return points


def columns_of(fields: np.ndarray, source: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z and intensity (else 0) from a structured array, by the names of its fields.

    The intensity is the first of `INTENSITY_NAMES` that is there, holds one number a point and not
    zeros alone; where there is a choice, a warning says which was taken.

    Raises:
        FileError: It lacks a coordinate, or a field holds something else than one number a point;
            names `source`.
    """
    names = fields.dtype.names or ()
    by_plain_name = {plain_name(name): name for name in reversed(names)}
    lacking = [name for name in ("x", "y", "z") if name not in by_plain_name]
    if lacking:
        raise FileError(
            source,
            f"has the fields {', '.join(names)[:400] or 'none'}, and lacks {', '.join(lacking)}",
            REMEDY,
        )
    bright = [by_plain_name[name] for name in INTENSITY_NAMES if name in by_plain_name]
    points = np.zeros((fields.size, 4), np.float32)
    chosen = [by_plain_name["x"], by_plain_name["y"], by_plain_name["z"]]
    for column, name in enumerate((*chosen, *_chosen_intensity(fields, bright))):
        if not _is_number_a_point(fields, name):
            raise FileError(
                source,
                f"has the field {name} of {str(fields.dtype[name])[:40]}, expected one number a "
                "point",
                REMEDY,
            )
        with np.errstate(over="ignore"):  # becomes infinite, and is left out
            points[:, column] = fields[name].ravel()
    return points


def _chosen_intensity(fields: np.ndarray, names: list[str]) -> list[str]:
    """The first of some fields that tells brightness, in a list; none of none."""
    if len(names) < 2:
        return names
    numbers = [name for name in names if _is_number_a_point(fields, name)]
    telling = [name for name in numbers if np.any(np.isfinite(fields[name]) & (fields[name] != 0))]
    chosen = (telling or numbers or names)[0]
    others = ", ".join(name for name in names if name != chosen)
    warnings.warn(  # without the cloud's name: said once, of all that have these fields
        f"clouds have several fields of brightness: {chosen} is taken for intensity, not {others}; "
        "remove it from the clouds to have another",
        stacklevel=3,
    )
    return [chosen]


def _is_number_a_point(fields: np.ndarray, name: str) -> bool:
    return fields[name].shape == fields.shape and fields.dtype[name].kind in "fiu"


def _read_npy(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    array = _npy_array(read_bytes(path, max_bytes=MAX_BYTES, remedy=REMEDY), path)
    if array.dtype.names:
        return columns_of(array, path)
    rows = rows_of(array)
    if rows is None:
        raise FileError(
            path,
            f"holds {array.dtype} of shape {array.shape}, expected rows of x, y, z (, intensity), "
            "one a point",
            REMEDY,
        )
    points = np.zeros((len(rows), 4), np.float32)
    with np.errstate(over="ignore"):  # becomes infinite, and is left out
        points[:, : min(rows.shape[1], 4)] = rows[:, :4]
    return points


def _npy_array(content: bytes, path: Path | str) -> np.ndarray:
    """The array of a .npy file, a view of its bytes: its header alone can allot no memory.

    Not by `np.load`, which takes archives of arrays, too.
    """
    file = io.BytesIO(content)
    try:
        major = np.lib.format.read_magic(file)[0]
        read = np.lib.format.read_array_header_1_0
        if major > 1:  # version 3 differs from 2 in the names of fields that are not ASCII alone
            read = np.lib.format.read_array_header_2_0
        shape, is_fortran, dtype = read(file)
    except Exception as error:  # of the library, of any type
        raise FileError(path, "is no whole .npy file", REMEDY) from error
    if dtype.hasobject:
        raise FileError(path, "is no .npy file of numbers: it holds Python objects", REMEDY)
    count, start = math.prod(shape), file.tell()
    left = len(content) - start
    if min(shape, default=0) < 0 or not dtype.itemsize or count * dtype.itemsize > left:
        raise FileError(
            path,
            f"is no whole .npy file: {left} bytes follow its header, expected "
            f"{str(dtype)[:99]} of shape {str(shape)[:99]}",
            REMEDY,
        )
    if not count:
        return np.zeros(shape, dtype)
    array = np.frombuffer(content, dtype, count, start)
    return array.reshape(shape, order="F" if is_fortran else "C")

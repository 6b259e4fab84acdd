"""Point clouds of recordings that are not KITTI's: .npy, .pcd and KITTI's own .bin."""

import io
import struct
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.plain_file import read_bytes
from sightline.data.problem import FileError
from sightline.data.velodyne import read_sweep
from sightline.geometry.cloud_checks import cloud_fault, echoes, reflectances, rows_of

CLOUD_SUFFIXES: Final = (".bin", ".npy", ".pcd")
"""File names that a cloud may end in."""

INTENSITY_NAMES: Final = ("intensity", "reflectance", "reflectivity", "intensities", "i")
"""What the field is called that says how bright an echo is, the first that is there."""

_MAX_BYTES = 2**28  # 4 million points of 64 bytes
_REMEDY = "export the cloud again, with fields x, y, z [m] and intensity"
_COMPRESSED = b"\nDATA binary_compressed"


def read_cloud(path: Path | str, max_intensity: float = 1.0) -> Float32[np.ndarray, "num_points 4"]:
    """Reads x, y, z [m] (LiDAR frame) and reflectance [0, 1].

    `.bin`: float32 x, y, z, intensity as KITTI has it. `.npy`: rows of three numbers or more, the
    fourth of which is the intensity, or a structured array with the names of a PCD's fields.
    `.pcd`: with fields x, y, z and perhaps intensity. Without one, reflectance is 0. Organised
    clouds are read row by row.

    Points that are not finite or lie at the LiDAR's origin, which drivers write where no echo came
    back, are left out. What is brighter than max_intensity, as retroreflectors are, gets 1.

    Args:
        path: The file.
        max_intensity: What stands for a reflectance of 1.

    Raises:
        FileError: The file cannot be read or is cut short, lacks a coordinate, is not in metres, or
            an intensity is negative, or more than one in a hundred above max_intensity.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".bin":
        points = read_sweep(path, drop_non_finite=True)
    elif suffix == ".npy":
        points = _read_npy(path)
    else:
        points = _read_pcd(path)
    return checked_cloud(points, max_intensity, path)


def checked_cloud(
    points: Float32[np.ndarray, "num_points 4"], max_intensity: float, source: Path | str
) -> Float32[np.ndarray, "num_echoes 4"]:
    """The points that an echo made, with reflectances in [0, 1].

    Raises:
        FileError: Points are not in metres, or intensities are not on this scale (`cloud_fault`);
            names `source`, a file or a topic.
    """
    points = echoes(points)
    fault = cloud_fault(points, max_intensity)
    if fault is not None:
        problem, remedy = fault
        raise FileError(source, f"holds {problem}", remedy)
    points[:, 3] = reflectances(points[:, 3], max_intensity)
    return points


def columns_of(fields: np.ndarray, source: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    """x, y, z and intensity (else 0) of a structured array.

    Raises:
        FileError: It lacks a coordinate, or a field holds something else than one number a point;
            names `source`.
    """
    names = fields.dtype.names or ()
    by_lower = {name.lower(): name for name in names}
    lacking = [name for name in ("x", "y", "z") if name not in by_lower]
    if lacking:
        raise FileError(
            source,
            f"has the fields {', '.join(names) or 'none'}, and lacks {', '.join(lacking)}",
            _REMEDY,
        )
    intensity = [name for name in INTENSITY_NAMES if name in by_lower][:1]
    points = np.zeros((fields.size, 4), np.float32)
    for column, name in enumerate(("x", "y", "z", *intensity)):
        values = fields[by_lower[name]]
        if values.shape != fields.shape or values.dtype.kind not in "fiu":
            raise FileError(
                source,
                f"has the field {by_lower[name]} of {fields.dtype[by_lower[name]]}, expected one "
                "number a point",
                _REMEDY,
            )
        with np.errstate(over="ignore"):  # becomes infinite, and is left out
            points[:, column] = values.ravel()
    return points


def _read_npy(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    try:
        # Not `np.load`, which takes archives of arrays, too.
        array = np.lib.format.read_array(io.BytesIO(content), allow_pickle=False)
    except Exception as error:
        raise FileError(path, "is no whole .npy file", _REMEDY) from error
    if array.dtype.names:
        return columns_of(array, path)
    rows = rows_of(array)
    if rows is None:
        raise FileError(
            path,
            f"holds {array.dtype} of shape {array.shape}, expected rows of x, y, z (, intensity), "
            "one a point",
            _REMEDY,
        )
    points = np.zeros((len(rows), 4), np.float32)
    with np.errstate(over="ignore"):  # becomes infinite, and is left out
        points[:, : min(rows.shape[1], 4)] = rows[:, :4]
    return points


def _read_pcd(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    from pypcd4.pypcd4 import PointCloud  # with pydantic, whose import takes a moment

    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    _check_announced_size(content, path)
    try:
        cloud = PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(content)))
    except Exception as error:
        raise FileError(path, "is no whole PCD file", _REMEDY) from error
    fields, announced = np.atleast_1d(cloud.pc_data), cloud.metadata.points
    if fields.size != announced:  # the library takes what there is
        problem = f"holds {fields.size} of the {announced} points that it announces"
        raise FileError(path, f"{problem}: it is cut short", _REMEDY)
    return columns_of(fields, path)


def _check_announced_size(content: bytes, path: Path | str) -> None:
    """A forged header must not cost gigabytes of memory."""
    start = content.find(_COMPRESSED, 0, 4096)
    body = content.find(b"\n", start + 1) + 1
    if start < 0 or body + 8 > len(content):
        return
    _, size = struct.unpack_from("<II", content, body)
    if size > _MAX_BYTES:
        raise FileError(path, f"announces {size} bytes, expected up to {_MAX_BYTES}", _REMEDY)

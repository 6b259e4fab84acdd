"""Reader and writer of KITTI's LiDAR sweeps: float32 x, y, z, reflectance, nothing else."""

import re
import warnings
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32
from numpy.typing import ArrayLike

from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_file import read_bytes, read_start
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, Problem
from sightline.geometry.cloud_checks import cloud_fault, hollow_doubt
from sightline.geometry.cloud_layouts import is_big_endian, other_layout
from sightline.geometry.echoes import echoes, is_echo, warn_of_losses
from sightline.geometry.intensity_checks import intensity_doubt
from sightline.geometry.plain_arrays import shaped_array
from sightline.geometry.user_warning import warn_user

_POINT_BYTES = 16
_MAX_BYTES = 2**26  # 4 million points: sixteen turns of the densest automotive LiDAR
_REMEDY = "copy the file again (KITTI's: out of the velodyne archive)"
COLUMNS: Final = {
    3: "three columns (x, y, z)",
    4: "four columns",
    5: "five columns (ring or time)",
    6: "six columns (ring and time)",
    7: "seven columns",
    8: "eight columns",
    12: "twelve columns",
    16: "sixteen columns",
}
"""Descriptions of the columns by their number in files of raw floats."""
_TEXT: Final = re.compile(rb"[\t\n\r -~]{64,}")
_START_BYTES: Final = 256 * _POINT_BYTES
_TEXT_BYTES: Final = 4096  # read as text; numbers have other bytes by then
_OTHER_FORMATS = {
    b"# .PCD": "PCD",
    b"VERSION": "PCD",
    b"\x93NUMPY": "NPY",
    b"ply\n": "PLY",
    b"ply\r": "PLY",
}


def read_sweep(
    path: Path | str, *, drop_non_finite: bool = False
) -> Float32[np.ndarray, "num_points 4"]:
    """Read x, y, z [m] (LiDAR frame) and reflectance [0, 1]; an empty file is an empty sweep.

    Points within 1 mm of the origin, which some drivers write without an echo, are left out; warns
    if these are more than half. KITTI's own sweeps have none.

    Args:
        path: A `.bin` file of little-endian float32 values.
        drop_non_finite: Instead of refusing the file, leave out points with non-finite x, y or z,
            which some drivers write without an echo, and replace non-finite reflectances by 0;
            warns of their numbers.

    Raises:
        FileError: The file cannot be read (see `sweep_rows`), or contains NaN or infinite values.
    """
    points = sweep_rows(path)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        if not drop_non_finite:
            raise FileError(
                path,
                f"holds {np.count_nonzero(~finite)} points with NaN or infinite values, the first "
                f"is point {np.argmin(finite)} of {len(points)} (from 0)",
                f"remove them or {_REMEDY}",
            )
        points = _drop_non_finite(points, path)
    has_echo = is_echo(points)
    if not has_echo.all():
        warn_of_losses(points, str(path))
        points = points[has_echo]
    return points


def sweep_rows(path: Path | str) -> Float32[np.ndarray, "num_points 4"]:
    """Read the float32 values of a `.bin` file in rows of four, finite or not.

    Raises:
        FileError: The file cannot be read, is cut short, far longer than any sweep, or has other
            columns.
    """
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    _check_layout(content, path)
    if len(content) % _POINT_BYTES:
        raise FileError(
            path,
            f"holds {len(content)} bytes, expected a multiple of {_POINT_BYTES} (float32 x, y, z, "
            "reflectance); it is cut short or has other columns",
            f"write these four, or {_REMEDY}",
        )
    return np.frombuffer(content, "<f4").reshape(-1, 4).astype(np.float32)


def _drop_non_finite(
    points: Float32[np.ndarray, "num_points 4"], path: Path | str
) -> Float32[np.ndarray, "num_left 4"]:
    """Keep finite points, with 0 for non-finite reflectances; warns of the numbers of both."""
    kept: Float32[np.ndarray, "num_left 4"] = points[np.isfinite(points[:, :3]).all(axis=1)]
    has_no_reflectance = ~np.isfinite(kept[:, 3])
    kept[has_no_reflectance, 3] = 0
    num_lost, num_replaced = len(points) - len(kept), np.count_nonzero(has_no_reflectance)
    losses = []
    if num_lost:
        losses.append(
            f"{num_lost} of {len(points)} points with non-finite x, y, z are left out: "
            f"{len(kept) or 'none'} {'are' if len(kept) != 1 else 'is'} left"
        )
    if num_replaced:
        losses.append(
            f"{num_replaced} of {len(kept)} points have a non-finite reflectance, which becomes 0"
        )
    warn_user(f"{path}: {'; '.join(losses)}")
    return kept


def sweep_doubt(path: Path | str, points: Float32[np.ndarray, "num_points 4"]) -> Problem | None:
    """Problem of a KITTI sweep that is not in metres or has reflectances outside 0 to 1; else None.

    Files of five columns, or of other types than float32, are already refused by `read_sweep`. One
    point in a hundred may be brighter than 1. An empty sweep is no problem.

    Args:
        path: The file, for the problem.
        points: Result of `read_sweep`.
    """
    fault = cloud_fault(points, 1.0)
    if fault is None:
        return None
    problem, remedy = fault
    _, setting, scale = remedy.partition("of a reflectance of 1, probably ")
    if setting:  # KITTI's trees have no such setting
        remedy = (
            f"scale reflectances to 0 to 1: divide them by their full scale, probably {scale}, or "
            "make the data a recording with max_intensity (docs/recordings.md)"
        )
    return Problem(path=Path(path), problem=f"holds {problem}", remedy=remedy)


def hollow_sweep(path: Path, points: Float32[np.ndarray, "num_points 4"]) -> list[Problem]:
    """Find doubts about a sweep with few points or positions; an empty file is no problem.

    Args:
        path: The file, for the problems.
        points: Result of `read_sweep`.
    """
    num_rows = 0 if len(points) else len(sweep_rows(path))
    if num_rows:
        doubt: tuple[str, str] | None = (
            f"holds no point: all {num_rows} rows are at 0, 0, 0",
            "check whether the LiDAR delivered points, and how they were converted",
        )
    else:
        doubt = hollow_doubt(points)
    return [] if doubt is None else [Problem(path=path, problem=doubt[0], remedy=doubt[1])]


def hollow_file(path: Path) -> str | None:
    """Find a doubt of `hollow_sweep` about a file that is read whole only if its start has one.

    Returns:
        The problem, as the rest of a sentence; None: there is none, or the file is unreadable.
    """
    try:
        start = read_start(path, _START_BYTES, max_bytes=_MAX_BYTES, remedy=_REMEDY)
        rows = np.frombuffer(start[: len(start) // _POINT_BYTES * _POINT_BYTES], "<f4")
        first = echoes(rows.reshape(-1, 4))
        if not start or (len(first) and hollow_doubt(first) is None):
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its reader warns when the frame is read
            doubts = hollow_sweep(path, read_sweep(path, drop_non_finite=True))
    except (FileError, OSError):
        return None
    return doubts[0].problem if doubts else None


def doubtful_reflectances(path: Path, points: Float32[np.ndarray, "num_points 4"]) -> list[Problem]:
    """Find doubts about the reflectances of a sweep with points enough.

    Args:
        path: The file, for the problems.
        points: Result of `read_sweep`.
    """
    doubt = intensity_doubt(points, 1.0)
    return [] if doubt is None else [Problem(path=path, problem=doubt[0], remedy=doubt[1])]


def other_format(content: bytes) -> str | None:
    """Name of a file's cloud format by its first bytes; None: raw numbers."""
    names = (name for beginning, name in _OTHER_FORMATS.items() if content.startswith(beginning))
    return next(names, None)


def _check_layout(content: bytes, path: Path | str) -> None:
    name = other_format(content)
    if name is not None:
        raise FileError(
            path,
            f"is a {name} file by its first bytes, expected raw float32 x, y, z, reflectance",
            f"use the suffix .{name.lower()} in a recording (docs/recordings.md), or "
            "write these four",
        )
    if _TEXT.fullmatch(content[:_TEXT_BYTES]):
        start = shortened(" ".join(content[:_TEXT_BYTES].decode().split()), 40)
        raise FileError(
            path,
            f"is text, '{start}', expected raw float32 x, y, z, reflectance",
            "fetch the file itself if this is a web page, or write these four",
        )
    if is_big_endian(content):
        raise FileError(
            path,
            "holds big-endian numbers, expected little-endian float32 x, y, z, reflectance",
            "write them in the other byte order (NumPy: '<f4')",
        )
    layout = other_layout(content)
    if layout is None:
        return
    kind, columns = layout
    width = kind.itemsize * columns
    kinds = f" of float{8 * kind.itemsize}" if kind.itemsize != 4 else ""
    raise FileError(
        path,
        f"holds {len(content)} bytes, {width} for each point instead of {_POINT_BYTES}: probably "
        f"{COLUMNS[columns]}{kinds}, expected float32 x, y, z, reflectance",
        "write only these four",
    )


def write_sweep(path: Path | str, points: ArrayLike) -> None:
    """Write a sweep in float32, atomically, for `read_sweep`.

    Args:
        path: The `.bin` file.
        points: Rows of x, y, z, reflectance, an array or a tensor.

    Raises:
        ValueError: The points have other columns or another type, are masked, or a value is NaN or
            infinite.
    """
    expected = "numbers of shape (N, 4); give rows of x, y, z, reflectance"
    points = shaped_array(f"the sweep for {path}", points, (None, 4), "fiu", expected)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise ValueError(
            f"{path} cannot be written: {np.count_nonzero(~finite)} points hold NaN or infinite "
            f"values, the first is point {np.argmin(finite)}; remove them"
        )
    atomic_write_bytes(path, points.astype("<f4").tobytes())

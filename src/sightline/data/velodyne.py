"""LiDAR sweeps as KITTI stores them: float32 x, y, z, reflectance, nothing else."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32

from sightline.data.atomic import atomic_write_bytes
from sightline.data.plain_file import read_bytes
from sightline.data.problem import FileError

_POINT_BYTES = 16
_MAX_BYTES = 2**26  # 4 million points: sixteen turns of the densest LiDAR on the road
_REMEDY = "extract the velodyne archive again"


def read_sweep(
    path: Path | str, *, drop_non_finite: bool = False
) -> Float32[np.ndarray, "num_points 4"]:
    """Reads x, y, z [m] (LiDAR frame) and reflectance [0, 1]; an empty file is an empty sweep.

    Args:
        path: A `.bin` file of little-endian float32 values.
        drop_non_finite: Leave out points with NaN or infinite values, which some drivers write
            where no echo came back, instead of refusing the file.

    Raises:
        FileError: The file cannot be read, is cut short, far longer than any sweep, or holds NaN or
            infinite values.
    """
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    if len(content) % _POINT_BYTES:
        raise FileError(
            path,
            f"holds {len(content)} bytes, expected a multiple of {_POINT_BYTES} (float32 x, y, z, "
            "reflectance); it is cut short or has other columns",
            f"write these four, or {_REMEDY}",
        )
    points = np.frombuffer(content, "<f4").reshape(-1, 4).astype(np.float32)
    finite = np.isfinite(points).all(axis=1)
    if finite.all():
        return points
    if drop_non_finite:
        return points[finite]
    raise FileError(
        path,
        f"holds {np.count_nonzero(~finite)} points with NaN or infinite values, the first is point "
        f"{np.argmin(finite)} of {len(points)} (from 0)",
        f"remove them or {_REMEDY}",
    )


def write_sweep(path: Path | str, points: Float32[np.ndarray, "num_points 4"]) -> None:
    """Writes a sweep that `read_sweep` gives back bit by bit, aside first and then renamed.

    Raises:
        ValueError: A value is NaN or infinite.
    """
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise ValueError(
            f"{path} cannot be written: {np.count_nonzero(~finite)} points hold NaN or infinite "
            f"values, the first is point {np.argmin(finite)}; remove them"
        )
    atomic_write_bytes(path, points.astype("<f4").tobytes())

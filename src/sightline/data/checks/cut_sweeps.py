"""Sweeps of which a broken copy left only the beginning, known by their length and their rings."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from sightline.data.formats.velodyne import read_sweep
from sightline.files.problem import FileError, Problem
from sightline.files.shard_path import stored_file

_BLOCK_BYTES: Final = 4096
"""Size of blocks in which files are copied and stored; 1 of 256 whole sweeps ends at one, too."""
_MAX_REFERENCES: Final = 6
_MIN_REFERENCES: Final = 2
_ALIKE_SHARE: Final = 0.7
"""Smallest share of references with about equal lowest elevations; others may be faulty, too."""
_MAX_SPREAD_DEG: Final = 4.0
"""Largest difference between the lowest elevations of whole sweeps of one LiDAR; 174 real ones, of
which some are cut to the image, differ by up to 3.8."""
_MIN_GAP_DEG: Final = 5.0
"""Smallest elevation by which a cut sweep ends above whole ones; KITTI's have 7 or more where 60 %
of the file is left, as rings are stored from the highest to the lowest."""
CUT_DOUBT: Final = (
    f"lacks the lowest rings of the other sweeps and ends at a multiple of {_BLOCK_BYTES} bytes, "
    "probably because its copy was cut short"
)
CUT_REMEDY: Final = "copy or extract again"


def cut_sweeps(paths: Sequence[Path]) -> list[Path]:
    """Find sweeps (.bin) that end at a block of the disk and lack the lowest rings of the others.

    Args:
        paths: Point clouds of one LiDAR, in any format; those on a server are left out.
    """
    sweeps = [path for path in paths if path.suffix.lower() == ".bin" and stored_file(path)]
    suspects = [path for path in sweeps if _ends_at_block(path)]
    if not suspects:
        return []
    others = sorted(set(sweeps) - set(suspects))
    step = max(len(others) // _MAX_REFERENCES, 1)
    lowest = [_lowest_deg(path) for path in others[::step][:_MAX_REFERENCES]]
    known = [each for each in lowest if each is not None]
    middle_deg = np.median(known) if known else 0.0
    alike = [each for each in known if abs(each - middle_deg) <= _MAX_SPREAD_DEG]
    if len(alike) < max(_MIN_REFERENCES, _ALIKE_SHARE * len(known)):
        return []
    limit_deg = max(alike) + _MIN_GAP_DEG
    ends = ((path, _lowest_deg(path)) for path in suspects)
    return [path for path, end_deg in ends if end_deg is not None and end_deg > limit_deg]


def check_cut_sweeps(paths: Sequence[Path]) -> list[Problem]:
    """Find a problem for each of the `cut_sweeps`."""
    return [Problem(path=path, problem=CUT_DOUBT, remedy=CUT_REMEDY) for path in cut_sweeps(paths)]


def _ends_at_block(path: Path) -> bool:
    try:
        num_bytes = path.stat().st_size
    except OSError:
        return False
    return num_bytes > 0 and num_bytes % _BLOCK_BYTES == 0


def _lowest_deg(path: Path) -> float | None:
    """Lowest elevation of a sweep's points; None: it has no point, or is unreadable."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its reader warns when the frame is read
            x, y, z = read_sweep(path, drop_non_finite=True)[:, :3].T.astype(np.float64)
    except (FileError, OSError):
        return None
    return float(np.degrees(np.arctan2(z, np.hypot(x, y)).min())) if len(z) else None

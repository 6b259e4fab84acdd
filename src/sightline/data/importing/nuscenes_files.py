"""Reader of nuScenes' images and sweeps."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from jaxtyping import Float32

from sightline.data.formats.image_header import ImageHeader, read_complete_header
from sightline.data.formats.rings import in_kitti_order
from sightline.data.formats.velodyne import COLUMNS, other_format
from sightline.data.importing.nuscenes import Moment
from sightline.data.importing.writer import CloudTally, count_echoes
from sightline.files.plain_file import read_bytes
from sightline.files.problem import FileError
from sightline.geometry.cloud_layouts import has_columns

_POINT_BYTES: Final = 20  # float32 x, y, z, intensity, ring
_MAX_BYTES: Final = 2**26
_REMEDY: Final = "extract nuScenes' archive again"
_Content = TypeVar("_Content")


@dataclass(frozen=True, slots=True)
class FrameContents:
    """Contents of a frame's image and sweep."""

    header: ImageHeader
    echoes: Float32[np.ndarray, "num_points 4"]
    """Points with an echo, with reflectances in [0, 1]."""
    clouds: CloudTally


def missing_file(moment: Moment) -> FileError | None:
    """Error for a frame without its image or sweep; None: it has both."""
    path = next((each for each in (moment.image, moment.sweep) if not each.is_file()), None)
    return None if path is None else FileError(path, "is missing", _REMEDY)


def read_or_note_damage(
    reader: Callable[[Moment], _Content], moment: Moment, faults: dict[str, FileError]
) -> _Content | None:
    """Read files of a frame; if their contents are faulty, note the error and return None.

    Raises:
        FileError: They cannot be accessed, for lack of permission or of the disk: they may be
            sound.
    """
    try:
        return reader(moment)
    except FileError as error:
        if isinstance(error.__cause__, OSError):
            raise
        faults[moment.name] = error
        return None


def read_frame(moment: Moment, max_intensity: float) -> FrameContents:
    """Read a frame's image and sweep.

    Raises:
        FileError: One of them cannot be read, is damaged or does not fit the tables.
    """
    header = checked_image_header(moment)
    sweep = _read_sweep(moment.sweep)
    echoes, clouds = count_echoes(moment.name, sweep, max_intensity, moment.sweep)
    return FrameContents(header, echoes, clouds)


def checked_image_header(moment: Moment) -> ImageHeader:
    """Header of a frame's image, which is complete.

    Raises:
        FileError: The image cannot be read, is cut short, or has another size than in its table.
    """
    header = read_complete_header(moment.image)
    if header.size != moment.image_size:
        raise FileError(
            moment.image,
            f"is {header.size[0]}x{header.size[1]} (height x width), expected "
            f"{moment.image_size[0]}x{moment.image_size[1]} as in its row of sample_data.json",
            _REMEDY,
        )
    return header


def _read_sweep(path: Path) -> Float32[np.ndarray, "num_points 4"]:
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=_REMEDY)
    kind = other_format(content)
    columns = next((each for each in (5, 4, 6, 7, 8) if has_columns(content, each)), None)
    if kind is None and columns not in (5, None):
        kind = f"{COLUMNS[columns]} of float32"
    if kind is not None:
        raise FileError(
            path,
            f"holds {len(content)} bytes of, probably, {kind}, expected nuScenes' five columns of "
            "float32 (x, y, z, intensity, ring)",
            "write these five, 0 for a ring that is unknown, or extract nuScenes' archive again",
        )
    if len(content) % _POINT_BYTES:
        problem = f"holds {len(content)} bytes, expected a multiple of {_POINT_BYTES}"
        raise FileError(path, f"{problem} (float32 x, y, z, intensity, ring)", _REMEDY)
    sweep = np.frombuffer(content, "<f4").reshape(-1, 5)
    return in_kitti_order(sweep[:, :4].astype(np.float32), sweep[:, 4])

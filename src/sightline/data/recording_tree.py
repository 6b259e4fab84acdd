"""Lists the files of a recording without reading them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sightline.data.image_header import IMAGE_SUFFIXES
from sightline.data.object_tree import ObjectFrame, list_files
from sightline.data.point_files import CLOUD_SUFFIXES
from sightline.files.problem import Problem

IMAGES, POINTS, LABELS, DEPTH = "images", "points", "labels", "depth"
CALIBRATIONS: Final = "calibration"
"""Name of the folder with one file per frame, and stem of the single file for all frames."""
TIMES_NAME: Final = "times.txt"

CALIBRATION_SUFFIXES = (".yaml", ".yml", ".json")


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingFiles:
    """Files of a recording."""

    folder: Path
    frames: tuple[ObjectFrame, ...]
    """Frames with an image or a cloud, sorted by name; each with its calibration."""
    times: Path | None


def is_recording(folder: Path) -> bool:
    """Whether a folder has images or clouds and a recording's calibration."""
    return _has_sensor(folder) and bool(
        _common_calibration(folder) or list_files(folder / CALIBRATIONS, CALIBRATION_SUFFIXES)
    )


def lacks_calibration(folder: Path) -> bool:
    """Whether a folder is a recording except for a missing calibration."""
    return _has_sensor(folder) and not is_recording(folder)


def unpaired(folder: Path, frames: Sequence[ObjectFrame]) -> Problem | None:
    """Problem of a recording in which no image has a cloud of the same name; else None.

    Recordings of a single sensor are no problem.
    """
    images = [frame.sample_id for frame in frames if frame.image]
    clouds = [frame.sample_id for frame in frames if frame.points]
    if not images or not clouds or set(images) & set(clouds):
        return None
    return Problem(
        path=folder,
        problem=f"has no image and cloud of one name: images are called {images[0]} .., clouds "
        f"{clouds[0]} ..",
        remedy="give the files of a frame one name",
    )


def list_recording(folder: Path) -> RecordingFiles:
    """Lists a recording: images/NAME.jpg, points/NAME.pcd, calibration.yaml and optional files.

    Pictures have the suffix .png, .jpg or .jpeg, clouds .bin, .npy or .pcd, in any case. A
    calibration is calibration.yaml (or .yml, .json) for all frames, or calibration/NAME.yaml for
    each. Labels (KITTI's), depth (16-bit PNGs) and times.txt are optional.
    """
    images = list_files(folder / IMAGES, IMAGE_SUFFIXES)
    clouds = list_files(folder / POINTS, CLOUD_SUFFIXES)
    labels, depths = list_files(folder / LABELS, (".txt",)), list_files(folder / DEPTH, (".png",))
    common = _common_calibration(folder)
    own = list_files(folder / CALIBRATIONS, CALIBRATION_SUFFIXES)
    times = list_files(folder, (".txt",)).get(Path(TIMES_NAME).stem)
    return RecordingFiles(
        folder=folder,
        frames=tuple(
            ObjectFrame(
                sample_id=name,
                image=images.get(name),
                points=clouds.get(name),
                calibration=own.get(name, common),
                objects=labels.get(name),
                depth=depths.get(name),
            )
            for name in sorted({*images, *clouds})
        ),
        times=times,
    )


def _has_sensor(folder: Path) -> bool:
    return any((folder / name).is_dir() for name in (IMAGES, POINTS))


def _common_calibration(folder: Path) -> Path | None:
    return list_files(folder, CALIBRATION_SUFFIXES).get(CALIBRATIONS)

"""Which files a recording of your own has, listed without reading them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sightline.data.image_header import IMAGE_SUFFIXES
from sightline.data.object_tree import ObjectFrame, list_files
from sightline.data.point_files import CLOUD_SUFFIXES
from sightline.data.problem import Problem

IMAGES, POINTS, LABELS, DEPTH = "images", "points", "labels", "depth"
CALIBRATIONS: Final = "calibration"
"""The folder of one file a frame, and the stem of the one file for all."""
TIMES_NAME: Final = "times.txt"

CALIBRATION_SUFFIXES = (".yaml", ".yml", ".json")


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingFiles:
    """The files of a recording."""

    folder: Path
    frames: tuple[ObjectFrame, ...]
    """All that have an image or a cloud, by name; each with the calibration that holds for it."""
    times: Path | None


def is_recording(folder: Path) -> bool:
    """Whether a folder has a recording's calibration beside its images or clouds."""
    return _has_sensor(folder) and bool(
        _common_calibration(folder) or list_files(folder / CALIBRATIONS, CALIBRATION_SUFFIXES)
    )


def lacks_calibration(folder: Path) -> bool:
    """Whether a folder would be a recording if it had a calibration."""
    return _has_sensor(folder) and not is_recording(folder)


def unpaired(folder: Path, frames: Sequence[ObjectFrame]) -> Problem | None:
    """That no image of a recording's frames has a cloud of its name; None where one has.

    Of frames of one sensor alone nothing is said.
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
    """Lists a recording: images/NAME.jpg, points/NAME.pcd and calibration.yaml, and what else is.

    Pictures end in .png, .jpg or .jpeg, clouds in .bin, .npy or .pcd, in any case. A calibration
    is calibration.yaml (or .yml, .json) for all frames, or calibration/NAME.yaml for each; labels
    (KITTI's), depth (16-bit PNGs) and times.txt may be there.
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

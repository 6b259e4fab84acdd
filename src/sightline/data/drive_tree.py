"""Lists the files of a raw drive without reading them."""

from dataclasses import dataclass
from pathlib import Path

from sightline.data.image_header import IMAGE_SUFFIXES
from sightline.data.object_tree import find_file, list_files

_IMAGE_FOLDERS = ("image_02/data", "image_02")
_POINTS_FOLDERS = ("velodyne_points/data", "velodyne_points", "velodyne")
_TIMES_FOLDERS = ("velodyne_points", "velodyne", "image_02", "")


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveFrame:
    """Files of one frame; None: missing."""

    sample_id: str
    """Name of the files, e.g. "0000000005"."""
    image: Path | None
    points: Path | None


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveFiles:
    """Files of a drive."""

    frames: tuple[DriveFrame, ...]
    """All frames with an image or a sweep, in order."""
    image_folder: Path
    points_folder: Path
    calibration: Path | None
    """Folder of `calib_cam_to_cam.txt`, `calib_velo_to_cam.txt`, `calib_imu_to_velo.txt`."""
    timestamps: Path | None
    """File with one line per frame, or line N for the frame numbered N."""
    oxts: Path | None
    """Folder of GPS and IMU readings, one file per frame."""


def list_drive(folder: Path) -> DriveFiles:
    """Lists a drive in the official layout, or in the flat one.

    Official: image_02/data/N.png, velodyne_points/data/N.bin, timestamps.txt next to each `data`,
    oxts/data/N.txt, the calibration in the parent folder (of the day). Flat: image_02/N.png,
    velodyne/N.bin and the calibration in the folder itself.
    """
    image_folder = _first_folder(folder, _IMAGE_FOLDERS)
    points_folder = _first_folder(folder, _POINTS_FOLDERS)
    images, points = list_files(image_folder, IMAGE_SUFFIXES), list_files(points_folder, (".bin",))
    calibrations = (
        place for place in (folder, folder.parent) if (place / "calib_cam_to_cam.txt").is_file()
    )
    times = (find_file(folder / place, "timestamps.txt") for place in _TIMES_FOLDERS)
    oxts = folder / "oxts" / "data"
    return DriveFiles(
        frames=tuple(
            DriveFrame(sample_id=number, image=images.get(number), points=points.get(number))
            # By length first: 2 comes before 10 without leading zeros, too.
            for number in sorted({*images, *points}, key=lambda name: (len(name), name))
        ),
        image_folder=image_folder,
        points_folder=points_folder,
        calibration=next(calibrations, None),
        timestamps=next((path for path in times if path is not None), None),
        oxts=oxts if oxts.is_dir() else None,
    )


def _first_folder(folder: Path, places: tuple[str, ...]) -> Path:
    candidates = [folder / place for place in places]
    return next((place for place in candidates if place.is_dir()), candidates[0])

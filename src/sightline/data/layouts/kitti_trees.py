"""Lists of the files in KITTI's trees, without reading: objects, depth completion, raw drives."""

import difflib
from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from sightline.data.formats.image_header import IMAGE_SUFFIXES
from sightline.data.formats.kitti_labels import sequence_fault
from sightline.data.layouts.frame_lists import doubt_about_names, frame_number, is_note
from sightline.files.leftovers import is_leftover
from sightline.files.plain_text import shortened
from sightline.files.problem import Problem
from sightline.jobs.output_dirs import SELECTIONS_FOLDER

CORRUPTED: Final = "corruption"
"""Folder of a split with a record of each frame's corruption; clean trees have none."""
Velodyne = Literal["velodyne", "velodyne_reduced"]
Part = Literal["image", "points", "calibration", "objects", "depth"]
"""Part of a sample. Only simulated trees have `depth`: dense true depth as 16-bit PNGs."""

PART_SUFFIXES: Final[dict[Part, tuple[str, ...]]] = {
    "image": IMAGE_SUFFIXES,
    "points": (".bin",),
    "calibration": (".txt",),
    "objects": (".txt",),
    "depth": (".png",),
}
"""Suffixes of each part's files, in lower case; other files are ignored."""
_MAX_COMPARED = 10_000  # largest number of frames compared with a misspelt name
_MAX_LISTED = 5  # frames listed in an error

DriveSplit = Literal["train", "val"]
SelectedSplit = Literal["val_selection_cropped", "test_depth_completion_anonymous"]
Camera = Literal["image_02", "image_03"]

RAW_CALIBRATION: Final = tuple(
    f"calib_{name}.txt" for name in ("cam_to_cam", "velo_to_cam", "imu_to_velo")
)
"""Calibration files of a raw drive; the folder with the first is that of all."""

_DATE_LENGTH = len("2011_09_26")
DRIVE_FOLDERS: Final[dict[Part, tuple[str, ...]]] = {
    "image": ("image_02/data", "image_02"),
    "points": ("velodyne_points/data", "velodyne_points", "velodyne"),
}
"""Possible folders of a raw drive's parts: the first one with files of the part is read."""
OXTS_SUFFIXES: Final = (".txt",)
_OXTS_FOLDERS = ("oxts/data", "oxts")
_TIMES_FOLDERS = ("velodyne_points", "velodyne", "image_02", "")


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectFrame:
    """Files of one frame; None: missing."""

    sample_id: str
    image: Path | None = None
    points: Path | None = None
    calibration: Path | None = None
    objects: Path | None = None
    depth: Path | None = None


def part_folder(part: Part, velodyne: Velodyne = "velodyne") -> str:
    """Name of a part's folder; KITTI's name if KITTI has the part."""
    if part == "points":
        return velodyne
    names = {"image": "image_2", "calibration": "calib", "objects": "label_2", "depth": "depth"}
    return names[part]


def find_velodyne(folder: Path) -> Velodyne:
    """Folder of a split's sweeps: `velodyne`, unless only `velodyne_reduced` contains sweeps."""
    if _has_sweeps(folder / "velodyne") or not _has_sweeps(folder / "velodyne_reduced"):
        return "velodyne"
    return "velodyne_reduced"


def _has_sweeps(folder: Path) -> bool:
    return folder.is_dir() and any(
        path.suffix.lower() in PART_SUFFIXES["points"] and not is_leftover(path.name)
        for path in folder.iterdir()
    )


def list_object_frames(
    folder: Path, parts: Collection[Part], velodyne: Velodyne = "velodyne"
) -> dict[str, ObjectFrame]:
    """List all frames of `folder` (e.g. `training`) with any of the parts, sorted by name.

    Hidden files, files without KITTI's suffixes (in any case) and notes beside texts are ignored.
    """
    files = {
        part: list_files(folder / part_folder(part, velodyne), PART_SUFFIXES[part])
        for part in parts
    }
    texts = {part for part in files if PART_SUFFIXES[part] == (".txt",)}
    others = {name for part in files.keys() - texts for name in files[part]}
    for part in texts:
        notes = [name for name in files[part] if is_note(name) and name not in others]
        files[part] = {name: path for name, path in files[part].items() if name not in notes}
    return {
        frame_id: ObjectFrame(
            sample_id=frame_id,
            image=files.get("image", {}).get(frame_id),
            points=files.get("points", {}).get(frame_id),
            calibration=files.get("calibration", {}).get(frame_id),
            objects=files.get("objects", {}).get(frame_id),
            depth=files.get("depth", {}).get(frame_id),
        )
        for frame_id in sorted({frame_id for listed in files.values() for frame_id in listed})
    }


def named_in_two_ways(
    folder: Path, frames: Iterable[ObjectFrame], velodyne: Velodyne = "velodyne"
) -> Problem | None:
    """Find files of one frame with different names, such as 2.txt beside 000002.png; else None."""
    by_number: dict[int, list[ObjectFrame]] = defaultdict(list)
    for frame in frames:
        number = frame_number(frame.sample_id)
        if number is not None:
            by_number[number].append(frame)
    pairs = [each for each in by_number.values() if len(each) > 1]
    folders = [[_folders_with(frame, velodyne) for frame in pair] for pair in pairs]
    if not pairs or any(len(each) > 2 or set(each[0]) & set(each[1]) for each in folders):
        return None
    few, many = sorted(zip(folders[0], pairs[0], strict=True), key=lambda each: len(each[0]))
    labels = few[1].objects
    fault = None if labels is None else sequence_fault(labels)
    if labels is not None and fault is not None:  # a sequence, of which a frame has the number
        return Problem(path=labels, problem=fault[0], remedy=fault[1])
    wrong, right = (shortened(frame.sample_id) for _, frame in (few, many))
    return Problem(
        path=folder,
        problem=f"names {len(pairs):,} frames in two ways, such as {wrong} in {', '.join(few[0])} "
        f"and {right} in {', '.join(many[0])}",
        remedy=f"give the files of a frame one name: rename {wrong} as {right}, and so on",
    )


def _folders_with(frame: ObjectFrame, velodyne: Velodyne) -> list[str]:
    parts: tuple[Part, ...] = ("image", "points", "calibration", "objects", "depth")
    return [part_folder(part, velodyne) for part in parts if getattr(frame, part) is not None]


def list_files(folder: Path, suffixes: Sequence[str]) -> dict[str, Path]:
    """List the files of a folder with one of the suffixes, in any case, sorted by stem.

    Of two files with the same stem the earlier suffix wins, lower case first. A missing folder is
    empty. Hidden files and folders of systems, such as $RECYCLE.BIN, are left out.

    Args:
        folder: Folder of the files.
        suffixes: Suffixes in lower case, with their dots.
    """
    if not folder.is_dir():
        return {}
    paths = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not is_leftover(path.name)
    ]
    paths.sort(key=lambda path: (path.stem, -suffixes.index(path.suffix.lower()), path.suffix))
    return {path.stem: path for path in paths}


def find_file(folder: Path, name: str) -> Path | None:
    """Find a file by its name, in lower case, else by its name in any case."""
    if not folder.is_dir():
        return None
    if (folder / name).exists():
        return folder / name
    return next((path for path in sorted(folder.iterdir()) if path.name.lower() == name), None)


def shared_calibration_remedy(folder: Path) -> str | None:
    """Remedy for an object tree's split with one calib.txt for all frames; None: it has none."""
    if not (folder / "calib.txt").is_file() or (folder / part_folder("calibration")).is_dir():
        return None
    return "copy calib.txt to calib/NAME.txt for each frame"


NO_LABELS_REMEDY: Final = "write an empty label file for each frame without objects"
"""Further remedy for missing labels: exporters such as CVAT's write no file for such frames."""


def describe_absent(frame_ids: Sequence[str]) -> str:
    """List the first few frames, and the number of the others."""
    named = ", ".join(map(shortened, frame_ids[:_MAX_LISTED]))
    more = len(frame_ids) - _MAX_LISTED
    return f"{named} and {more} more" if more > 0 else named


def suggest_frames(frame_id: str, known: Sequence[str]) -> str:
    """Suggest names similar to that of a missing frame."""
    number = int(frame_id) if frame_id.isascii() and frame_id.isdecimal() else None
    same = [
        each
        for each in known
        if number is not None and each.isascii() and each.isdecimal() and int(each) == number
    ]
    close = same or difflib.get_close_matches(frame_id, known[:_MAX_COMPARED], n=3)
    suggestion = f"perhaps {' or '.join(map(shortened, close))} is meant; " if close else ""
    first, last = shortened(known[0]), shortened(known[-1])
    return f"{suggestion}there are {len(known):,}, from {first} to {last}"


def remedy_for_absent(absent: Sequence[str], known: Sequence[str]) -> str:
    """Remedy for frames of a list that a data set lacks: the faulty line, or similar names."""
    others = f"{suggest_frames(absent[0], known)}; name others or another folder"
    return doubt_about_names(absent) or others


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthFrame:
    """Files of one frame; None: missing."""

    sample_id: str
    image: Path | None
    sparse: Path | None
    """Sparse depth map, the projected sweep."""
    truth: Path | None
    intrinsics: Path | None
    """File of nine numbers; or a `calib_cam_to_cam.txt` if `camera` is given."""
    camera: Camera | None = None


def list_drive_frames(
    root: Path, split: DriveSplit, raw_root: Path, cameras: Sequence[Camera]
) -> list[DepthFrame]:
    """List all frames of `train` or `val` with a sparse map or a ground truth, in order.

    Searches DRIVE/proj_depth/{groundtruth,velodyne_raw}/CAMERA/N.png below `root`/SPLIT and below
    that folder in `data_depth_annotated` and `data_depth_velodyne`; images and calibration in
    `raw_root` as DATE/DRIVE/CAMERA/data/N.png and DATE/calib_cam_to_cam.txt, else in DRIVE itself,
    beside `proj_depth`, where preparations of other programs copy them.
    """
    bases = drive_bases(root, split)
    drives = sorted(
        {path.parent.name for base in bases for path in base.glob("*/proj_depth") if path.is_dir()}
    )
    return [
        frame
        for drive in drives
        for camera in cameras
        for frame in _frames_of_drive(drive, bases, raw_root, camera)
    ]


def drive_bases(root: Path, split: DriveSplit) -> list[Path]:
    """List the possible parent folders of drives."""
    return [
        root / archive / split for archive in ("", "data_depth_annotated", "data_depth_velodyne")
    ]


def raw_images(raw_root: Path, drive: str, camera: Camera) -> Path:
    """Folder of a camera's images of a raw drive, below the folder of its day."""
    return raw_root / drive[:_DATE_LENGTH] / drive / camera / "data"


def selection_folder(root: Path, split: SelectedSplit) -> Path:
    """Folder of a selection: in `root`, in its folder depth_selection, or `root` itself."""
    candidates = (root / split, root / SELECTIONS_FOLDER / split, root)
    return next((base for base in candidates if (base / "velodyne_raw").is_dir()), candidates[0])


def list_selected_frames(root: Path, split: SelectedSplit) -> list[DepthFrame]:
    """List all frames of a selection, in order.

    The files are image/N.png, velodyne_raw/N.png, intrinsics/N.txt and, for validation,
    groundtruth_depth/N.png. N of the cropped selection contains the kind of file:
    DRIVE_image_FRAME_CAMERA, DRIVE_velodyne_raw_FRAME_CAMERA, DRIVE_groundtruth_depth_FRAME_CAMERA.
    """
    folder = selection_folder(root, split)
    images = list_files(folder / "image", IMAGE_SUFFIXES)
    intrinsics = list_files(folder / "intrinsics", (".txt",))
    sparse = _renamed(list_files(folder / "velodyne_raw", (".png",)), "_velodyne_raw_")
    truth = _renamed(list_files(folder / "groundtruth_depth", (".png",)), "_groundtruth_depth_")
    return [
        DepthFrame(
            sample_id=name,
            image=images.get(name),
            sparse=sparse.get(name),
            truth=truth.get(name),
            intrinsics=intrinsics.get(name),
        )
        for name in sorted({*images, *sparse, *truth})
    ]


def _frames_of_drive(
    drive: str, bases: Sequence[Path], raw_root: Path, camera: Camera
) -> list[DepthFrame]:
    sparse: dict[str, Path] = {}
    truth: dict[str, Path] = {}
    for base in bases:
        maps = base / drive / "proj_depth"
        sparse |= list_files(maps / "velodyne_raw" / camera, (".png",))
        truth |= list_files(maps / "groundtruth" / camera, (".png",))
    image_folders = (
        raw_images(raw_root, drive, camera),
        *(base / drive / camera / "data" for base in bases),
    )
    images = next(filter(None, (list_files(each, IMAGE_SUFFIXES) for each in image_folders)), {})
    calibration_folders = (raw_root / drive[:_DATE_LENGTH], *(base / drive for base in bases))
    calibrations = (each / RAW_CALIBRATION[0] for each in calibration_folders)
    calibration = next((path for path in calibrations if path.is_file()), None)
    return [
        DepthFrame(
            sample_id=f"{drive}_image_{number}_{camera}",
            image=images.get(number),
            sparse=sparse.get(number),
            truth=truth.get(number),
            intrinsics=calibration,
            camera=camera,
        )
        for number in sorted({*sparse, *truth})
    ]


def _renamed(files: dict[str, Path], kind: str) -> dict[str, Path]:
    return {name.replace(kind, "_image_"): path for name, path in files.items()}


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
    """Folder of the `RAW_CALIBRATION`."""
    timestamps: Path | None
    """Times of the sweeps (else of the images): one line per frame, or line N for number N."""
    image_timestamps: Path | None
    """Times of the images, where `timestamps` are those of the sweeps."""
    oxts: Path | None
    """Folder of GPS and IMU readings, one file per frame."""

    @property
    def first_image(self) -> Path | None:
        """The first image; None: there is none."""
        return next((frame.image for frame in self.frames if frame.image is not None), None)


def list_drive(folder: Path) -> DriveFiles:
    """List a drive in the official layout, or in the flat one.

    Official: image_02/data/N.png, velodyne_points/data/N.bin, timestamps.txt next to each `data`,
    oxts/data/N.txt, the calibration in a parent folder (see `day_folders`). Flat: image_02/N.png,
    velodyne/N.bin, oxts/N.txt and the calibration in the folder itself.
    """
    image_folder, images = _files_of_drive(folder, "image")
    points_folder, points = _files_of_drive(folder, "points")
    calibrations = (
        place for place in (folder, *day_folders(folder)) if (place / RAW_CALIBRATION[0]).is_file()
    )
    times = [find_file(folder / place, "timestamps.txt") for place in _TIMES_FOLDERS]
    image_times = find_file(folder / "image_02", "timestamps.txt")
    timestamps = next((path for path in times if path is not None), None)
    return DriveFiles(
        frames=tuple(
            DriveFrame(sample_id=number, image=images.get(number), points=points.get(number))
            # By length first: 2 comes before 10 without leading zeros, too.
            for number in sorted({*images, *points}, key=lambda name: (len(name), name))
        ),
        image_folder=image_folder,
        points_folder=points_folder,
        calibration=next(calibrations, None),
        timestamps=timestamps,
        image_timestamps=None if image_times == timestamps else image_times,
        oxts=_oxts_folder(folder),
    )


def describe_raw_drives(root: Path) -> tuple[str, ...]:
    """Clause on the raw drives in a folder that is read as another data set; empty: none."""
    drives = sorted(path.parent for path in root.glob("*/*_sync/velodyne_points"))
    if not drives:
        return ()
    return (f"for whole sweeps give one of its raw drives ({len(drives):,}), such as {drives[0]}",)


def _oxts_folder(folder: Path) -> Path | None:
    """Folder of the readings: the first with text files, else the first that exists."""
    places = [folder / place for place in _OXTS_FOLDERS if (folder / place).is_dir()]
    full = (place for place in places if list_files(place, OXTS_SUFFIXES))
    return next(full, places[0] if places else None)


def day_folders(drive: Path) -> tuple[Path, ...]:
    """Folders of the day, one above a raw drive's: beside its name, and where a link leads."""
    named = drive if drive.name not in ("", "..") else drive.resolve()  # such as "."
    return (named.parent, drive.resolve().parent) if drive.is_symlink() else (named.parent,)


def _files_of_drive(folder: Path, part: Part) -> tuple[Path, dict[str, Path]]:
    """Folder of a part and its files; without any, the first folder that exists."""
    places = [folder / place for place in DRIVE_FOLDERS[part]]
    for place in places:
        files = list_files(place, PART_SUFFIXES[part])
        if files:
            return place, files
    return next((place for place in places if place.is_dir()), places[0]), {}

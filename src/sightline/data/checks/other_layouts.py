"""Problems of folders that are no data set, with the likely cause and the remedy."""

import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from sightline.data.checks.unread_files import (
    drive_folders,
    find_unread,
    object_folders,
    recording_folders,
)
from sightline.data.layouts.depth_trees import split_by_drives
from sightline.data.layouts.frame_lists import TIMES_NAME
from sightline.data.layouts.kitti_trees import find_velodyne, list_drive, list_object_frames
from sightline.data.layouts.recording_files import (
    IMAGES,
    POINTS,
    is_recording,
    lacks_calibration,
    misnamed_files,
    no_frames,
)
from sightline.files.leftovers import is_leftover
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, Problem
from sightline.files.shard_index import MANIFEST, SHARED, index_path
from sightline.jobs.output_dirs import KITTI_SPLITS, is_split

_ARCHIVES: Final = (".zip", ".tar", ".gz", ".tgz", ".7z")
BAG_SUFFIXES: Final = (".bag", ".mcap", ".db3")
_LAYOUT_NAMES: Final = (
    {"image_2", "velodyne"},
    {"image_2", "calib"},
    {"velodyne", "calib"},
    {"image_02", "velodyne_points"},
    {"images", "points"},
    {"image", "velodyne_raw"},
    {"calib.txt", "velodyne"},
    {"calib.txt", "image_2"},
)
"""Names that occur together in the folders of data sets."""
_FURTHER_NAMES: Final = ({"image_2", "label_2"}, {"image", "intrinsics"})
"""Names of folders that lack something or are of another benchmark, for where there are no others.
"""
_ODOMETRY_CAMERAS: Final = {"image_2": "P2", "image_0": "P0"}
"""Projection in calib.txt of each folder of images, colour before grey."""
_KITTI_360_FOLDERS: Final = ("data_2d_raw", "data_3d_raw")
_SHARDS_REMEDY: Final = "copy the whole folder again, or pack the data again (sightline shard)"
_MAX_SEARCHED = 200  # largest number of searched subfolders
_EXPECTED: Final = (
    "a recording (calibration.yaml, images, points), or KITTI's object tree "
    "(training/image_2, ..), depth completion tree (val_selection_cropped/velodyne_raw, "
    "val/DRIVE/proj_depth, ..) or raw drive (image_02, velodyne_points, ..)"
)


def refuse_other_layouts(path: Path) -> None:
    """Refuse folders that look like a known layout but have another.

    Raises:
        FileError: It is a sequence of KITTI odometry or tracking, or a drive of KITTI-360.
    """
    problem = _odometry(path) or _tracking(path)
    if problem is None and _is_drive_of_kitti_360(path):
        problem = _kitti_360(path)
    if problem is not None:
        raise FileError(problem.path, problem.problem, problem.remedy)


def misnamed_split(path: Path) -> Problem | None:
    """Problem of an object split whose folder has another name than in KITTI's tree.

    None: it has KITTI's name, or is no object split.
    """
    names = (path.name, path.resolve().name)  # a split may be a link to another disk
    if any(name in KITTI_SPLITS for name in names) or list_drive(path).calibration is not None:
        return None  # a raw drive may have a folder image_2
    if not any((path / name).is_dir() for name in ("image_2", "calib")):
        return None
    if not list_object_frames(path, ("image", "points"), find_velodyne(path)):
        return None
    return Problem(
        path=path,
        problem="holds the parts of an object split",
        remedy="rename it to training or testing, as in KITTI's tree",
    )


def no_data_set(path: Path) -> Problem:
    """Problem of a path that is no data set: its actual type, or the expected one."""
    layouts = (
        _odometry,
        _tracking,
        _kitti_360,
        _depth_prediction,
        _uncalibrated,
        source_to_import,
        _unread,
        _empty,
        _apart,
        _in_depth_tree,
    )
    for cause in (_no_folder, *layouts, _below):
        problem = cause(path)
        if problem is not None:
            return problem
    archives = [each for each in _entries(path) if each.suffix.lower() in _ARCHIVES]
    if any(each.suffix == ".tar" and index_path(each).is_file() for each in archives):
        is_there = (path / MANIFEST).is_file()
        fault = (
            f"whose list, {MANIFEST}, is damaged"
            if is_there
            else f"without {MANIFEST}, the list of them"
        )
        return Problem(
            path=path,
            problem=f"holds shards {fault}",
            remedy=_SHARDS_REMEDY,
        )
    shard = next(filter(_is_shard, archives), None)
    if shard is not None:
        return Problem(
            path=path,
            problem="holds shards of `sightline shard` without their indexes, such as "
            f"{shortened(shard.name)} without {shortened(index_path(shard).name)}",
            remedy=_SHARDS_REMEDY,
        )
    if archives:
        problem_text = (
            f"holds archives that are not unpacked, such as {shortened(archives[0].name)}"
        )
        return Problem(path=path, problem=problem_text, remedy="unpack them into this folder")
    return _empty_tree(path) or Problem(
        path=path,
        problem=f"is no data set, expected {_EXPECTED}",
        remedy="give the folder of such a data set, or make yours a recording (docs/recordings.md)",
    )


def _no_folder(path: Path) -> Problem | None:
    if path.is_dir():
        return None
    if path.suffix.lower() in BAG_SUFFIXES and path.exists():
        return _to_import(path, "is a ROS bag")
    if _is_shard(path):
        name = shortened(index_path(path).name)
        problem = f"is a shard of `sightline shard` without its index, {name} beside it"
        return Problem(path=path, problem=problem, remedy=_SHARDS_REMEDY)
    if path.suffix.lower() in _ARCHIVES and path.exists():
        return Problem(
            path=path, problem="is an archive", remedy="unpack it, and give the folder of its data"
        )
    problem = "is no folder" if path.exists() else "does not exist"
    return Problem(path=path, problem=problem, remedy="give the folder of a data set")


def _is_shard(path: Path) -> bool:
    """Test whether a file is a tar of frames as `sightline shard` packs them.

    Its members have no times, and the names of their folders: training/000000.image_2.png.
    """
    if path.suffix != ".tar" or not path.is_file():
        return False
    try:
        with tarfile.open(path, "r:") as archive:
            first = archive.next()
    except (OSError, tarfile.TarError):
        return False
    is_named_so = path.stem == SHARED or (first is not None and len(Path(first.name).suffixes) > 1)
    return first is not None and not first.mtime and is_named_so


def _odometry(path: Path) -> Problem | None:
    images = next((name for name in _ODOMETRY_CAMERAS if (path / name).is_dir()), None)
    has_sweeps = (path / "velodyne").is_dir()
    is_one = (images is not None or has_sweeps) and not (path / "calib").is_dir()
    if not is_one or not (path / "calib.txt").is_file():
        return None
    has_times = (path / TIMES_NAME).is_file()
    times = f", and begin each line of {TIMES_NAME} with its frame's name" if has_times else ""
    camera = _ODOMETRY_CAMERAS.get(images or "", "P2")
    renamed = [
        *([] if images is None else [f"{images} to images"]),
        *(["velodyne to points"] if has_sweeps else []),
    ]
    size = ", image_size, that of the camera's images" if images is None else ""
    return Problem(
        path=path,
        problem=f"is a sequence of KITTI odometry: one calib.txt, with {camera} and Tr, for all "
        "frames",
        remedy=f"make it a recording: rename {' and '.join(renamed)}, and write calibration.yaml "
        f"with camera_matrix, the 3x4 numbers of {camera}{size}, and camera_from_lidar, the 3x4 "
        f"numbers of Tr{times} (docs/recordings.md)",
    )


def _tracking(path: Path) -> Problem | None:
    for folder in (path, *(path / split for split in KITTI_SPLITS)):
        sequences = [each for each in _entries(folder / "image_02") if each.is_dir()]
        if any(each.name.isdecimal() for each in sequences) and (folder / "calib").is_dir():
            return Problem(
                path=folder,
                problem=f"is a split of KITTI tracking: a folder for each of {len(sequences)} "
                "sequences, one calibration and one label file for each",
                remedy="make each sequence a recording (docs/recordings.md): its pictures in "
                "images, its sweeps in points, and calibration.yaml with camera_matrix, P2, and "
                "camera_from_lidar, R_rect times Tr_velo_cam (both filled up to 4x4)",
            )
    return None


def _is_drive_of_kitti_360(path: Path) -> bool:
    """Test for a drive's pictures, of fisheye cameras in image_02, or for its sweeps."""
    names = ["image_00/data_rect", "image_02/data_rgb"]
    if path.absolute().parent.name in _KITTI_360_FOLDERS:
        names += ["image_00", "velodyne_points"]
    if not any((path / name).is_dir() for name in names):
        return False
    is_converted = is_recording(path) or lacks_calibration(path)
    return not is_converted and list_drive(path).calibration is None


def _kitti_360(path: Path) -> Problem | None:
    place = path.absolute()
    roots = [place, *([place.parent] if place.name in (*_KITTI_360_FOLDERS, "calibration") else [])]
    is_above = any((root / name).is_dir() for root in roots for name in _KITTI_360_FOLDERS)
    if not (is_above or _is_drive_of_kitti_360(path)):
        return None
    return Problem(
        path=path,
        problem="is a KITTI-360 data set, with pictures, sweeps and calibrations of all drives "
        "in folders of their own",
        remedy="make each drive a recording (docs/recordings.md): its pictures, image_00/data_rect "
        "below data_2d_raw, in images, its sweeps, velodyne_points/data below data_3d_raw, in "
        "points, and calibration.yaml with camera_matrix, P_rect_00 of perspective.txt, and "
        "camera_from_lidar, R_rect_00 times the inverse of calib_cam_to_velo.txt (both filled up "
        "to 4x4)",
    )


def _depth_prediction(path: Path) -> Problem | None:
    if not all((path / name).is_dir() for name in ("image", "intrinsics")):
        return None
    return Problem(
        path=path,
        problem="holds pictures and intrinsics without sparse maps (velodyne_raw), like the test "
        "of KITTI's depth prediction",
        remedy="make it a recording (docs/recordings.md): rename image to images, and write "
        "calibration/NAME.yaml for each picture with camera_matrix, the nine numbers of its "
        "intrinsics",
    )


def _uncalibrated(path: Path) -> Problem | None:
    if not lacks_calibration(path):
        return None
    folders = [each for each in recording_folders(path) if each.part == "calibration"]
    if not any(_entries(path / name) for name in (IMAGES, POINTS)):
        return no_frames(path)
    misnamed = [*misnamed_files(path), *(each.problem for each in find_unread(folders))]
    if misnamed:
        return misnamed[0]
    return Problem(
        path=path,
        problem="holds images or points without a calibration",
        remedy="write calibration.yaml beside them, docs/recordings.md has an example",
    )


def source_to_import(path: Path) -> Problem | None:
    """Problem of data that must be imported as a recording; None: it is not such data."""
    tables = tables_to_import(path)
    if tables is not None:
        return tables
    bags = [each for each in _entries(path) if each.suffix.lower() in BAG_SUFFIXES]
    return _to_import(path, f"holds a ROS bag, {shortened(bags[0].name)}") if bags else None


def tables_to_import(path: Path) -> Problem | None:
    """Problem of a nuScenes data set, which must be imported; None: it is none."""
    is_nuscenes = any(each.is_dir() for each in path.glob("v1.0-*"))
    return _to_import(path, "is a nuScenes data set") if is_nuscenes else None


def _to_import(path: Path, problem: str) -> Problem:
    return Problem(
        path=path, problem=problem, remedy="convert it to a recording: sightline import DATA OUT"
    )


def _unread(path: Path) -> Problem | None:
    """Problem of sensors' folders with only files of other formats, or of another camera."""
    places = [*recording_folders(path), *drive_folders(path)]
    for folder in (path, *(path / split for split in KITTI_SPLITS)):
        places += [] if is_recording(folder) else object_folders(folder)
    unread = [each for each in find_unread(places) if each.all_unread]
    unread += find_unread(drive_folders(path))
    return unread[0].problem if unread else None


def _empty(path: Path) -> Problem | None:
    """Problem of a recording that holds nothing yet."""
    return no_frames(path) if is_recording(path) else None


def _empty_tree(path: Path) -> Problem | None:
    """Problem of KITTI's object tree that holds nothing yet."""
    parts = [path / split / part for split in KITTI_SPLITS for part in ("image_2", "velodyne")]
    there = [f"{part.parent.name}/{part.name}/" for part in parts if part.is_dir()]
    if not there or any(map(_entries, parts)):
        return None
    return Problem(
        path=path,
        problem=f"has no frames: there are no files in {' and '.join(there)}",
        remedy="copy or link the files of KITTI's object tree there",
    )


def _apart(path: Path) -> Problem | None:
    """Problem of KITTI's archives unpacked into separate folders."""
    parts = [
        each
        for each in _entries(path)
        if each.name.startswith("data_object_")
        and any((each / name).is_dir() for name in KITTI_SPLITS)
    ]
    if not parts:
        return None
    return Problem(
        path=path,
        problem="holds KITTI's archives unpacked into separate folders "
        f"({', '.join(each.name for each in parts)})",
        remedy="merge their folders training and testing: training/image_2, "
        "training/velodyne, training/calib, training/label_2",
    )


def _in_depth_tree(path: Path) -> Problem | None:
    """Problem of a drive with depth maps, or of a folder of such drives that is no split."""
    place = path.absolute()
    places = (*sorted(place.glob("*/proj_depth")), place / "proj_depth", place, *place.parents)
    maps = next((each for each in places if each.name == "proj_depth" and each.is_dir()), None)
    if maps is None:
        return None
    split = maps.parent.parent
    is_split_by_drives = split_by_drives(split) is not None
    return Problem(
        path=path,
        problem="is a part of a depth completion tree, but none of its splits",
        remedy=f"give the split, {split}"
        if is_split_by_drives
        else f"rename {split} to train or val, as in KITTI's tree",
    )


def _below(path: Path) -> Problem | None:
    """Problem of a parent folder of data sets."""
    named = [(each, {entry.name for entry in _entries(each)}) for each in _folders_below(path)]
    found: list[Path] = []
    for layouts in (_LAYOUT_NAMES, _FURTHER_NAMES):
        folders = [each for each, names in named if any(layout <= names for layout in layouts)]
        found = found or [each.parent if is_split(each) else each for each in folders]
    found = [each for each in dict.fromkeys(found) if each != path]  # once for both splits
    if not found:
        return None
    if len(found) == 1 and _odometry(found[0]) is None:
        misnamed = misnamed_split(found[0])
        if misnamed is not None:
            return misnamed
    name = shortened(str(found[0]), 200)
    more = "" if len(found) == 1 else f", and {len(found) - 1} more"
    return Problem(
        path=path,
        problem=f"is no data set itself, but {name} in it looks like one{more}",
        remedy="give that folder",
    )


def _folders_below(path: Path) -> Iterator[Path]:
    """Subfolders, up to three levels down, nearer ones first."""
    level = [path]
    for _ in range(3):
        level = sorted(
            each for folder in level for each in _entries(folder)[:_MAX_SEARCHED] if each.is_dir()
        )[:_MAX_SEARCHED]
        yield from level


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(each for each in folder.iterdir() if not is_leftover(each.name))
    except OSError:
        return []

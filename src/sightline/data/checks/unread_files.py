"""Search for ignored files in sensors' folders, so that they are reported."""

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from sightline.data.formats.image_header import IMAGE_SUFFIXES, read_image_header
from sightline.data.formats.point_files import CLOUD_SUFFIXES
from sightline.data.layouts.frame_lists import is_note
from sightline.data.layouts.kitti_trees import (
    CORRUPTED,
    DRIVE_FOLDERS,
    PART_SUFFIXES,
    DriveSplit,
    Part,
    SelectedSplit,
    Velodyne,
    drive_bases,
    list_drive,
    list_files,
    part_folder,
    selection_folder,
)
from sightline.data.layouts.recording_files import (
    CALIBRATION_SUFFIXES,
    CALIBRATIONS,
    DEPTH,
    IMAGES,
    LABELS,
    POINTS,
)
from sightline.files.leftovers import is_companion, is_leftover, remedy_for_endings
from sightline.files.plain_text import shortened
from sightline.files.problem import Problem, read_or_note
from sightline.jobs.output_dirs import MANIFEST_NAME, is_split

_NOTE_SUFFIXES = frozenset(
    (".txt", ".json", ".csv", ".md", ".yaml", ".yml", ".xml", ".ini", ".db", ".html", ".log", "")
)
"""Suffixes of notes, lists and tables, which are allowed beside pictures and clouds."""
_NOTE_STEMS = (
    "timestamps",
    "timestamps_start",
    "timestamps_end",
    "times",
    "readme",
)
"""Names of files that contain no sensor data, even if there are no others."""
_FOLDER_ALIASES: dict[Part, tuple[str, ...]] = {
    "image": ("image", "images", "img", "imgs", "camera", "cameras", "cam", "rgb", "pictures"),
    "points": (
        *("points", "point", "velodyne", "velodynepoints", "lidar", "lidars", "laser", "cloud"),
        *("clouds", "pointcloud", "pointclouds", "pcd", "pcds", "sweeps", "scans"),
    ),
    "objects": ("label", "labels", "annotation", "annotations", "groundtruth", "gt"),
    "calibration": ("calib", "calibs", "calibration", "calibrations"),
}
"""Other common names of a part's folder, only letters; further ones of labels begin with label."""
_OTHER_CAMERA_FOLDERS = ("image_1", "image_3", "image_00", "image_01", "image_03")
"""Folders of other cameras."""
_OTHER_DRIVE_CAMERAS = ("image_03", "image_00", "image_01")  # the other colour camera first
_DRIVE_DATA = "data"  # folder of a drive's files in that of the sensor
_MAX_LISTED = 4  # suffixes or folders listed in a message
_POINT_LABELS = ".label"  # of SemanticKITTI: a class for each point
_MAP_BITS = 16  # per pixel of depth maps and instance maps


@dataclass(frozen=True, kw_only=True, slots=True)
class PartFolder:
    """Folder of a part's files."""

    part: Part
    folder: Path
    suffixes: tuple[str, ...]
    """Suffixes of the files to read, in lower case."""
    only: str = ""
    """Stem of the part's only file; empty: all files of the folder belong to the part."""
    elsewhere: tuple[Path, ...] = ()
    """Other folders where the part may be, read if `folder` holds no files of it."""
    replacements: tuple[Path, ...] = ()
    """Folders of other sensors of this kind, which are never read."""
    unused: tuple[Path, ...] = ()
    """Files for all frames, as another layout has them, which are never read here."""


@dataclass(frozen=True, kw_only=True, slots=True)
class UnreadFiles:
    """Ignored files of a folder."""

    problem: Problem
    part: Part
    all_unread: bool
    """Whether no file of the folder is read."""


def object_folders(folder: Path, velodyne: Velodyne = "velodyne") -> list[PartFolder]:
    """Folders of an object split's parts."""
    places = (folder, folder.parent) if is_split(folder) else (folder,)
    shared = [place / f"{CALIBRATIONS}{end}" for place in places for end in CALIBRATION_SUFFIXES]
    return [
        PartFolder(
            part=part,
            folder=folder / part_folder(part, velodyne),
            suffixes=suffixes,
            unused=tuple(shared) if part == "calibration" else (),
        )
        for part, suffixes in PART_SUFFIXES.items()
    ]


def recording_folders(folder: Path) -> list[PartFolder]:
    """Folders of a recording's parts."""
    places: tuple[tuple[Part, str, tuple[str, ...]], ...] = (
        ("image", IMAGES, IMAGE_SUFFIXES),
        ("points", POINTS, CLOUD_SUFFIXES),
        ("objects", LABELS, PART_SUFFIXES["objects"]),
        ("depth", DEPTH, PART_SUFFIXES["depth"]),
        ("calibration", CALIBRATIONS, CALIBRATION_SUFFIXES),
    )
    shared = PartFolder(
        part="calibration", folder=folder, suffixes=CALIBRATION_SUFFIXES, only=CALIBRATIONS
    )
    return [
        *(
            PartFolder(part=part, folder=folder / name, suffixes=suffixes)
            for part, name, suffixes in places
        ),
        shared,
    ]


def drive_folders(folder: Path) -> list[PartFolder]:
    """Folders of a raw drive's sensors."""
    files = list_drive(folder)
    cameras = [folder / name / end for name in _OTHER_DRIVE_CAMERAS for end in (_DRIVE_DATA, "")]
    places: tuple[tuple[Part, Path, tuple[Path, ...]], ...] = (
        ("image", files.image_folder, tuple(cameras)),
        ("points", files.points_folder, ()),
    )
    return [
        PartFolder(
            part=part,
            folder=place,
            suffixes=PART_SUFFIXES[part],
            elsewhere=tuple(
                folder / name for name in DRIVE_FOLDERS[part] if folder / name != place
            ),
            replacements=others,
        )
        for part, place, others in places
    ]


def depth_folders(root: Path, split: DriveSplit | SelectedSplit) -> list[PartFolder]:
    """Folders of a depth completion split; its sparse maps count as points."""
    places: list[tuple[Part, Path]] = []
    if split == "train" or split == "val":
        bases = [base for base in drive_bases(root, split) if base.is_dir()]
        maps = [place for base in bases for place in base.glob("*/proj_depth/*/image_0[23]")]
        places = [
            ("depth" if place.parent.name == "groundtruth" else "points", place)
            for place in sorted(maps)
        ]
    else:
        folder = selection_folder(root, split)
        places = [
            ("image", folder / "image"),
            ("points", folder / "velodyne_raw"),
            ("depth", folder / "groundtruth_depth"),
        ]
    suffixes = {"image": IMAGE_SUFFIXES, "points": (".png",), "depth": (".png",)}
    return [PartFolder(part=part, folder=place, suffixes=suffixes[part]) for part, place in places]


def find_unread(folders: Sequence[PartFolder]) -> list[UnreadFiles]:
    """Find folders with ignored files or subfolders, links to nothing and files for folders.

    Notes (such as timestamps.txt) beside other files, and files with the same name as a read one
    are not counted; beside read files, subfolders count only with files of the part. Hidden files
    are counted apart, if their suffix is one of the part's.
    """
    found = [
        unread
        for each in folders
        if not each.only
        for unread in (
            _find_lost(each) or _find_unread_in(each),
            _find_hidden_in(each),
            _find_misnamed(each) or _find_other_sensor(each, folders),
            *_find_elsewhere(each),
            *_find_unused(each),
            _find_replacement(each),
        )
    ]
    return [each for each in found if each is not None]


def find_name_clashes(places: Iterable[PartFolder]) -> list[Problem]:
    """Find files that hide each other, here or on a case-insensitive file system."""
    problems: list[Problem] = []
    first: dict[str, str] = {}
    for place in places:
        read = list_files(place.folder, place.suffixes)
        problems += [
            Problem(
                path=path,
                problem=f"is not read, because {read[path.stem].name} has the same name",
                remedy="keep one of them, or rename one",
            )
            for path in (sorted(place.folder.iterdir()) if read else ())
            if read.get(path.stem, path) != path
            and path.suffix.lower() in place.suffixes
            and not path.name.startswith(".")
            and place.only in ("", path.stem)
        ]
        names = {} if place.only else {name: read[name] for name in read if not is_note(name)}
        for stem, path in names.items():
            plain = unicodedata.normalize("NFC", stem).casefold()
            other = first.setdefault(plain, stem)
            if other != stem:
                problem = f"differs from {shortened(other)} only in case or in the encoding of "
                problem += "accents"
                remedy = (
                    "rename one: a frame's files have one name, and on some disks results of one "
                    "frame overwrite those of the other"
                )
                problems.append(Problem(path=path, problem=problem, remedy=remedy))
    return problems


def _find_lost(place: PartFolder) -> UnreadFiles | None:
    """Find a link to nothing, such as to a disk that is not mounted, or a file for a folder."""
    folder = place.folder
    if folder.is_dir() or not os.path.lexists(folder):
        return None
    problem, remedy = "is no folder", "put its files into one"
    if folder.is_symlink() and not folder.exists():
        problem = f"is a link to {shortened(str(folder.readlink()), 200)}, which cannot be reached"
        remedy = "mount its disk or correct the link"
    described = Problem(path=folder, problem=problem, remedy=f"{remedy}, or remove it")
    return UnreadFiles(problem=described, part=place.part, all_unread=True)


def _find_misnamed(place: PartFolder) -> UnreadFiles | None:
    """Find a folder of the part with another name: in another case, or if there is none, usual."""
    is_missing = not place.folder.is_dir()
    aliases = _FOLDER_ALIASES.get(place.part, ()) if is_missing else ()
    home = _home(place)
    for other in sorted(home.parent.iterdir()) if home.parent.is_dir() else ():
        letters = re.sub("[^a-z]", "", other.name.lower())
        is_usual = letters in aliases or (letters.startswith("label") and "label" in aliases)
        if (
            not (is_usual or other.name.lower() == home.name.lower())
            or other.name in (home.name, *_OTHER_CAMERA_FOLDERS)
            or not other.is_dir()
            or (not is_missing and other.samefile(home))  # a disk without case
        ):
            continue
        inner = other / _DRIVE_DATA
        files = list_files(inner if inner.is_dir() else other, place.suffixes)
        if files:
            described = Problem(
                path=other,
                problem=f"holds {len(files)} files that are not read, expected them in {home.name}",
                remedy=f"rename the folder to {home.name} or move it away"
                if is_missing
                else f"move them to {home.name}, or the folder away",
            )
            if place.part == "calibration" and CALIBRATIONS in files:  # that of all frames
                described = Problem(
                    path=files[CALIBRATIONS],
                    problem="is not read in a folder of its own",
                    remedy=f"move it one folder up, into {home.parent}",
                )
            is_needed = place.part != "objects"  # labels may be missing
            all_unread = is_missing and is_needed
            return UnreadFiles(problem=described, part=place.part, all_unread=all_unread)
    return None


def describe_other_sensors(folders: Sequence[PartFolder]) -> tuple[str, ...]:
    """Describe folders of further cameras and LiDARs beside those that are read, in a clause."""
    found = {
        folder.name
        for place in folders
        if place.folder.is_dir()
        for folder in _other_sensors(place, folders)
    }
    if not found:
        return ()
    named = ", ".join(map(shortened, sorted(found)[:_MAX_LISTED]))
    more = f" and {len(found) - _MAX_LISTED} more" if len(found) > _MAX_LISTED else ""
    return (f"not read: {named}{more}, whose files have the frames' names",)


def _find_other_sensor(place: PartFolder, folders: Sequence[PartFolder]) -> UnreadFiles | None:
    """Find a folder, called anything, with files of the frames for a sensor that has no folder."""
    others = {} if place.folder.is_dir() else _other_sensors(place, folders)
    for folder, number in others.items():
        name = _home(place).name
        described = Problem(
            path=folder,
            problem=f"holds {number} files with the frames' names that are not read, and there is "
            f"no folder {name}",
            remedy=f"rename it to {name} if the calibration is its sensor's, or move it away",
        )
        return UnreadFiles(problem=described, part=place.part, all_unread=False)
    return None


def _other_sensors(place: PartFolder, folders: Sequence[PartFolder]) -> dict[Path, int]:
    """Find unread folders beside a sensor's with files of its kind for most of their frames.

    Results of a command, masks of a corrupted tree, and maps with 16 bits are no sensor's.

    Returns:
        The number of files of each folder.
    """
    home = _home(place)
    is_sensor = place.part in ("image", "points") and not place.replacements
    if not is_sensor or not home.parent.is_dir() or (home.parent / CORRUPTED).is_dir():
        return {}
    read = [list_files(each.folder, each.suffixes) for each in folders if not each.only]
    names = {name for files in read for name in files}
    known = {_home(each).name.lower() for each in folders} | set(get_args(Velodyne))
    found: dict[Path, int] = {}
    for other in sorted(home.parent.iterdir()):
        if other.name.lower() in known or is_leftover(other.name):
            continue
        inner = other / _DRIVE_DATA
        files = list_files(inner if inner.is_dir() else other, place.suffixes)
        if 2 * len(names & set(files)) <= len(files) or (other / MANIFEST_NAME).exists():
            continue
        if place.part != "image" or _is_picture(next(iter(files.values()))):
            found[other] = len(files)
    return found


def _is_picture(path: Path) -> bool:
    header = read_or_note(read_image_header, path, [])
    return header is None or header.bits_per_channel != _MAP_BITS


def _home(place: PartFolder) -> Path:
    """Folder of a sensor, one above that of its files in a raw drive."""
    return place.folder.parent if place.folder.name == _DRIVE_DATA else place.folder


def _find_elsewhere(place: PartFolder) -> list[UnreadFiles]:
    """Find files of the part in other folders where they are read if this one has none."""
    num_files = {each: len(list_files(each, place.suffixes)) for each in place.elsewhere}
    problems = [
        Problem(
            path=folder,
            problem=f"holds {number} files that are not read, because {place.folder} has some, too",
            remedy="keep those of one folder, and move the others away",
        )
        for folder, number in num_files.items()
        if number
    ]
    return [UnreadFiles(problem=each, part=place.part, all_unread=False) for each in problems]


def _find_unused(place: PartFolder) -> list[UnreadFiles]:
    """Find files for all frames, such as a recording's calibration in an object tree."""
    problems = [
        Problem(
            path=path,
            problem=f"is not read: in KITTI's object trees each frame has a file in "
            f"{place.folder.name}",
            remedy="make the data a recording (docs/recordings.md) if its entries are needed, or "
            "remove it",
        )
        for path in place.unused
        if path.is_file()
    ]
    return [UnreadFiles(problem=each, part=place.part, all_unread=False) for each in problems]


def _find_replacement(place: PartFolder) -> UnreadFiles | None:
    """Find files of another camera, where the one that is read has no folder with files."""
    if not place.replacements or list_files(place.folder, place.suffixes):
        return None
    for folder in place.replacements:
        number = len(list_files(folder, place.suffixes))
        if number:
            described = Problem(
                path=folder,
                problem=f"holds {number} images that are not read: only those of camera 02 are, "
                f"and {place.folder} has none",
                remedy="add those, or rename this camera's folder to image_02 and its P_rect of "
                "calib_cam_to_cam.txt to P_rect_02",
            )
            return UnreadFiles(problem=described, part=place.part, all_unread=False)
    return None


def _find_hidden_in(place: PartFolder) -> UnreadFiles | None:
    """Find hidden files; macOS's companions of files (`._NAME`) are no data."""
    if not place.folder.is_dir():
        return None
    hidden = sorted(
        path.name
        for path in place.folder.iterdir()
        if path.name.startswith(".")
        and path.suffix.lower() in place.suffixes
        and not path.name.startswith("._")
    )
    if not hidden:
        return None
    files = "a hidden file that is" if len(hidden) == 1 else f"{len(hidden)} hidden files that are"
    described = Problem(
        path=place.folder,
        problem=f"holds {files} not read, such as {shortened(hidden[0])}",
        remedy="remove the dot before their names, or move them away",
    )
    all_unread = not list_files(place.folder, place.suffixes)
    return UnreadFiles(problem=described, part=place.part, all_unread=all_unread)


def _find_unread_in(place: PartFolder) -> UnreadFiles | None:
    if not place.folder.is_dir():
        return None
    read = list_files(place.folder, place.suffixes)
    below: list[Path] = []
    files: list[Path] = []
    for path in place.folder.iterdir():
        if not is_leftover(path.name) and path.suffix.lower() not in place.suffixes:
            (below if path.is_dir() else files).append(path)
    unread = _without_notes(files, read)
    expected = f"expected {', '.join(place.suffixes)}"
    remedy = remedy_for_endings(path.name for path in unread) or (
        "convert them" if set(place.suffixes) & {".bin", *IMAGE_SUFFIXES} else "rename them"
    )
    if place.part == "objects" and any(path.suffix == _POINT_LABELS for path in unread):
        expected += ", with labels of objects, not of points"
        remedy = "write such labels"
    if unread:
        counts = Counter(path.suffix for path in unread)
        listed = ", ".join(
            f"{num} {shortened(end, 12) or 'without an ending'}"
            for end, num in counts.most_common(_MAX_LISTED)
        )
        beside = f", beside {len(read)} that are" if read else ""
        problem = f"holds {len(unread)} files that are not read ({listed}){beside}"
    else:
        fault = _describe_subfolders(below, read, place)
        if fault is None:
            return None
        problem, remedy = fault
    described = Problem(
        path=place.folder, problem=f"{problem}, {expected}", remedy=f"{remedy} or move them away"
    )
    return UnreadFiles(problem=described, part=place.part, all_unread=not read)


def _without_notes(files: Sequence[Path], read: Mapping[str, Path]) -> list[Path]:
    """Leave out notes and files that belong to a read one: 000001.xmp, 000001.png.bak."""
    note_suffixes: Collection[str] = _NOTE_SUFFIXES if read else ()
    names = {path.name for path in read.values()}
    return [
        path
        for path in files
        if path.suffix.lower() not in note_suffixes
        and path.stem.lower() not in _NOTE_STEMS
        and path.stem not in read
        and not is_companion(path.name, names)
    ]


def _describe_subfolders(
    below: Sequence[Path], read: Collection[str], place: PartFolder
) -> tuple[str, str] | None:
    """Describe subfolders with files, which are not searched, and their remedy; None: none."""
    if not read and any(any(each.iterdir()) for each in below[:_MAX_LISTED]):
        return (
            f"holds no files, only {len(below)} folders such as {shortened(min(below).name)}, "
            "which are not searched",
            "move their files up",
        )
    num_files = {
        each: sum(not path.is_dir() for path in list_files(each, place.suffixes).values())
        for each in below
        if read
    }
    full = [each for each, number in num_files.items() if number]
    if not full:
        return None
    return (
        f"holds {sum(num_files.values())} files in folders such as {shortened(min(full).name)}, "
        f"which are not searched, beside {len(read)} that are read",
        "move their files up if they belong to frames,",
    )

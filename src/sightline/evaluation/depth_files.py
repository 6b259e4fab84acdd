"""Depth maps of two folders matched by frame, also between KITTI's layouts."""

import os
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

from sightline.data.formats.map_png import STEPS_PER_METRE, read_depth_png
from sightline.data.layouts.kitti_trees import describe_absent
from sightline.files.leftovers import is_leftover
from sightline.files.plain_text import shortened

_TRUTH_FOLDER: Final = "groundtruth_depth"  # of the depth benchmark's selection
_DEPTH_PLACES: Final = ("training/depth", "depth")  # of simulated trees and recordings
_OF_DRIVE: Final = re.compile(
    r"/([^/]+)/proj_depth/(?:groundtruth|velodyne_raw)/(image_0\d)/(\d+)$"
)
_OF_SELECTION: Final = re.compile(r"_(?:groundtruth_depth|velodyne_raw)_(\d+_image_0\d)$")
_SWEEPS: Final = ".bin"
_OTHER_FORMATS: Final = (
    *(".npy", ".npz", ".mat", ".h5"),
    *(".tif", ".tiff", ".exr", ".pfm", ".jpg", ".jpeg", ".raw"),
)
"""Suffixes of depth maps that other programs write."""
_NAME: Final = (
    "name a folder of 16-bit depth PNGs, such as velodyne_raw or groundtruth_depth of KITTI's "
    "depth benchmark"
)
_WRITE: Final = (
    f"write predictions as PNGs of one channel with 16 bits, metres times {STEPS_PER_METRE}, under "
    "the names of the ground truth (sightline.data.formats.map_png.write_depth_png does)"
)


class DepthFiles(NamedTuple):
    """Depth maps of one frame."""

    name: str
    prediction: Path
    truth: Path
    sparse: Path | None


def match_depth_files(
    predictions: Path, truth: Path, sparse: Path | None
) -> tuple[list[DepthFiles], int]:
    """Match the depth maps of each frame in folders, and count the other predictions.

    Frames have the same name if their maps have the same place in their folders, or in one of the
    layouts of KITTI's depth benchmark. Where one folder tells drive and camera, as those of
    annotated drives do, the other need not, if the files' names then differ.

    Raises:
        ValueError: A folder is missing or empty, two of its maps are of one frame, or it lacks a
            frame with ground truth.
        FileError: It lacks one whose ground truth is no depth map.
    """
    true = _list_maps(truth, "groundtruth")
    predicted = _as_named(_list_maps(predictions, remedy=_WRITE), true)
    given = {} if sparse is None else _as_named(_list_maps(sparse, "velodyne_raw"), true)
    for folder, files, noun in ((predictions, predicted, "predictions"), (sparse, given, "maps")):
        missing = sorted(true.files.keys() - files.keys())
        if folder is not None and missing:
            other = _find_maps(truth) or _folder_of_camera(true)
            if other is None:
                read_depth_png(true.files[missing[0]])  # refuses pictures of a data set
            scored = other or "a folder with the truth of fewer images"
            below = _folder_below(folder, files, true)
            remedy = f"predict them, or score against {scored}"
            raise ValueError(
                f"{folder} lacks {noun} for {len(missing)} of the {len(true.files)} images with "
                f"ground truth in {truth} ({describe_absent(missing)})"
                f"{_others(folder, files, true)}: {f'give {below}' if below else remedy}"
            )
    frames = [
        DepthFiles(name, predicted[name], path, given.get(name))
        for name, path in sorted(true.files.items())
    ]
    return frames, len(predicted) - len(frames)


@dataclass(frozen=True, slots=True)
class _Maps:
    """Depth maps of a folder."""

    files: dict[str, Path] = field(default_factory=dict)
    """Files by frame."""
    frames: dict[str, str] = field(default_factory=dict)
    """Frames by the file's place in the folder, without suffix."""

    def by_file_name(self) -> dict[str, str]:
        """Frames by the file's name without suffix; empty if two have one name."""
        names = {Path(place).name: frame for place, frame in self.frames.items()}
        return names if len(names) == len(self.frames) else {}

    def tells_drives(self) -> bool:
        """Check if files are in folders of annotated drives."""
        return any(_is_of_drive(path) for path in self.files.values())


def _as_named(maps: _Maps, true: _Maps) -> Mapping[str, Path]:
    """Name maps as the ground truth, if only one of both folders tells drive and camera."""
    if maps.files.keys().isdisjoint(true.files):
        by_place = {true.frames.get(frame, frame): path for frame, path in maps.files.items()}
        if not by_place.keys().isdisjoint(true.files):
            return by_place
        by_place = {place: maps.files[frame] for place, frame in maps.frames.items()}
        if not by_place.keys().isdisjoint(true.files):
            return by_place
        names, true_names = maps.by_file_name(), true.by_file_name()
        if names and true_names and maps.tells_drives() != true.tells_drives():
            return {true_names.get(name, frame): maps.files[frame] for name, frame in names.items()}
    return maps.files


def _others(folder: Path, files: Mapping[str, Path], true: _Maps) -> str:
    """Describe maps of which none has the name of a frame with ground truth."""
    if not files.keys().isdisjoint(true.files):
        return ""
    name = shortened(min(files.values()).relative_to(folder).as_posix())
    return f", as none of its {len(files):,} maps, such as {name}, has the name of one"


def _folder_below(folder: Path, files: Mapping[str, Path], true: _Maps) -> Path | None:
    """Folder below one with all of its maps, under names of the ground truth; None: no such."""
    folders = {path.parent for path in files.values()}
    has_names = {path.stem for path in files.values()} & true.files.keys()
    return folders.pop() if has_names and len(folders) == 1 and folder not in folders else None


def _folder_of_camera(true: _Maps) -> Path | None:
    """Folder of one camera of one annotated drive; None: the maps are in none."""
    return next((path.parent for path in true.files.values() if _is_of_drive(path)), None)


def _is_of_drive(path: Path) -> bool:
    return _OF_DRIVE.search(f"{os.path.realpath(path.parent)}/{path.stem}") is not None


def _find_maps(folder: Path) -> Path | None:
    """Find the folder of true depth maps within a data set."""
    places = (folder / place for place in _DEPTH_PLACES)
    found = next((place for place in places if place.is_dir()), None)
    is_truth = folder.name == _TRUTH_FOLDER
    return found or (None if is_truth else next(folder.rglob(_TRUTH_FOLDER), None))


def _list_maps(folder: Path, kind: str = "", *, remedy: str = _NAME) -> _Maps:
    """List depth maps; where annotated drives hold two kinds, those of `kind`.

    Raises:
        ValueError: There is no folder, no map, or two of one frame.
    """
    if not folder.is_dir():
        fault = "is a file where the other is a folder" if folder.exists() else "does not exist"
        raise ValueError(f"{folder} {fault}: give two folders of depth PNGs, or two files")
    root, mark = os.path.realpath(folder), f"/proj_depth/{kind}/"
    paths = [path.relative_to(folder) for path in sorted(folder.rglob("*.[pP][nN][gG]"))]
    # In hidden folders are unfinished files.
    paths = [each for each in paths if not any(map(is_leftover, each.parts))]
    of_kind = [each for each in paths if mark in f"{root}/{each.as_posix()}"]
    maps = _Maps()
    for path in of_kind or paths:
        place = path.with_suffix("").as_posix()
        frame = _frame_name(f"{root}/{place}", place)
        if frame in maps.files:
            raise ValueError(
                f"{folder} holds {maps.files[frame].relative_to(folder)} and {path}, which both "
                f"stand for frame {frame}: remove one of them"
            )
        maps.files[frame] = folder / path
        maps.frames[place] = frame
    if not maps.files:
        raise ValueError(f"{folder} holds {_describe_others(folder)}: {remedy}")
    return maps


def _describe_others(folder: Path) -> str:
    """Describe the files of a folder without PNGs, by the most frequent suffix of a depth map."""
    counts = Counter(path.suffix.lower() for path in folder.rglob("*.*") if path.is_file())
    found = [(counts[suffix], suffix) for suffix in (*_OTHER_FORMATS, _SWEEPS) if counts[suffix]]
    if not found:
        return "no PNG"
    number, suffix = max(found)
    of_sweeps = ", which are sweeps," if suffix == _SWEEPS else ""
    return f"{number:,} {suffix} files{of_sweeps} and no PNG"


def _frame_name(whole: str, place: str) -> str:
    """Unify the names of a frame in the benchmark's archives; others are the place in the folder.

    Args:
        whole: Whole path without suffix, as the folder may lie within an annotated drive.
        place: Path in the folder.
    """
    if match := _OF_DRIVE.search(whole):
        drive, camera, number = match.groups()
        return f"{drive}_image_{number}_{camera}"
    return _OF_SELECTION.sub(r"_image_\1", place)

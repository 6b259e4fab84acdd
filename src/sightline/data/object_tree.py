"""Lists the files of KITTI's object tree without reading them."""

import difflib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from sightline.data.image_header import IMAGE_SUFFIXES
from sightline.files.plain_text import shortened

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
        path.suffix.lower() in PART_SUFFIXES["points"] and not path.name.startswith(".")
        for path in folder.iterdir()
    )


def list_object_frames(
    folder: Path, parts: Collection[Part], velodyne: Velodyne = "velodyne"
) -> dict[str, ObjectFrame]:
    """List all frames of `folder` (e.g. `training`) with any of the parts, sorted by name.

    Hidden files and files without KITTI's suffixes (in any case) are ignored.
    """
    files = {
        part: list_files(folder / part_folder(part, velodyne), PART_SUFFIXES[part])
        for part in parts
    }
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


def list_files(folder: Path, suffixes: Sequence[str]) -> dict[str, Path]:
    """List the files of a folder with one of the suffixes, in any case, sorted by stem.

    Of two files with the same stem the earlier suffix wins, lower case first. A missing folder is
    empty. Hidden files are left out.

    Args:
        folder: Folder of the files.
        suffixes: Suffixes in lower case, with their dots.
    """
    if not folder.is_dir():
        return {}
    paths = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in suffixes and not path.name.startswith(".")
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

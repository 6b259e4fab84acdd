"""Which files an object data set has: KITTI's folder tree, listed without reading them."""

import difflib
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from sightline.data.image_header import IMAGE_SUFFIXES
from sightline.data.plain_text import shortened

OBJECT_SPLITS: Final = ("training", "testing")
CORRUPTED: Final = "corruption"
"""The folder, in a split, of what was done to each frame of it; sound trees have none."""
Velodyne = Literal["velodyne", "velodyne_reduced"]
Part = Literal["image", "points", "calibration", "objects", "depth"]
"""`depth` is no part of KITTI's own tree: simulated ones have dense true depth, as 16-bit PNGs."""

PART_SUFFIXES: Final[dict[Part, tuple[str, ...]]] = {
    "image": IMAGE_SUFFIXES,
    "points": (".bin",),
    "calibration": (".txt",),
    "objects": (".txt",),
    "depth": (".png",),
}
"""How the files of each part end, in lower case; other endings are not read."""
_COMPARED = 10_000  # of so many frames the names are compared with one that was misspelt
_NAMED = 5  # so many frames an error lists by name


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectFrame:
    """The files of one frame; None where there is none."""

    sample_id: str
    image: Path | None = None
    points: Path | None = None
    calibration: Path | None = None
    objects: Path | None = None
    depth: Path | None = None


def part_folder(part: Part, velodyne: Velodyne = "velodyne") -> str:
    """The name of a part's folder: KITTI's, where KITTI has the part."""
    if part == "points":
        return velodyne
    names = {"image": "image_2", "calibration": "calib", "objects": "label_2", "depth": "depth"}
    return names[part]


def find_velodyne(folder: Path) -> Velodyne:
    """The sweeps' folder of a split: `velodyne`, unless `velodyne_reduced` alone holds sweeps."""
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
    """All frames of which `folder` (e.g. `training`) holds any of the parts, by name, sorted.

    Files that do not end as KITTI's do (in any case), and hidden ones, are not looked at.
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
    """The files of a folder that end in one of the suffixes, in any case, by stem, sorted.

    Of two with the same stem the one with the earlier suffix counts, small letters first; a folder
    that is not there is empty; hidden files are left out.

    Args:
        folder: Where they lie.
        suffixes: In lower case, with their dots.
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


def describe_absent(frame_ids: Sequence[str]) -> str:
    """The first few of the frames, and how many more there are."""
    named = ", ".join(map(shortened, frame_ids[:_NAMED]))
    more = len(frame_ids) - _NAMED
    return f"{named} and {more} more" if more > 0 else named


def suggest_frames(frame_id: str, known: Sequence[str]) -> str:
    """What somebody may have meant who asked for a frame that is not there."""
    number = int(frame_id) if frame_id.isascii() and frame_id.isdecimal() else None
    same = [
        each
        for each in known
        if number is not None and each.isascii() and each.isdecimal() and int(each) == number
    ]
    close = same or difflib.get_close_matches(frame_id, known[:_COMPARED], n=3)
    meant = f"perhaps {' or '.join(map(shortened, close))} is meant; " if close else ""
    return f"{meant}there are {len(known):,}, from {shortened(known[0])} to {shortened(known[-1])}"

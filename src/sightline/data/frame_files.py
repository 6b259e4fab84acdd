"""Folders with one file per frame: labels, results."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from sightline.files.plain_text import shortened

_MAX_SEARCHED = 50  # largest number of searched folders and frames
_SUFFIX = ".txt"
_RECORD_SUFFIX = ".json"
_MAX_LISTED = 4  # suffixes in a description


def require_frame_files(folder: Path, names: Sequence[str], kind: str, remedy: str) -> None:
    """Checks that every frame has its file, before any is read.

    Args:
        folder: Folder with NAME.txt for each frame.
        names: Names of the frames.
        kind: Kind of the files, for errors.
        remedy: Remedy for a missing file, for errors.

    Raises:
        ValueError: There is no such folder, or frames have no file in it; contains their number.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; give the folder of the {kind} files")
    present = {path.name for path in folder.iterdir()}
    missing = [name for name in names if f"{name}{_SUFFIX}" not in present]
    if missing:
        elsewhere = locate_frame_files(folder, names) if len(missing) == len(names) else None
        raise ValueError(
            f"{folder} has no {kind} file for {len(missing):,} of {len(names):,} frames, the first "
            f"is {shortened(missing[0])}{_SUFFIX}: {elsewhere or remedy}"
        )


def have_equal_files(first: Path, second: Path, names: Sequence[str]) -> bool:
    """Whether two folders have identical files for each frame, or both have none."""
    if first.resolve() == second.resolve():
        return True
    pairs = ((first / f"{name}{_SUFFIX}", second / f"{name}{_SUFFIX}") for name in names)
    return all(_content(one) == _content(other) for one, other in pairs)


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


def describe_left_out(folder: Path) -> str | None:
    """Describe files with other suffixes and subfolders, with counts; None: there are none.

    Hidden files and the record of the command that wrote the results (.json) are not counted.
    """
    entries = [each for each in sorted(folder.iterdir()) if not each.name.startswith(".")]
    folders = [each for each in entries if each.is_dir()]
    files = [
        each for each in entries if each.is_file() and each.suffix not in (_SUFFIX, _RECORD_SUFFIX)
    ]
    parts = []
    for ending, count in Counter(each.suffix for each in files).most_common(_MAX_LISTED):
        first = next(each.name for each in files if each.suffix == ending)
        named = f"{shortened(ending, 12)} " if ending else ""
        kind = f"{named}file{'' if count == 1 else 's'}"
        parts.append(f"{count:,} {kind} (the first is {shortened(first)})")
    if folders:
        below = sum(1 for each in folders[:_MAX_SEARCHED] for _ in each.glob(f"*{_SUFFIX}"))
        kind = "folder" if len(folders) == 1 else "folders"
        first = shortened(folders[0].name)
        parts.append(
            f"{len(folders):,} {kind} (the first is {first}) with {below:,} {_SUFFIX} files"
        )
    return ", ".join(parts) or None


def locate_frame_files(folder: Path, names: Sequence[str]) -> str | None:
    """Remedy for a folder without files of the frames: their folder, or the names found."""
    entries = sorted(folder.iterdir())
    for below in [each for each in entries if each.is_dir()][:_MAX_SEARCHED]:
        if any((below / f"{name}{_SUFFIX}").is_file() for name in names[:_MAX_SEARCHED]):
            return f"they are in {below}, as KITTI's own program writes them; name that folder"
    files = [each for each in entries if each.is_file() and not each.name.startswith(".")]
    others = [each for each in files if each.suffix == _SUFFIX]
    if others:
        return (
            f"it holds {len(others):,} files of other frames, such as {shortened(others[0].name)}; "
            "name a list of those frames, or another folder"
        )
    if files:
        return (
            f"it holds {len(files):,} files of another format, such as {shortened(files[0].name)}; "
            f"write one NAME{_SUFFIX} for each frame"
        )
    return None

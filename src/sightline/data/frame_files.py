"""One file for each frame: label files, result files."""

from collections.abc import Sequence
from pathlib import Path

from sightline.data.plain_text import shortened

_LOOKED_AT = 50  # folders and frames
_SUFFIX = ".txt"


def require_frame_files(folder: Path, names: Sequence[str], kind: str, remedy: str) -> None:
    """Finds out which frames lack their file before any is read.

    Args:
        folder: Holds NAME.txt for each frame.
        names: The frames.
        kind: What the files are, for errors.
        remedy: What to do where one is missing, for errors.

    Raises:
        ValueError: There is no such folder, or a frame has no file in it; says how many.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; give the one that holds the {kind} files")
    present = {path.name for path in folder.iterdir()}
    missing = [name for name in names if f"{name}{_SUFFIX}" not in present]
    if missing:
        elsewhere = where_frame_files_are(folder, names) if len(missing) == len(names) else None
        raise ValueError(
            f"{folder} has no {kind} file for {len(missing):,} of {len(names):,} frames, the first "
            f"of them {shortened(missing[0])}{_SUFFIX}: {elsewhere or remedy}"
        )


def hold_the_same(first: Path, second: Path, names: Sequence[str]) -> bool:
    """Whether two folders have the same file for each frame, byte by byte, or both have none."""
    if first.resolve() == second.resolve():
        return True
    pairs = ((first / f"{name}{_SUFFIX}", second / f"{name}{_SUFFIX}") for name in names)
    return all(_content(one) == _content(other) for one, other in pairs)


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


def where_frame_files_are(folder: Path, names: Sequence[str]) -> str | None:
    """Remedy where a folder has no file of any frame: where they are, or whose there are."""
    entries = sorted(folder.iterdir())
    for below in [each for each in entries if each.is_dir()][:_LOOKED_AT]:
        if any((below / f"{name}{_SUFFIX}").is_file() for name in names[:_LOOKED_AT]):
            return f"they are in {below}, as KITTI's own program lays them out; name that folder"
    files = [each for each in entries if each.is_file() and not each.name.startswith(".")]
    others = [each for each in files if each.suffix == _SUFFIX]
    if others:
        return (
            f"it holds {len(others):,} of other frames, such as {shortened(others[0].name)}; name "
            "a list of those, or the folder of these"
        )
    if files:
        return (
            f"it holds {len(files):,} files of another format, such as {shortened(files[0].name)}; "
            f"write one NAME{_SUFFIX} for each frame"
        )
    return None

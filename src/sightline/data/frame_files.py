"""One file for each frame: label files, result files."""

from collections.abc import Sequence
from pathlib import Path


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
    missing = [name for name in names if f"{name}.txt" not in present]
    if missing:
        raise ValueError(
            f"{folder} has no {kind} file for {len(missing):,} of {len(names):,} frames, the first "
            f"of them {missing[0]}.txt: {remedy}"
        )

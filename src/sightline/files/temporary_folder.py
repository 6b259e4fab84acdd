"""Hidden temporary folders for atomic writes, and removal of leftovers of killed processes."""

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

_PREFIX = ".sightline-"
_NAME = re.compile(rf"{re.escape(_PREFIX)}[a-z0-9_]{{8}}")  # as `tempfile` makes them


@contextmanager
def temporary_folder(target: Path) -> Iterator[Path]:
    """Create a hidden folder next to a file's target, and remove it at the end of the block.

    Only a killed process leaves its folder behind; the next write to the same target removes it. A
    folder is locked while its process lives, on any machine. On a file system without locks nothing
    is removed.

    Args:
        target: The file. Its parent folder is created if missing.

    Raises:
        ValueError: The folder cannot be written to.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary, lock = make_locked(target.parent)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(
            f"{target} cannot be written: folder {target.parent}: {reason}; make it writable or "
            "choose another output folder"
        ) from error
    try:
        yield temporary
    finally:
        remove_locked(temporary, lock)


def make_locked(folder: Path) -> tuple[Path, int]:
    """Create a hidden folder in another, after the removal of what killed processes left there.

    Returns:
        The folder, and the descriptor of its lock: see `temporary_folder`.

    Raises:
        OSError: The folder cannot be written to.
    """
    with contextlib.suppress(PermissionError):  # it cannot be listed
        _remove_leftovers(folder)
    return _make_locked(folder)


def remove_locked(folder: Path, lock: int) -> None:
    """Remove a folder from `make_locked`, and release its lock."""
    shutil.rmtree(folder, ignore_errors=True)
    os.close(lock)


def final_path(path: Path) -> Path:
    """Compute the final path of a file being written, for example in a `temporary_folder`."""
    return path.parent.parent / path.name if is_temporary(path.parent.name) else path


def is_temporary(name: str) -> bool:
    """Test if a name is that of a temporary folder; users may have others with its prefix."""
    return _NAME.fullmatch(name) is not None


def _make_locked(folder: Path) -> tuple[Path, int]:
    """Create a folder, and return it with the descriptor of its lock."""
    while True:
        temporary = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
        try:
            lock = os.open(temporary, os.O_RDONLY)
        except FileNotFoundError:  # removed as a leftover before it was locked
            continue
        if _try_lock(lock) and temporary.exists():
            return temporary, lock
        os.close(lock)


def _try_lock(lock: int) -> bool:
    """Try to lock a new folder: False if another process removes it; True without lock support."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@lru_cache(maxsize=1024)  # once for each folder: it lists all that is there
def _remove_leftovers(folder: Path) -> None:
    with os.scandir(folder) as entries:
        left = [
            entry.path
            for entry in entries
            if is_temporary(entry.name) and entry.is_dir(follow_symlinks=False)
        ]
    for path in left:
        with contextlib.suppress(OSError):  # in use, another user's, or gone meanwhile
            lock = os.open(path, os.O_RDONLY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)

"""Hidden folders in which files are written aside, and what killed processes leave of them."""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

_PREFIX = ".sightline-"


@contextmanager
def folder_beside(target: Path) -> Iterator[Path]:
    """A new hidden folder next to where a file shall stand; it goes, however the block ends.

    Only a killed process leaves one. The first file that another process writes to the same place
    removes it: a folder is locked as long as its process lives, wherever that runs. Where the file
    system has no locks nothing is removed.

    Args:
        target: The file. Its folder is made where it is missing.

    Raises:
        ValueError: The folder cannot be written to.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(target.parent)
        aside, lock = _make_locked(target.parent)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(
            f"{target} cannot be written: folder {target.parent}: {reason}; make it writable or "
            "choose another output folder"
        ) from error
    try:
        yield aside
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        os.close(lock)


def final_place(path: Path) -> Path:
    """Where a file will stand that is being written, in a folder of `folder_beside` for one."""
    is_aside = path.parent.name.startswith(_PREFIX)
    return path.parent.parent / path.name if is_aside else path


def _make_locked(folder: Path) -> tuple[Path, int]:
    """A new folder and the descriptor that holds its lock."""
    while True:
        aside = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
        try:
            lock = os.open(aside, os.O_RDONLY)
        except FileNotFoundError:  # taken for a leftover before it was locked
            continue
        if _is_ours(lock) and aside.exists():
            return aside, lock
        os.close(lock)


def _is_ours(lock: int) -> bool:
    """Whether nobody else has the lock, in order to remove the folder; also where none can be."""
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
            if entry.name.startswith(_PREFIX) and entry.is_dir(follow_symlinks=False)
        ]
    for path in left:
        with contextlib.suppress(OSError):  # in use, another user's, or gone meanwhile
            lock = os.open(path, os.O_RDONLY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)

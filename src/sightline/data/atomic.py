"""Files that are either whole or not there."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Gives a path to write to; the file appears under its own name only once it is whole.

    The file is written aside in a hidden folder next to its place, under the same name (so that a
    library which goes by the suffix is content), and renamed when the block ends well. When it
    ends with any exception, Ctrl-C included, nothing is left behind and an older file stays as it
    was. Parent folders are made where they are missing; a symbolic link is followed, not replaced.
    A crash of the whole machine is not guarded against: nothing is flushed to the disk.

    Args:
        path: Where the file shall stand.

    Raises:
        ValueError: The folder cannot be written to, or `path` is a folder or a device.
    """
    target = Path(os.path.realpath(path))
    aside = _make_folder_beside(target)
    try:
        yield aside / target.name
        # Only now: a file of the old content must survive everything up to here.
        (aside / target.name).replace(target)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def atomic_write_bytes(path: Path | str, content: bytes) -> None:
    """Writes a whole file or none, as `atomic_path` does."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def atomic_write_text(path: Path | str, text: str) -> None:
    """Writes a whole text file (UTF-8, line ends as given) or none, as `atomic_path` does."""
    atomic_write_bytes(path, text.encode())


def _make_folder_beside(target: Path) -> Path:
    folder = target.parent
    try:
        if target.exists() and not target.is_file():
            raise ValueError(
                f"{target} cannot be written: it is no regular file; choose another name"
            )
        folder.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=".sightline-", dir=folder))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(
            f"{target} cannot be written: folder {folder}: {reason}; make it writable or choose "
            "another output folder"
        ) from error

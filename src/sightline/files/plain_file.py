"""Reader of whole files that cannot exhaust the memory or wait for ever."""

import os
import select
import stat
import sys
from pathlib import Path
from typing import Final

from sightline.files.problem import GIVE_ACCESS, FileError

_GROWN_BYTES = 2**16  # allowed excess over the reported length: system files report 0
_TIMEOUT_S: Final = 60.0
_BLOCK_BYTES: Final = 2**16
_POINTERS: Final = {
    b"version https://git-lfs": ("Git LFS", "git lfs pull"),
    b"/annex/objects/": ("git-annex", "git annex get"),
}
"""Starts of pointers in the place of files, with what wrote them and the command for the files."""
_CORRECT: Final = "correct it or "
"""First words of remedies for faulty contents, which an absent file does not have."""


def as_path(path: Path | str) -> Path:
    """Path of a text; a path stays of its own kind, which may read from shards."""
    return path if isinstance(path, Path) else Path(path)


def read_bytes(path: Path | str, *, max_bytes: int, remedy: str) -> bytes:
    """Read the bytes of a regular file that is no pointer; see `check_regular`."""
    size = check_regular(path, max_bytes=max_bytes, remedy=remedy)
    return _read(path, min(size + _GROWN_BYTES, max_bytes), remedy)  # allocated at once


def read_start(path: Path | str, num_bytes: int, *, max_bytes: int, remedy: str) -> bytes:
    """Read the first bytes of a regular file that is no pointer; see `check_regular`."""
    check_regular(path, max_bytes=max_bytes, remedy=remedy)
    return _read(path, num_bytes, remedy)


def read_pipe(path: Path | str, *, max_bytes: int, remedy: str) -> bytes:
    """Read a pipe until its writers close it, such as `<(sort names.txt)` in a shell.

    Raises:
        FileError: The pipe cannot be read, contains more bytes, or has no data for a minute.
    """
    content = b""
    try:
        # Otherwise a named pipe without a writer would block for ever.
        pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            while len(content) <= max_bytes:
                if not select.select([pipe], [], [], _TIMEOUT_S)[0]:
                    raise FileError(path, f"gives nothing for {_TIMEOUT_S:g} s", remedy)
                block = os.read(pipe, _BLOCK_BYTES)
                if not block:
                    return content
                content += block
        finally:
            os.close(pipe)
    except OSError as error:
        raise _unreadable(path, error, remedy) from error
    raise FileError(path, f"holds more than {max_bytes} bytes", remedy)


def check_regular(path: Path | str, *, max_bytes: int, remedy: str) -> int:
    """Check that a file can be read to its end, and return its length.

    Args:
        path: The file; links are followed.
        max_bytes: Limit above the size of any valid file of its kind.
        remedy: Remedy for errors.

    Raises:
        FileError: There is no such file, it cannot be read, is larger, or is no regular file:
            reading from a pipe may block for ever, and some devices have no end.
    """
    try:
        status = as_path(path).stat()
    except OSError as error:
        raise _unreadable(path, error, remedy) from error
    if not stat.S_ISREG(status.st_mode):
        raise FileError(path, "is no regular file", f"put the file itself there or {remedy}")
    if status.st_size > max_bytes:
        problem = f"is {status.st_size} bytes long, expected up to {max_bytes}"
        raise FileError(path, problem, remedy)
    return status.st_size


def _read(path: Path | str, num_bytes: int, remedy: str) -> bytes:
    try:
        with as_path(path).open("rb") as file:
            content = file.read(num_bytes)
    except OSError as error:
        raise _unreadable(path, error, remedy) from error
    for start, (writer, command) in _POINTERS.items():
        if content.startswith(start):
            problem = f"is a pointer of {writer}, not the file itself"
            raise FileError(path, problem, f"fetch it: {command}")
    return content


def check_no_pointer(path: Path | str) -> None:
    """Refuse a pointer of Git LFS or git-annex in the place of a file that a library reads.

    Raises:
        FileError: The file is one, or cannot be read.
    """
    num_bytes = max(map(len, _POINTERS))
    read_start(path, num_bytes, max_bytes=sys.maxsize, remedy="name another file")


def _unreadable(path: Path | str, error: OSError, remedy: str) -> FileError:
    if isinstance(error.__cause__, FileError):  # of the shards that hold the file
        remedy = error.__cause__.problem.remedy
    elif isinstance(error, PermissionError):
        remedy = GIVE_ACCESS
    elif isinstance(error, FileNotFoundError) and as_path(path).is_symlink():
        problem = f"is a link to {str(as_path(path).readlink())!r}, which cannot be reached"
        return FileError(path, problem, "mount its disk or fetch the file (git annex get)")
    elif isinstance(error, FileNotFoundError) and remedy.startswith(_CORRECT):
        remedy = f"name a file that exists or {remedy.removeprefix(_CORRECT)}"
    return FileError(path, f"cannot be read: {(error.strerror or str(error)).lower()}", remedy)

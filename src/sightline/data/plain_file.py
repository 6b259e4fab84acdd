"""Whole files, read so that nothing in a folder can take all memory or wait for ever."""

import stat
from pathlib import Path

from sightline.data.problem import FileError

_GROWN_BYTES = 2**16  # more than its length a file may hold: the system's own say 0


def read_bytes(path: Path | str, *, max_bytes: int, remedy: str) -> bytes:
    """The bytes of a regular file; arguments and errors as of `check_regular`."""
    size = check_regular(path, max_bytes=max_bytes, remedy=remedy)
    try:
        with Path(path).open("rb") as file:
            return file.read(min(size + _GROWN_BYTES, max_bytes))  # so much is allotted first
    except OSError as error:
        raise _unreadable(path, error, remedy) from error


def check_regular(path: Path | str, *, max_bytes: int, remedy: str) -> int:
    """The length of a file that can be read to its end.

    Args:
        path: The file; links are followed.
        max_bytes: More than any sound file of its kind holds.
        remedy: What errors say to do.

    Raises:
        FileError: There is no such file, it cannot be read, is larger, or is no regular file:
            reading from a pipe would wait for ever, from some devices without an end.
    """
    try:
        status = Path(path).stat()
    except OSError as error:
        raise _unreadable(path, error, remedy) from error
    if not stat.S_ISREG(status.st_mode):
        raise FileError(path, "is no regular file", f"put the file itself there or {remedy}")
    if status.st_size > max_bytes:
        problem = f"is {status.st_size} bytes long, expected up to {max_bytes}"
        raise FileError(path, problem, remedy)
    return status.st_size


def _unreadable(path: Path | str, error: OSError, remedy: str) -> FileError:
    return FileError(path, f"cannot be read: {(error.strerror or str(error)).lower()}", remedy)

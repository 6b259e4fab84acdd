"""Whole files, read so that nothing in a folder can take all memory or wait for ever."""

import os
import select
import stat
from pathlib import Path
from typing import Final

from sightline.data.problem import FileError

_GROWN_BYTES = 2**16  # more than its length a file may hold: the system's own say 0
_PATIENCE_S: Final = 60.0
_BLOCK_BYTES: Final = 2**16


def read_bytes(path: Path | str, *, max_bytes: int, remedy: str) -> bytes:
    """The bytes of a regular file; arguments and errors as of `check_regular`."""
    size = check_regular(path, max_bytes=max_bytes, remedy=remedy)
    try:
        with Path(path).open("rb") as file:
            return file.read(min(size + _GROWN_BYTES, max_bytes))  # so much is allotted first
    except OSError as error:
        raise _unreadable(path, error, remedy) from error


def read_pipe(path: Path | str, *, max_bytes: int, remedy: str) -> bytes:
    """Read what a pipe holds until its writers have closed it, as `<(sort names.txt)` in a shell.

    Raises:
        FileError: It cannot be read, holds more bytes, or nothing comes for a minute.
    """
    content = b""
    try:
        # Else a named pipe that nobody writes to would be waited for without an end.
        pipe = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            while len(content) <= max_bytes:
                if not select.select([pipe], [], [], _PATIENCE_S)[0]:
                    raise FileError(path, f"gives nothing for {_PATIENCE_S:g} s", remedy)
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

"""Decoder of pictures that suppresses the messages of libpng and libjpeg, which name no file."""

import contextlib
import ctypes
import functools
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from typing import IO, Any, Final

import cv2
import numpy as np

_STDERR_NAMES: Final = {"linux": "stderr", "darwin": "__stderrp"}
"""Name of C's variable of standard error, by platform."""
_MAX_BYTES: Final = 2**16
_DAMAGE_MESSAGE: Final = re.compile(
    r"libpng error: (?P<png>.*)|Corrupt JPEG data: (?P<jpeg>(?!.*extraneous bytes).*)"
    r"|(?P<end>Premature end of JPEG file)"
)
"""Messages about lost pixels; others are about profiles and extraneous bytes."""
_CODEC_MESSAGE: Final = re.compile(
    rb"libpng |Corrupt JPEG|Premature end of JPEG|Warning: unknown JFIF"
)


def decode_quietly(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    """Decode a picture by OpenCV.

    Args:
        content: A PNG or JPEG file.
        flags: OpenCV's `IMREAD_...`.

    Returns:
        The pixels, None if there are none, and the decoder's first message about damage; empty:
        there is none, or messages cannot be caught on this platform.

    Raises:
        cv2.error: OpenCV refuses the picture, for example for its size.
    """
    buffer = np.frombuffer(content, np.uint8)
    with _STDERR.capture() as messages:
        pixels = cv2.imdecode(buffer, flags)
    if messages:  # may come from a picture of another thread
        with _STDERR.capture(exclusive=True) as messages:
            pixels = cv2.imdecode(buffer, flags)
    damage = _DAMAGE_MESSAGE.search("".join(messages))
    return pixels, "" if damage is None else next(filter(None, damage.groups()), "").strip()


class _StderrCapture:
    """Redirection of C's standard error to a file while pictures are decoded.

    Python's standard error, and descriptor 2 of both, stay unchanged, so that no other line is
    lost.
    """

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._num_active = 0
        self._is_exclusive = False
        self._file: IO[bytes] | None = None
        self._stream: int | None = None
        self._saved: tuple[int | None, Any] = (None, None)

    @contextlib.contextmanager
    def capture(self, *, exclusive: bool = False) -> Iterator[list[str]]:
        """Capture printed lines; the list contains them afterwards.

        Args:
            exclusive: Whether to exclude other threads, so that all lines come from this one.
        """
        with self._condition:
            self._condition.wait_for(
                lambda: not self._is_exclusive and not (exclusive and self._num_active)
            )
            self._is_exclusive = exclusive
            self._num_active += 1
            if self._num_active == 1:
                self._begin()
            start = self._size()
        messages: list[str] = []
        try:
            yield messages
        finally:
            with self._condition:
                if self._file is not None and self._size() > start:
                    output = os.pread(self._file.fileno(), _MAX_BYTES, start)
                    messages.append(output.decode("latin-1"))
                self._is_exclusive = False
                self._num_active -= 1
                if not self._num_active:
                    self._end()
                self._condition.notify_all()

    def _size(self) -> int:
        return 0 if self._file is None else os.fstat(self._file.fileno()).st_size

    def _begin(self) -> None:
        if self._file is None:
            self._open()
        variable = _c_stderr()
        log = cv2.utils.logging
        self._saved = (None if variable is None else variable.value, log.getLogLevel())
        log.setLogLevel(log.LOG_LEVEL_SILENT)
        if variable is not None and self._stream is not None:
            variable.value = self._stream

    def _open(self) -> None:
        if _c_stderr() is None:
            return
        import fcntl

        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process
        descriptor = self._file.fileno()
        flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
        fcntl.fcntl(descriptor, fcntl.F_SETFL, flags | os.O_APPEND)
        library = ctypes.CDLL(None)
        library.fdopen.restype = ctypes.c_void_p
        self._stream = library.fdopen(os.dup(descriptor), b"a")
        library.setbuf(ctypes.c_void_p(self._stream), None)

    def _end(self) -> None:
        pointer, level = self._saved
        variable = _c_stderr()
        if variable is not None and self._stream is not None:
            variable.value = pointer
        cv2.utils.logging.setLogLevel(level)
        size = self._size()
        if self._file is not None and size:
            output = os.pread(self._file.fileno(), size, 0)
            os.ftruncate(self._file.fileno(), 0)
            lines = output.splitlines(keepends=True)
            # With several threads, the line ends come after both texts.
            others = [line for line in lines if line.strip() and not _CODEC_MESSAGE.match(line)]
            with contextlib.suppress(OSError):  # standard error is closed
                os.write(2, b"".join(others))

    def forget(self) -> None:
        """Reset the state in a forked process; other threads may have been inside at the fork."""
        if self._num_active:
            variable = _c_stderr()
            if variable is not None and self._stream is not None:
                variable.value = self._saved[0]
            cv2.utils.logging.setLogLevel(self._saved[1])
        self._condition = threading.Condition()
        self._num_active, self._is_exclusive = 0, False
        if self._file is not None:
            self._file.close()  # this process's descriptor: Python warns of files left open
        self._file, self._stream = None, None


@functools.cache
def _c_stderr() -> ctypes.c_void_p | None:
    """C's variable of standard error; None: not available."""
    name = _STDERR_NAMES.get(sys.platform)
    if name is None:
        return None
    try:
        return ctypes.c_void_p.in_dll(ctypes.CDLL(None), name)
    except (OSError, ValueError):
        return None


_STDERR: Final = _StderrCapture()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_STDERR.forget)

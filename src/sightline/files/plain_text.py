"""Reader of text files with numbers; any bytes give a value or a clear error."""

import math
from collections.abc import Sequence
from pathlib import Path

from sightline.files.plain_file import read_bytes, read_pipe
from sightline.files.problem import FileError

_MAX_BYTES = 2**26
MAX_CALIBRATION_BYTES = 2**20
"""Largest size of a calibration file: hundreds of times KITTI's."""
REMEDY = "correct it or extract the file again"

_MARK = b"\xef\xbb\xbf"
"""Byte order mark of UTF-8, which Windows editors write at the start of a text."""
_WIDE_MARKS = {
    b"\xff\xfe\0\0": "UTF-32",
    b"\0\0\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
}
"""Encodings by their marks, longer ones before their beginnings."""


def read_text(path: Path | str, *, max_bytes: int = _MAX_BYTES, remedy: str = REMEDY) -> str:
    """Read a file in UTF-8, with or without byte order marks; every line ends in a line feed.

    Args:
        path: The file.
        max_bytes: Largest length to read.
        remedy: Action for the user if there is no such file.

    Raises:
        FileError: The file cannot be read, is not UTF-8, or is larger than any calibration, pose or
            split file.
    """
    return _decoded(path, read_bytes(path, max_bytes=max_bytes, remedy=remedy))


def read_piped_text(path: Path | str) -> str:
    """Read the text of a pipe; see `read_text`.

    Raises:
        FileError: See `read_text`; or the pipe has no data.
    """
    return _decoded(path, read_pipe(path, max_bytes=_MAX_BYTES, remedy="name a file"))


def _decoded(path: Path | str, content: bytes) -> str:
    content = without_marks(content, path)
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise FileError(path, f"is no text: byte {error.start} is not UTF-8", REMEDY) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def without_marks(content: bytes, path: Path | str) -> bytes:
    """Remove the byte order marks of UTF-8 text, also inside joined files.

    Raises:
        FileError: The text is UTF-16 or UTF-32, or contains NUL bytes.
    """
    wide = next((name for mark, name in _WIDE_MARKS.items() if content.startswith(mark)), None)
    if wide is not None:
        raise FileError(
            path, f"is text in {wide}, expected UTF-8", "save it as plain text in UTF-8"
        )
    nul = content.find(b"\0")
    if nul >= 0:
        problem = f"holds a NUL byte at position {nul}: it is binary, or text in UTF-16 or UTF-32"
        raise FileError(path, f"{problem}, expected UTF-8", "save it as plain text in UTF-8")
    return content.replace(_MARK, b"") if _MARK in content else content


def parse_numbers(
    words: Sequence[str],
    path: Path | str,
    place: str = "",
    *,
    limit: float = 1e12,
    remedy: str = REMEDY,
) -> list[float]:
    """Parse words as finite numbers of plausible size.

    Args:
        words: Numbers in plain or exponent notation.
        path: File of the words, for errors.
        place: Line or name in the file, for errors.
        limit: Largest plausible magnitude.
        remedy: Action for the user.

    Raises:
        FileError: A word is no number, not finite or beyond the limit.
    """
    numbers = []
    for position, word in enumerate(words, start=1):
        try:
            # float() accepts "1_000" and digits of other alphabets, which are invalid in a file.
            number = float(word) if word.isascii() and "_" not in word else math.nan
        except ValueError:
            number = math.nan
        if not abs(number) <= limit:
            raise FileError(
                path,
                f"{place} value {position} is '{shortened(word, 24)}', expected a finite number of "
                f"magnitude up to {limit:g}".lstrip(),
                remedy,
            )
        numbers.append(number)
    return numbers


def shortened(text: str, max_length: int = 64) -> str:
    """Shorten text from a file for an error: one line, without control characters."""
    short = text if len(text) <= max_length else f"{text[:max_length]}..."
    return short if short.isprintable() else ascii(short)[1:-1]


def shortened_pair(text: str, other: str, max_length: int = 64) -> tuple[str, str]:
    """Shorten two texts for an error to parts that show where they differ; see `shortened`."""
    differing = (at for at, (a, b) in enumerate(zip(text, other, strict=False)) if a != b)
    same = next(differing, min(len(text), len(other)))
    start = 0 if same < max_length else same - max_length // 2
    mark = "..." if start else ""
    first, second = (mark + shortened(each[start:], max_length) for each in (text, other))
    return first, second

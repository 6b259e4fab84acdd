"""Text files of numbers, read so that any bytes give a value or a clear word."""

import math
from collections.abc import Sequence
from pathlib import Path

from sightline.data.plain_file import read_bytes
from sightline.data.problem import FileError

_MAX_BYTES = 2**26
REMEDY = "correct it or extract the file again"


def read_text(path: Path | str) -> str:
    """The text of a file in UTF-8, with or without a byte order mark.

    Raises:
        FileError: It cannot be read, is not UTF-8, or larger than any calibration, pose or split
            file.
    """
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=REMEDY)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileError(path, f"is no text: byte {error.start} is not UTF-8", REMEDY) from error


def parse_numbers(
    words: Sequence[str], path: Path | str, place: str = "", *, limit: float = 1e12
) -> list[float]:
    """The words as finite numbers of plausible size.

    Args:
        words: One number each, in plain or exponent notation.
        path: The file that they are of, for errors.
        place: The line or name in it, for errors.
        limit: The largest magnitude that is believed.

    Raises:
        FileError: A word is no number, not finite or beyond the limit.
    """
    numbers = []
    for position, word in enumerate(words, start=1):
        try:
            # float() takes "1_000" and other alphabets' digits, which are no numbers in a file.
            number = float(word) if word.isascii() and "_" not in word else math.nan
        except ValueError:
            number = math.nan
        if not abs(number) <= limit:
            raise FileError(
                path,
                f"{place} value {position} is '{shortened(word, 24)}', expected a finite number of "
                f"magnitude up to {limit:g}".lstrip(),
                REMEDY,
            )
        numbers.append(number)
    return numbers


def shortened(text: str, max_length: int = 64) -> str:
    """Text from a file as an error may show it: one line, without control characters."""
    shown = text if len(text) <= max_length else f"{text[:max_length]}..."
    return shown if shown.isprintable() else ascii(shown)[1:-1]

"""Text files of numbers, read so that any bytes give a value or a clear word."""

import math
from collections.abc import Sequence
from pathlib import Path

_MAX_BYTES = 2**26


def read_text(path: Path | str) -> str:
    """The text of a file in UTF-8, with or without a byte order mark.

    Raises:
        ValueError: It is not UTF-8, or larger than any calibration, pose or split file.
    """
    with Path(path).open("rb") as file:
        content = file.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise ValueError(f"{path} is larger than {_MAX_BYTES} bytes, expected a short text file")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(
            f"{path} is no text: byte {error.start} is not UTF-8; extract the file again"
        ) from error


def parse_numbers(words: Sequence[str], where: str, *, limit: float = 1e12) -> list[float]:
    """The words as finite numbers of plausible size.

    Args:
        words: One number each, in plain or exponent notation.
        where: What errors say first: the file, and the line or name in it.
        limit: The largest magnitude that is believed.

    Raises:
        ValueError: A word is no number, not finite or beyond the limit.
    """
    numbers = []
    for position, word in enumerate(words, start=1):
        try:
            # float() takes "1_000" and other alphabets' digits, which are no numbers in a file.
            number = float(word) if word.isascii() and "_" not in word else math.nan
        except ValueError:
            number = math.nan
        if not abs(number) <= limit:
            raise ValueError(
                f"{where}: value {position} is '{shortened(word, 24)}', expected a finite number "
                f"of magnitude up to {limit:g}; correct it or extract the file again"
            )
        numbers.append(number)
    return numbers


def shortened(text: str, max_length: int = 64) -> str:
    """Text from a file as an error may show it: one line, without control characters."""
    shown = text if len(text) <= max_length else f"{text[:max_length]}..."
    return shown if shown.isprintable() else ascii(shown)[1:-1]

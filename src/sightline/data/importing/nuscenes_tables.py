"""Reader of nuScenes' tables (JSON); errors contain file and row."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from sightline.data.importing.frames import Rigid, rigid_from_quaternion
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError

REMEDY: Final = "extract nuScenes' metadata archive again"

_MAX_BYTES: Final = 2**32  # sample_data.json of all of nuScenes has 1.1 GB
_MAX_VALUE: Final = 1e9  # largest number: metres in the map's frame, pixels, counts
_MAX_TIME_US: Final = 10**17  # the latest time that recordings may have


@dataclass(frozen=True, slots=True)
class Row:
    """Row of a table."""

    path: Path
    number: int
    """Position in the table, from 1."""
    entries: Mapping[str, Any]

    def fault(self, problem: str) -> FileError:
        """Return an error with the row's file and number."""
        return FileError(self.path, f"row {self.number} {problem}", REMEDY)

    def get(self, name: str) -> object:
        """Return an entry as its JSON value.

        Raises:
            FileError: The row lacks the entry.
        """
        if name not in self.entries:
            raise self.fault(f"lacks {name!r}")
        return self.entries[name]

    def text(self, name: str) -> str:
        """Return an entry that must be a string."""
        value = self.get(name)
        if not isinstance(value, str):
            raise self.fault(f"has the {name} {_excerpt(value)}, expected a string")
        return value

    def texts(self, name: str) -> list[str]:
        """Return an entry that must be a list of strings."""
        value = self.get(name)
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise self.fault(f"has the {name} {_excerpt(value)}, expected a list of strings")
        return value

    def flag(self, name: str) -> bool:
        """Return an entry that must be true or false."""
        value = self.get(name)
        if not isinstance(value, bool):
            raise self.fault(f"has the {name} {_excerpt(value)}, expected true or false")
        return value

    def whole(self, name: str, *, minimum: int = 0, maximum: int = _MAX_TIME_US) -> int:
        """Return an entry that must be a whole number, also written as 1.0."""
        value = self.get(name)
        number = _number(value, float(maximum))
        if number is None or number != int(number) or number < minimum:
            raise self.fault(
                f"has the {name} {_excerpt(value)}, expected a whole number from {minimum} on"
            )
        return int(number)

    def time_us(self, name: str) -> float:
        """Return an entry that must be a time [us], possibly with decimals as in Lyft's tables."""
        value = self.get(name)
        number = _number(value, float(_MAX_TIME_US))
        if number is None or number < 0:
            raise self.fault(f"has the {name} {_excerpt(value)}, expected microseconds")
        return float(number)

    def numbers(self, name: str, *shape: int) -> Float64[np.ndarray, "..."]:
        """Return an entry that must be numbers in (nested) lists of this shape."""
        value = self.get(name)
        expected = "x".join(map(str, shape))
        try:
            array = np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.empty(0)
        # numpy accepts text, booleans and null (as NaN) as numbers
        is_plain = all(type(each) in (int, float) for each in _leaves(value))
        if array.shape != shape or not is_plain or not (np.abs(array) < _MAX_VALUE).all():
            raise self.fault(
                f"has the {name} {_excerpt(value)}, expected {expected} finite numbers of "
                f"magnitude up to {_MAX_VALUE:g}"
            )
        return array

    def pose(self) -> Rigid:
        """Return the transform of the row's quaternion (w first) and translation."""
        w, x, y, z = self.numbers("rotation", 4)
        translation = self.numbers("translation", 3)
        try:
            return rigid_from_quaternion(np.array((x, y, z, w)), translation)
        except ValueError as error:
            raise self.fault(str(error)) from error


@dataclass(frozen=True, slots=True)
class Table:
    """Table whose rows are referenced by their tokens."""

    path: Path
    rows: Mapping[str, Row]

    def of(self, row: Row, name: str, token: str | None = None) -> Row:
        """Return the row that another row's entry, or one token of it, references.

        Raises:
            FileError: There is no such row; contains the referencing row.
        """
        token = row.text(name) if token is None else token
        if token not in self.rows:
            raise row.fault(f"has the {name} {_excerpt(token)}, which {self.path.name} lacks")
        return self.rows[token]


def read_rows(path: Path) -> Iterator[Row]:
    """Read the rows of a table.

    Raises:
        FileError: The table cannot be read, is invalid JSON or no list of rows.
    """
    content = read_bytes(path, max_bytes=_MAX_BYTES, remedy=REMEDY)
    try:
        rows = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise FileError(path, "is invalid JSON", REMEDY) from error
    if not isinstance(rows, list):
        raise FileError(path, "is not a table: expected a list of rows", REMEDY)
    for number, entries in enumerate(rows, start=1):
        if not isinstance(entries, dict):
            problem = f"row {number} is {_excerpt(entries)}, expected names with values"
            raise FileError(path, problem, REMEDY)
        yield Row(path, number, entries)


def read_table(path: Path) -> Table:
    """Read a table with its rows' tokens as keys.

    Raises:
        FileError: See `read_rows`; or a row has no token, or the token of another row.
    """
    rows: dict[str, Row] = {}
    for row in read_rows(path):
        token = row.text("token")
        if token in rows:
            raise row.fault(f"has the token {_excerpt(token)} of row {rows[token].number} too")
        rows[token] = row
    return Table(path, rows)


def _number(value: object, maximum: float) -> int | float | None:
    """Return a finite number of plausible size unchanged; None for anything else."""
    if type(value) is int:  # True is an int too
        return value if abs(value) <= maximum else None
    if isinstance(value, float) and math.isfinite(value) and abs(value) <= maximum:
        return value
    return None


def _leaves(value: object) -> Iterator[object]:
    if isinstance(value, list):
        for each in value:
            yield from _leaves(each)
    else:
        yield value


def _excerpt(value: object) -> str:
    return shortened(ascii(value), 40)

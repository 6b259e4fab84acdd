"""Rows of numbers in PCD and PLY files, and the names of their fields.

Memory is limited by the file's size.
"""

import io
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from sightline.files.problem import FileError
from sightline.geometry.user_warning import warn_user

MAX_BYTES: Final = 2**28
"""Largest file, and largest decompressed cloud: 4 million points of 64 bytes."""

REMEDY: Final = "export the cloud again, with fields x, y, z [m] and intensity"
"""Remedy in errors about clouds."""

INTENSITY_NAMES: Final = (
    *("reflectivity", "reflectance", "remission", "remissions", "refl", "ref"),
    *("intensity", "intensities", "i", "amplitude", "signal", "brightness"),
)
"""Names of fields with the brightness of echoes, calibrated ones first.

Ouster's and Hesai's drivers write `reflectivity` (0 to 255, corrected for range) beside `intensity`
(photon counts).
"""

RING_NAMES: Final = ("ring", "ring_id", "laser_id", "channel", "beam", "line")
"""Names of fields with the laser's number."""

USED_NAMES: Final = frozenset({"x", "y", "z", *INTENSITY_NAMES, *RING_NAMES})
"""Plain names of the fields that are read."""

MAX_HEADER: Final = 2**16
"""Longest header [bytes]."""

_MICROSOFT_NAN = re.compile(rb"[-+]?(?:nan\(\w*\)|1\.#\w+)", re.IGNORECASE)


class Field(NamedTuple):
    """Field of each point, as defined in a header."""

    name: str
    kind: str
    """NumPy type of its numbers."""
    length: int = 1
    """Numbers per point."""

    @property
    def num_bytes(self) -> int:
        """Size in a binary file [bytes per point]."""
        return self.length * np.dtype(self.kind).itemsize


def plain_name(name: str) -> str:
    """Name of a field in lower case, without CloudCompare's prefix."""
    return name.lower().removeprefix("scalar_")


def warn_of_repeated(names: Iterable[str]) -> None:
    """Warn of used fields with the same name, ignoring case."""
    counts = Counter(plain_name(name) for name in names)
    repeated = [name for name, count in counts.items() if count > 1 and name in USED_NAMES]
    if repeated:
        warnings.warn(  # without the file's name: one warning for all clouds with these fields
            f"clouds have several fields named {', '.join(repeated)}, ignoring case: the one in "
            "lower case is used, else the first; remove the others",
            stacklevel=1,
        )


def has_bare_returns(content: bytes) -> bool:
    """Whether the lines of a header end in a single carriage return, by the first line."""
    first = re.search(rb"\r\n|\n|\r", content[:MAX_HEADER])
    return first is not None and first.group() == b"\r"


def row_type(fields: Sequence[Field]) -> np.dtype[np.void]:
    """Row type of the fields without gaps; of fields with equal names only the first."""
    layout: dict[str, tuple[object, int]] = {}
    offset = 0
    for field in fields:
        if field.name != "_":
            kind = field.kind if field.length == 1 else (field.kind, (field.length,))
            layout.setdefault(field.name, (kind, offset))
        offset += field.num_bytes
    return np.dtype(
        {
            "names": list(layout),
            "formats": [kind for kind, _ in layout.values()],
            "offsets": [at for _, at in layout.values()],
            "itemsize": offset,
        }
    )


def binary_points(
    body: bytes, fields: Sequence[Field], num_points: int, path: Path | str
) -> np.ndarray:
    """Read points stored row by row."""
    row_bytes = sum(field.num_bytes for field in fields)
    if not num_points or not row_bytes:
        return no_points(fields)
    check_length(len(body) // row_bytes, num_points, path)
    return np.frombuffer(body, row_type(fields), num_points)


def ascii_points(
    body: bytes,
    fields: Sequence[Field],
    num_points: int,
    path: Path | str,
    *,
    skipped: int = 0,
    following: int = 0,
) -> np.ndarray:
    """Read the required fields of points stored as text, one per line.

    Args:
        body: Contents after the header.
        fields: Fields of each point.
        num_points: Number of points.
        path: The file, for errors.
        skipped: Number of lines before the points.
        following: Number of lines of other elements after the points.
    """
    if b"(" in body or b"#" in body:
        body = _MICROSOFT_NAN.sub(b"nan", body)
    lines = io.StringIO(body.decode("latin-1"), newline=None)
    for _ in range(min(skipped, len(body))):
        lines.readline()
    at = lines.tell()
    is_empty = not any(map(_split_values, lines))
    lines.seek(at)
    if not num_points or is_empty:
        check_length(0, num_points, path)
        return no_points(fields)
    expected = sum(field.length for field in fields)
    needed, column = dict[str, int](), 0
    for field in fields:
        if field.length == 1 and plain_name(field.name) in USED_NAMES:
            needed.setdefault(field.name, column)
        column += field.length
    if not needed:
        return no_points(fields)  # its field names are refused later
    rows = _checked_rows(lines, expected, num_points, path)
    try:
        values = np.loadtxt(rows, usecols=list(needed.values()), ndmin=2)
    except FileError:
        raise
    except ValueError as error:
        cause = str(error).split("\n")[0][:90].rstrip(".")
        raise FileError(path, f"holds points that are not numbers: {cause}", REMEDY) from error
    check_length(len(values), num_points, path)
    rest = sum(1 for line in lines if _split_values(line))
    warn_of_rest(rest - following, num_points, path)
    names = {field.name: "f8" if field.name in needed else "V0" for field in fields}
    points = np.zeros(len(values), list(names.items()))
    for number, name in enumerate(needed):
        points[name] = values[:, number]
    return points


def _checked_rows(
    lines: Iterable[str], expected: int, num_points: int, path: Path | str
) -> Iterator[str]:
    """Yield the lines of the points, without blank lines and comments.

    Raises:
        FileError: A line has another number of values than expected.
    """
    found = 0
    for line in lines:
        values = _split_values(line)
        if not values:
            continue
        if len(values) != expected:
            raise FileError(
                path,
                f"has {len(values)} values in point {found} (from 0), but its header defines "
                f"{expected}",
                "separate values by spaces, without commas" if "," in line else REMEDY,
            )
        yield line
        found += 1
        if found == num_points:
            return


def _split_values(line: str) -> list[str]:
    return line.split("#", maxsplit=1)[0].split()


def no_points(fields: Sequence[Field]) -> np.ndarray:
    """Return an array of an empty cloud."""
    return np.zeros(0, [(name, "f4") for name in dict.fromkeys(field.name for field in fields)])


def check_length(num_found: int, num_points: int, path: Path | str) -> None:
    """Refuse a file with fewer points than its header states.

    Raises:
        FileError: The file is truncated.
    """
    if num_found < num_points:
        problem = f"holds {num_found} of the {num_points} declared points"
        raise FileError(path, f"{problem}: it is cut short", REMEDY)


def warn_of_rest(num_more: int, num_points: int, path: Path | str) -> None:
    """Warn of points beyond the header's number, which are left out."""
    if num_more > 0:
        warn_user(
            f"{path}: holds {num_more} points more than the {num_points} declared ones: they are "
            "left out; correct the number in its header",
        )

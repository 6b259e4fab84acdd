"""Checks of names from data before they become part of a path.

A scene's name, a table's `filename` or a line of a list may contain `../`, an absolute path or
control characters; none of them may lead out of the input or output folder.
"""

import os
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from sightline.files.plain_text import shortened
from sightline.files.problem import FileError, Problem

MAX_NAME_BYTES: Final = 200
"""Longest name in UTF-8: file systems allow 255, and suffixes and numbers are added."""

_MAX_PART_BYTES: Final = 255
TRUST_REMEDY: Final = "get the data from a source that you trust"
"""Remedy for names in tables and lists, which are written by others."""


def checked_name(
    name: object,
    source: Path | str,
    place: str,
    *,
    max_bytes: int = MAX_NAME_BYTES,
    remedy: str = TRUST_REMEDY,
) -> str:
    """Check the name of a file or folder, and return it.

    Args:
        name: Name in the data.
        source: File with the name, for errors.
        place: Position in the file, for errors: "row 3: the name".
        max_bytes: Length limit.
        remedy: Remedy, for errors.

    Raises:
        FileError: The name is no text, empty or too long, contains a separator or an invisible
            character, begins with a dot or a space, or ends with a space.
    """
    fault = _name_fault(name, max_bytes)
    if fault is None:
        assert isinstance(name, str), "anything else is a fault"
        return name
    printable = shortened(ascii(name) if not isinstance(name, str) else repr(name))
    raise FileError(source, f"{place} {printable} {fault}, expected a plain file name", remedy)


def unusable_names(folder: Path, names: Iterable[str]) -> Problem | None:
    """Find names of frames that no list of frames or output may have; None: all are plain."""
    faults = {name: fault for name in names if (fault := _frame_fault(name)) is not None}
    if not faults:
        return None
    name, fault = next(iter(faults.items()))
    problem = f"has {len(faults)} frames with names that are no plain file names, such as"
    return Problem(
        path=folder,
        problem=f"{problem} {shortened(repr(name))}, which {fault}",
        remedy="rename their files",
    )


def _frame_fault(name: str) -> str | None:
    """Return the first fault of the parts of a frame's name; see `relative_parts`."""
    return next(filter(None, map(_part_fault, name.split("/"))), None)


def path_below(root: Path, relative: object, source: Path | str, place: str) -> Path:
    """Resolve a relative path from data within a folder.

    Parent folders may be links, for data on several disks. A file that is itself a link must lead
    into the data set or into its own folder.

    Args:
        root: The data set's folder.
        relative: Path in the data, with `/` between its parts.
        source: File with the path, for errors.
        place: Position in the file, for errors: "row 3: the filename".

    Raises:
        FileError: The path is no text or absolute, a part of it is no plain name (such as `..`), or
            it is a link that leads out of the data set.
    """
    path = root.joinpath(*relative_parts(relative, source, place))
    if path.is_symlink():
        _check_link(path, root, source, place)
    return path


def relative_parts(
    relative: object, source: Path | str, place: str, *, remedy: str = TRUST_REMEDY
) -> list[str]:
    """Check a path from data, and return its parts; see `path_below`."""
    parts = relative.split("/") if isinstance(relative, str) else [""]
    fault = next(filter(None, map(_part_fault, parts)), None)
    if fault is None:
        return parts
    shown = f"{place} is {shortened(ascii(relative))}"
    expected = "expected a relative path of plain names"
    if not isinstance(relative, str):
        raise FileError(source, f"{shown}, {expected}", remedy)
    if not any(map(_part_fault, relative.replace("\\", "/").split("/"))):
        problem = f"{shown}, {expected} with / between them"
        raise FileError(source, problem, "replace each backslash by /")
    which = "of which a part" if len(parts) > 1 else "which"
    raise FileError(source, f"{shown}, {which} {fault}, {expected}", remedy)


def _check_link(path: Path, root: Path, source: Path | str, place: str) -> None:
    real = Path(os.path.realpath(path))
    if not any(real.is_relative_to(os.path.realpath(folder)) for folder in (root, path.parent)):
        raise FileError(
            source,
            f"{place} names {path}, a link that leads out of the data set, to {real}",
            "put the file itself there, or link its whole folder",
        )


def _name_fault(name: object, max_bytes: int) -> str | None:
    """Return the fault of a name, as the rest of a sentence; None: the name is valid."""
    if not isinstance(name, str):
        return "is no text"
    if not name:
        return "is empty"
    if "/" in name or "\\" in name:
        return "holds a separator"
    if not name.isprintable():
        return _invisible_fault(name)
    if name[0] in ". " or name[-1] == " ":
        return "begins with a dot or a space, or ends with a space"
    if len(name.encode()) > max_bytes:
        return f"has more than {max_bytes} bytes"
    return None


def _invisible_fault(name: str) -> str:
    """Return the fault of a name that cannot be printed."""
    character = next(each for each in name if not each.isprintable())
    category = unicodedata.category(character)
    if category == "Cc":
        return "holds a control character"
    if category == "Cs":  # bytes of a file's name, or from an escape in JSON
        is_byte = "\udc80" <= character <= "\udcff"
        return f"is not UTF-8{' (Latin-1, from an older archive?)' * is_byte}"
    described = unicodedata.name(character, "no known character").lower()
    effect = "looks like a plain space" if category == "Zs" else "cannot be seen"
    return f"holds U+{ord(character):04X} ({described}), which {effect}"


def _part_fault(part: str) -> str | None:
    """Return the fault of a part of a path, like `_name_fault`."""
    if part in (".", "..") or _is_drive(part):
        return f"is {'a drive' if _is_drive(part) else repr(part)}"
    return _name_fault(part, _MAX_PART_BYTES)


def _is_drive(part: str) -> bool:
    """Return whether a part is a drive letter, such as C:."""
    return len(part) > 1 and part[1] == ":" and part[0].isalpha()

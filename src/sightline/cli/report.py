"""How the command line delivers a report: a table for people, a file for scripts."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from sightline.data.atomic import atomic_write_text, check_replaceable

if TYPE_CHECKING:
    from rich.console import RenderableType

_SCORED_SUFFIXES = (".txt", ".png")
_FILE_WIDTH = 160  # columns of a table that goes to no terminal


@runtime_checkable
class Report(Protocol):
    """What the commands that measure something give."""

    def table(self) -> "RenderableType":
        """For people."""
        ...

    def to_json(self) -> Mapping[str, object]:
        """For scripts."""
        ...


def check_writable(path: Path | None) -> None:
    """Refuses the place of a report before the work for it is done.

    Raises:
        ValueError: No file can be written there.
    """
    if path is None:
        return
    check_replaceable(path)
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise ValueError(
            f"{path} cannot be written: folder {folder}: {(error.strerror or str(error)).lower()}; "
            "name a file in a folder that you may write to"
        ) from error


def check_places(places: Mapping[str, Path | None], *, scored: Sequence[Path]) -> None:
    """Refuses places of several files before the work for them is done.

    Args:
        places: By the option that names each; None: not wanted.
        scored: Files, or folders of them, that are about to be read.

    Raises:
        ValueError: No file can be written there, two are the same, or it is one of those read.
    """
    taken: dict[Path, str] = {}
    for option, path in places.items():
        if path is None:
            continue
        check_writable(path)
        place = path.resolve()
        other = taken.setdefault(place, option)
        if other != option:
            raise ValueError(f"{other} and {option} both name {path}; name a file for each")
        is_kind_read = place.exists() and place.suffix in _SCORED_SUFFIXES
        if is_kind_read and any(place.is_relative_to(each.resolve()) for each in scored):
            raise ValueError(
                f"{option} {path} is one of the files that are to be scored, which it would "
                "replace; name another file"
            )


def check_writable_folder(path: Path | None) -> None:
    """Refuses the place of a folder of reports before the work for it is done.

    Raises:
        ValueError: It is a file or lies below one, or nothing can be written there.
    """
    if path is None:
        return
    there = next(each for each in (path.absolute(), *path.absolute().parents) if each.exists())
    if not there.is_dir():
        raise ValueError(f"{path} is no folder: {there} is a file; name another folder")
    check_writable(path / "any")


def deliver(report: Report, path: Path | None) -> None:
    """Prints a report and writes it to a JSON file, where there is a path for one."""
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=_FILE_WIDTH)
    try:
        console.print(report.table())
    finally:  # even where the reader of the table, `head` say, has seen enough
        if path is not None:
            atomic_write_text(path, json.dumps(report.to_json(), indent=2) + "\n")

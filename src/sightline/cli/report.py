"""How the command line delivers a report: a table for people, a file for scripts."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from sightline.cli.output import show_table
from sightline.data.atomic import atomic_write_text, check_replaceable
from sightline.data.jobs import check_outputs

if TYPE_CHECKING:
    from rich.console import RenderableType


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


def check_places(
    places: Mapping[str, Path | None],
    *,
    data: Sequence[Path | None] = (),
    results: Sequence[Path | None] = (),
) -> None:
    """Refuses places of files before the work for them is done; arguments as `check_outputs`.

    Raises:
        ValueError: No file can be written there, two are the same, or it is among what is read.
    """
    check_outputs(places, data=data, results=results)
    for path in places.values():
        check_writable(path)


def named_file(name: str | None) -> Path | None:
    """The file that an argument names, weights or a list of samples say; None: it names none."""
    return Path(name) if name and Path(name).is_file() else None


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
    try:
        show_table(report.table())
    finally:  # even where the reader of the table, `head` say, has seen enough
        if path is not None:
            atomic_write_text(path, json.dumps(report.to_json(), indent=2) + "\n")

"""How the command line delivers a report: a table for people, a file for scripts."""

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from sightline.data.atomic import atomic_write_text, check_replaceable

if TYPE_CHECKING:
    from rich.console import RenderableType

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

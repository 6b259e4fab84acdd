"""Output of reports: a table for people, a file for scripts."""

import inspect
import json
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from sightline.cli.output import show_table
from sightline.files.atomic import atomic_write_text, check_replaceable
from sightline.files.problem import refuse_without_effect
from sightline.jobs.output_dirs import check_outputs

if TYPE_CHECKING:
    from rich.console import RenderableType


@runtime_checkable
class Report(Protocol):
    """Report of a command that measures something."""

    def table(self) -> "RenderableType":
        """Format the report for people."""
        ...

    def to_json(self) -> Mapping[str, object]:
        """Convert the report for scripts."""
        ...


def check_writable(path: Path | None) -> None:
    """Refuse an unwritable report file before the work.

    Raises:
        ValueError: The file cannot be written.
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
    """Refuse invalid output files before the work; arguments as in `check_outputs`.

    Raises:
        ValueError: A file cannot be written, two are the same, or one is among the inputs.
    """
    check_outputs(places, data=data, results=results)
    for path in places.values():
        check_writable(path)


def named_file(name: str | None) -> Path | None:
    """File in an argument, such as weights or a list of samples; None: it is no file."""
    return Path(name) if name and Path(name).is_file() else None


def refuse_with_pack(**options: object) -> None:
    """Refuse options of a job that packs its results, which are whole shards.

    Raises:
        ValueError: One of the options is set.
    """
    for name, value in options.items():
        if value:
            raise ValueError(
                f"--pack packs the first output of all frames; leave --{name.replace('_', '-')} "
                "out, or --pack"
            )


def refuse_given(
    command: Callable[..., object],
    values: Mapping[str, object],
    place: str,
    *,
    used: Collection[str],
) -> None:
    """Refuse options of a command that differ from their defaults and would be ignored.

    Args:
        command: The command, whose signature has the defaults.
        values: Its arguments.
        place: End of the sentence: "without --data".
        used: Names of the options that have an effect, or are refused elsewhere.

    Raises:
        ValueError: One is given.
    """
    parameters = inspect.signature(command).parameters
    given = {
        name: values[name] != each.default for name, each in parameters.items() if name not in used
    }
    refuse_without_effect(place, **given)


def check_writable_folder(path: Path | None) -> None:
    """Refuse an unwritable folder of reports before the work.

    Raises:
        ValueError: The folder is a file or is below one, or cannot be written to.
    """
    if path is None:
        return
    there = next(each for each in (path.absolute(), *path.absolute().parents) if each.exists())
    if not there.is_dir():
        raise ValueError(f"{path} is no folder: {there} is a file; name another folder")
    check_writable(path / "any")


def deliver(report: Report, path: Path | None) -> None:
    """Print a report and write it to a JSON file, if a path is given."""
    try:
        show_table(report.table())
    finally:  # even if the reader of the table, such as `head`, has closed the pipe
        if path is not None:
            atomic_write_text(path, json.dumps(report.to_json(), indent=2) + "\n")

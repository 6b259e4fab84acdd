"""Output of the commands; names of files and folders are escaped for the terminal."""

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, TextIO

from sightline.files.problem import escaped, kind_of_message, plain_line

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

_FILE_WIDTH = 160  # columns of a table without a terminal


def say(*lines: object) -> None:
    """Print each value as one line to standard output, with escaped control characters.

    Raises:
        BrokenPipeError: The reader has closed the pipe.
        ValueError: Standard output cannot be written to, such as a file on a full disk.
    """
    with _standard_output():
        for line in lines:
            print(escaped(str(line)))


@contextmanager
def _standard_output() -> Iterator[None]:
    """Flush standard output at the end of the block, and say if it cannot be written to."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(f"standard output cannot be written: {reason}") from error


def discard_output(stream: TextIO) -> None:
    """Write to the null device from now on: Python's exit status is 120 if its last flush fails."""
    with suppress(OSError, ValueError):  # a stream without a descriptor
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def show_table(table: "RenderableType") -> None:
    """Print a table in the colours and the width of the terminal, if there is one.

    Tables that are wider are printed in parts, see `sightline.cli.tables`.

    Raises:
        BrokenPipeError: The reader has closed the pipe.
        ValueError: Standard output cannot be written to.
    """
    from rich.console import Console, Group

    from sightline.cli.tables import fitted

    console = Console()
    if not console.is_terminal or console.width < 1:  # a terminal without a size, COLUMNS=0
        console = Console(width=_FILE_WIDTH)
    with _standard_output():
        console.print(_Plain(Group(*fitted(table, console))), crop=False)


def warn(message: str) -> None:
    """Print a message as one line to standard error, if it can be written to."""
    try:
        print(f"sightline: {plain_line(message)}", file=sys.stderr, flush=True)
    except OSError:  # a full disk, a closed terminal: the exit status remains
        discard_output(sys.stderr)


def fail(message: str, status: int) -> int:
    """Print a message as one line to standard error; return the exit status."""
    warn(message)
    try:
        sys.stdout.flush()
    except OSError:  # what could not be written before
        discard_output(sys.stdout)
    return status


def format_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    line: str | None = None,
) -> str:
    """Format a warning as one line; a replacement for `warnings.formatwarning`."""
    del category, filename, lineno, line
    return f"sightline: warning: {plain_line(str(message))}\n"


@contextmanager
def gathered_warnings() -> Iterator[None]:
    """Print each kind of warning within a block once, at its end, with the number of warnings.

    Warnings that differ only in the file and in numbers are of one kind. Threads of the block are
    included; use it for a whole command.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        try:
            yield
        finally:
            first: dict[str, list[str]] = {}
            for message in dict.fromkeys(str(each.message) for each in caught):
                first.setdefault(kind_of_message(message), []).append(message)
            for alike in first.values():
                more = f" ({len(alike)} like it)" if len(alike) > 1 else ""
                warn(f"warning: {alike[0]}{more}")


@contextmanager
def first_of_each_kind() -> Iterator[None]:
    """Print the first warning of each kind at once, and the number of the others at the end.

    Kinds are those of `gathered_warnings`; equal warnings count once. Use it for a whole process.
    """
    by_kind: dict[str, dict[str, None]] = {}

    def show(message: Warning | str, *_: object, **__: object) -> None:
        text = str(message)
        alike = by_kind.setdefault(kind_of_message(text), {})
        if not alike:
            warn(f"warning: {text}")
        alike[text] = None

    with warnings.catch_warnings():
        warnings.showwarning = show
        try:
            yield
        finally:
            for first, *others in by_kind.values():
                if len(others) == 1:
                    warn(f"warning: {others[0]}")
                elif others:
                    warn(f"warning: {len(others)} more like this: {first}")


class _Plain:
    """Wrapper of a rich renderable that escapes control characters."""

    def __init__(self, renderable: "RenderableType") -> None:
        self._renderable = renderable

    def __rich_console__(
        self, console: "Console", options: "ConsoleOptions"
    ) -> "Iterator[Segment]":
        from rich.segment import Segment

        for text, style, control in console.render(self._renderable, options):
            is_safe = control is not None or text.isprintable() or not text.strip("\n")
            plain = text if is_safe else "\n".join(map(escaped, text.split("\n")))
            yield Segment(plain, style, control)

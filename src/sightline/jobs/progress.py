"""Display of a job's progress and remaining time."""

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

_FIRST_LINE_S, _SECOND_LINE_S, _LINE_EVERY_S = 10.0, 5.0, 30.0

Item = TypeVar("Item")


class _RateColumn(ProgressColumn):
    """Column of items per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s", style="progress.data.speed")


def progress_bars(console: Console) -> Progress:
    """Create bars with counts, rates and the remaining time, which disappear at the end."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _RateColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


@contextmanager
def waiting(description: str) -> Iterator[None]:
    """Show the description of a slow step on stderr, if it is a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(description):
        yield


def track(
    iterable: Iterable[Item], *, description: str, total: int | None = None
) -> Iterator[Item]:
    """Yield the items and show their number, rate and the remaining time.

    The display is on stderr and disappears at the end, so that only the result remains. If stderr
    is no terminal, jobs of more than ten seconds print a line from time to time. Items are read one
    at a time.

    Args:
        iterable: Items of the job.
        description: Description of the job, e.g. "scoring".
        total: Number of items, if `iterable` has no length.
    """
    console = Console(stderr=True)
    if total is None and isinstance(iterable, Sized):
        total = len(iterable)
    if not console.is_terminal:
        yield from _with_lines(iterable, description, total)
        return
    with progress_bars(console) as progress:
        task = progress.add_task(description, total=total)
        for item in iterable:
            yield item
            progress.advance(task)


def _with_lines(iterable: Iterable[Item], description: str, total: int | None) -> Iterator[Item]:
    """Yield the items and print their number on stderr from time to time."""
    lines = ProgressLines(first_s=_FIRST_LINE_S)
    for done, item in enumerate(iterable):
        lines.show(description, done, total)
        yield item


class ProgressLines:
    """Progress lines of named jobs on stderr: the first after a delay, then from time to time."""

    def __init__(self, *, first_s: float = 0.0) -> None:
        """Store the delay of a job's first line."""
        self._first_s = first_s
        self._begun: dict[str, tuple[float, int]] = {}
        self._next: dict[str, float] = {}

    def show(self, name: str, done: int, total: int | None, note: str = "") -> None:
        """Print the number of finished pieces of a job if it is time; total None: unknown."""
        now = time.monotonic()
        is_new = name not in self._begun
        begun_s, first = self._begun.setdefault(name, (now, done))
        if now < self._next.setdefault(name, now + self._first_s):
            return
        self._next[name] = now + (_SECOND_LINE_S if is_new else _LINE_EVERY_S)
        parts = [f"{name}: {done} of {'?' if total is None else total}", *([note] if note else [])]
        if done > first:
            rate = (done - first) / max(now - begun_s, 1e-9)
            parts.append(f"{rate:.2f}/s")
            if total is not None:
                parts.append(f"{timedelta(seconds=round((total - done) / rate))} left")
        self.say(", ".join(parts))

    def end(self, name: str) -> None:
        """Forget a finished job."""
        self._begun.pop(name, None)
        self._next.pop(name, None)

    def say(self, text: str) -> None:
        """Print a line, if stderr can be written to; a job does not end for lack of it."""
        with suppress(OSError):
            print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Do nothing: the lines remain."""

"""How long a job has still to go."""

import sys
import time
from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
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
    """Items per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.1f}/s", style="progress.data.speed")


def progress_bars(console: Console) -> Progress:
    """Bars with counts, rates and the time left, which go away at the end."""
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
    """Shows what a step that takes a while does, on stderr, where that is a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(description):
        yield


def track(
    iterable: Iterable[Item], *, description: str, total: int | None = None
) -> Iterator[Item]:
    """Gives the items on and shows how many are done, their rate and the time left.

    The display stands on stderr and goes away at the end, so that what remains is the result.
    Where stderr is no terminal, a file or a pipe, a line comes now and then of a job that takes
    longer than ten seconds. Streams: items are drawn one at a time.

    Args:
        iterable: What is worked through.
        description: What happens to the items, e.g. "scoring".
        total: Their number, where `iterable` does not know it.
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
    """Gives the items on and says now and then, in a line on stderr, how many are done."""
    lines = ProgressLines(first_s=_FIRST_LINE_S)
    for done, item in enumerate(iterable):
        lines.show(description, done, total)
        yield item


class ProgressLines:
    """Lines on stderr about jobs, by name: first after a while, then now and again."""

    def __init__(self, *, first_s: float = 0.0) -> None:
        """Takes how long nothing is said of a job."""
        self._first_s = first_s
        self._begun: dict[str, tuple[float, int]] = {}
        self._next: dict[str, float] = {}

    def show(self, name: str, done: int, total: int | None, note: str = "") -> None:
        """Says how many pieces of a job are done, where it is time; None: nobody knows of all."""
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
        """Forgets a job that is done."""
        self._begun.pop(name, None)
        self._next.pop(name, None)

    def say(self, text: str) -> None:
        """A line."""
        print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Leaves the lines where they are."""

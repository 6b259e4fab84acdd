"""How long a job has still to go."""

from collections.abc import Iterable, Iterator, Sized
from contextlib import contextmanager
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
    Where stderr is no terminal nothing is shown. Streams: items are drawn one at a time.

    Args:
        iterable: What is worked through.
        description: What happens to the items, e.g. "scoring".
        total: Their number, where `iterable` does not know it.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield from iterable
        return
    if total is None and isinstance(iterable, Sized):
        total = len(iterable)
    with progress_bars(console) as progress:
        task = progress.add_task(description, total=total)
        for item in iterable:
            yield item
            progress.advance(task)

"""Pieces of a job on a crew of workers, with retries: the same on any kind of worker."""

import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Final, Literal, NamedTuple, Protocol, runtime_checkable

from sightline.geometry.user_warning import warn_user

Driver = Literal["local", "ray"]
"""Workers of a job: processes of this machine, or actors of a Ray cluster."""

Piece = Callable[[int], str]
"""Function that runs piece N of a job; returns the error, empty: none."""

MAX_TRIES: Final = 3
"""Number of workers that a piece may lose before it counts as failed."""

_MAX_PIECE_S: Final = 3600.0
"""Time without a report after which a worker counts as hanging."""
_POLL_S: Final = 5.0


class Report(NamedTuple):
    """Report of a worker: it is ready, has run a piece, or has ended."""

    result: str = ""
    """Return value of the piece."""
    fault: str = ""
    """Traceback, if the piece raised an error."""
    ended: str = ""
    """Cause, if the worker has ended; empty: it is ready for the next piece."""
    warned: tuple[str, ...] = ()
    """Warnings of the piece, which the job gives in its own process."""


class Lost(NamedTuple):
    """Piece whose workers have ended, each time that it was tried."""

    reason: str


@runtime_checkable  # for beartype, which checks arguments under pytest
class Crew(Protocol):
    """Workers that run one piece at a time; each has a number."""

    def hire(self) -> int:
        """Start a worker and return its number; it reports when it is ready.

        Raises:
            ChildProcessError: No worker can be started.
        """
        ...

    def hand(self, worker: int, position: int) -> None:
        """Give a piece to a worker that is ready."""
        ...

    def reports(self, timeout_s: float) -> dict[int, Report]:
        """Wait for a report, and return those that have come by worker; empty: none in time."""
        ...

    def dismiss(self, worker: int) -> None:
        """End a worker by force, without a report."""
        ...

    def close(self) -> None:
        """Let all workers finish their pieces, and end them."""
        ...


def run_on_crew(crew: Crew, count: int, workers: int) -> Iterator[str | Lost]:
    """Run pieces 0 to `count` - 1 of a job and yield their return values, in order.

    A worker that ends or hangs is replaced, and another one tries its piece again; a piece that
    has lost `MAX_TRIES` workers is yielded as `Lost`, and the others go on.

    Args:
        crew: Workers; they are ended when the pieces are done, or the caller stops.
        count: Number of pieces.
        workers: Number of workers.

    Raises:
        ChildProcessError: No worker can be started, or all end without a result.
        RuntimeError: A piece raised an error; the message has its traceback.
    """
    try:
        yield from _Run(crew, count, min(workers, count)).results()
    finally:
        crew.close()


class _Run:
    """State of a job: pieces to do, and what each worker does."""

    def __init__(self, crew: Crew, count: int, workers: int) -> None:
        self._crew = crew
        self._count = count
        self._workers = workers
        self._pending = deque(range(count))
        self._doing: dict[int, int | None] = {}  # None: the worker is being started
        self._idle: list[int] = []
        self._waited_s: dict[int, float] = {}
        self._tries: Counter[int] = Counter()
        self._deaths_in_row = 0
        for _ in range(workers):
            self._hire()

    def results(self) -> Iterator[str | Lost]:
        """Yield the results in order."""
        done: dict[int, str | Lost] = {}
        for position in range(self._count):
            while position not in done:
                done |= self._next_results()
            yield done.pop(position)

    def _next_results(self) -> dict[int, str | Lost]:
        """Wait for reports, and give out the next pieces; returns the pieces that are done."""
        reports = self._reports()
        done: dict[int, str | Lost] = {}
        for worker, report in reports.items():
            if worker not in self._doing:  # it had nothing to do, and has ended
                self._idle.remove(worker)
                continue
            position = self._doing.pop(worker)
            if report.fault:
                raise RuntimeError(f"piece {position} of the job failed:\n{report.fault}")
            if report.ended:
                lost = self._lose(position, report.ended)
                if position is not None and lost is not None:
                    done[position] = lost
                continue
            self._idle.append(worker)
            for text in report.warned:
                warn_user(text)
            if position is not None:
                self._deaths_in_row = 0
                done[position] = report.result
        while self._idle and self._pending:
            self._hand(self._idle.pop(), self._pending.popleft())
        for _ in range(min(len(self._pending), self._workers - len(self._doing))):
            self._hire()
        return done

    def _reports(self) -> dict[int, Report]:
        """Reports that have come, and the ends of workers that hang."""
        begun_s = time.monotonic()
        reports = self._crew.reports(_POLL_S)
        waited_s = min(time.monotonic() - begun_s, _POLL_S)  # a suspended job's time does not count
        for worker in self._doing.keys() - reports.keys():
            self._waited_s[worker] += waited_s
            if self._waited_s[worker] < _MAX_PIECE_S:
                continue
            if self._doing[worker] is not None:
                self._crew.dismiss(worker)
                reports[worker] = Report(ended=f"gave no result for {_MAX_PIECE_S:g} s")
            elif not any(position is not None for position in self._doing.values()):
                raise ChildProcessError(
                    f"no worker has started for {_MAX_PIECE_S:g} s; look whether CPUs are free"
                )
        return reports

    def _hire(self) -> None:
        worker = self._crew.hire()
        self._doing[worker], self._waited_s[worker] = None, 0.0

    def _hand(self, worker: int, position: int) -> None:
        self._doing[worker], self._waited_s[worker] = position, 0.0
        self._crew.hand(worker, position)

    def _lose(self, position: int | None, reason: str) -> Lost | None:
        """Note the end of a worker: its piece is tried again, or lost."""
        self._deaths_in_row += 1
        if self._deaths_in_row >= MAX_TRIES * (self._workers + 1):
            raise ChildProcessError(
                f"{self._deaths_in_row} workers in a row have ended without a result, the last "
                f"one {reason}; where memory ran out, use fewer workers"
            )
        if position is None:
            return None
        self._tries[position] += 1
        if self._tries[position] < MAX_TRIES:
            self._pending.appendleft(position)
            return None
        return Lost(f"its worker has ended {MAX_TRIES} times, the last time it {reason}")


def report_of(piece: Piece, position: int) -> Report:
    """Run a piece in a worker, and collect its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        try:
            result, fault = piece(position), ""
        except BaseException:  # noqa: BLE001 - the job raises it; some libraries' are no Exception
            result, fault = "", traceback.format_exc()
    texts = tuple(dict.fromkeys(str(each.message) for each in caught))
    return Report(result=result, fault=fault, warned=texts)

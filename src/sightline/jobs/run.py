"""Parallel jobs of independent pieces, and shards of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeVar, runtime_checkable

from sightline.files.atomic import DiskError
from sightline.files.problem import memory_fault
from sightline.jobs.pool import run_pieces
from sightline.jobs.progress import track

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True, slots=True)
class JobResult:
    """Result of a job."""

    written: int
    skipped: int
    """Number of pieces with existing files."""

    def __str__(self) -> str:
        """Formats the result for the user."""
        return f"{self.written} written, {self.skipped} there already"


@runtime_checkable  # for beartype, which checks arguments under pytest
class Work(Protocol):
    """Piece of a job; must be picklable on systems that spawn workers (macOS, Windows).

    It writes files atomically, so that a stopped job leaves only complete ones.
    """

    def __str__(self) -> str:
        """Name in errors, e.g. "frame 7"."""
        ...

    def run(self) -> None:
        """Runs the piece.

        Raises:
            ValueError: The data or the output folder is faulty.
            OSError: The data or the output folder is faulty.
        """
        ...


def shard(items: Sequence[Item], index: int, count: int) -> Sequence[Item]:
    """Select a shard: every `count`th item from `index` on.

    Raises:
        ValueError: There is no such shard.
    """
    if count < 1:
        raise ValueError(f"num_shards must be at least 1, got {count}; leave it out for one shard")
    if not 0 <= index < count:
        raise ValueError(
            f"shard_index must be between 0 and num_shards - 1, got {index} of {count}"
        )
    return items[index::count]


LEAVE_OUT: Final = "leave it out by a sample_list of the others"
"""Remedy for a faulty sample of a job that takes a list of samples."""
_CORRECT: Final = "correct this one and run the same again"
_RUN_AGAIN: Final = "then run the same again"


def run_job(works: Sequence[Work], workers: int, *, description: str, leave_out: str = "") -> None:
    """Runs the pieces of a job in parallel.

    Args:
        works: The pieces.
        workers: Number of worker processes; 1: only this process.
        description: Description of the job for the display of progress.
        leave_out: Way to continue without a faulty piece.

    Raises:
        ValueError: There is no worker, or a piece fails: the error names it, the number of earlier
            pieces, whose results stay, and the number of pieces left.
    """
    check_workers(workers)
    way_on = f"{_CORRECT}, or {leave_out}" if leave_out else _CORRECT
    outcomes = run_pieces(_Attempt(works, way_on), len(works), workers)
    tracked = track(outcomes, description=description, total=len(works))
    for num_done, outcome in enumerate(tracked):
        if outcome:
            error, _, remedy = outcome.rpartition("\n")
            raise ValueError(f"{error}{_progress(num_done, len(works), remedy)}")


def _progress(num_done: int, total: int, way_on: str) -> str:
    """Describe the state of a job that a fault has stopped; empty: it had one piece."""
    if total == 1:
        return ""
    left = f"{total - num_done:,} are left"
    return f". {num_done:,} of {total:,} are done and stay, {left}: {way_on}"


def check_workers(workers: int) -> None:
    """Refuses an invalid number of workers.

    Raises:
        ValueError: There is no worker.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Runs a piece by its index; returns the error and, in a last line, the way on; empty: none.

    A full disk and a lack of memory are no faults of the piece.
    """

    works: Sequence[Work]
    way_on: str
    """Remedy for a faulty piece."""

    def __call__(self, position: int) -> str:
        work = self.works[position]
        try:
            work.run()
        except DiskError as error:
            return f"{work}: {error}\n{_RUN_AGAIN}"
        except (ValueError, OSError) as error:
            return f"{work}: {error}\n{self.way_on}"
        except Exception as error:
            if (fault := memory_fault(error)) is None:
                raise
            return f"{work}: {fault}\n{_RUN_AGAIN}"
        return ""

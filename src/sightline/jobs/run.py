"""Parallel jobs of independent pieces, and shards of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

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
    if not 0 <= index < count:
        raise ValueError(
            f"shard_index must be between 0 and num_shards - 1, got {index} of {count}"
        )
    return items[index::count]


def run_job(works: Sequence[Work], workers: int, *, description: str) -> None:
    """Runs the pieces of a job in parallel.

    Args:
        works: The pieces.
        workers: Number of worker processes; 1: only this process.
        description: Description of the job for the display of progress.

    Raises:
        ValueError: There is no worker, or a piece fails: the error names it. The results of earlier
            pieces stay.
    """
    check_workers(workers)
    errors = run_pieces(_Attempt(works), len(works), workers)
    for error in track(errors, description=description, total=len(works)):
        if error:
            raise ValueError(error)


def check_workers(workers: int) -> None:
    """Refuses an invalid number of workers.

    Raises:
        ValueError: There is no worker.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Runs a piece by its index; returns the error, empty: none."""

    works: Sequence[Work]

    def __call__(self, position: int) -> str:
        work = self.works[position]
        try:
            work.run()
        except (ValueError, OSError) as error:
            return f"{work}: {error}"
        except Exception as error:
            if (fault := memory_fault(error)) is None:
                raise
            return f"{work}: {fault}"
        return ""

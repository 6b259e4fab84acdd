"""Parallel jobs of independent pieces, and shards of them."""

from collections import Counter
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Final, Protocol, TypeVar, runtime_checkable

from sightline.files.extras import require_library
from sightline.files.problem import SetupError, error_text, memory_fault
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.crew import Crew, Driver, Lost, Piece, run_on_crew
from sightline.jobs.pool import ProcessCrew, one_blas_thread
from sightline.jobs.progress import track

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True, slots=True)
class JobResult:
    """Result of a job."""

    written: int
    skipped: int
    """Number of pieces with existing files."""
    notes: Mapping[str, int] = field(default_factory=dict, compare=False)
    """Notes on written pieces, each with their number."""

    def __str__(self) -> str:
        """Format the result for the user."""
        notes = "".join(f"; {count} {note}" for note, count in self.notes.items())
        return f"{self.written} written, {self.skipped} there already{notes}"


@runtime_checkable  # for beartype, which checks arguments under pytest
class Work(Protocol):
    """Piece of a job; must be picklable on systems that spawn workers (macOS, Windows).

    It writes files atomically, so that a stopped job leaves only complete ones.
    """

    def __str__(self) -> str:
        """Name in errors, e.g. "frame 7"."""
        ...

    def run(self) -> str | None:
        """Run the piece, and return a note for the result of the job; None or empty: none.

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
_MAX_NAMED: Final = 20  # failed pieces in an error


def run_job(
    works: Sequence[Work],
    workers: int,
    *,
    description: str,
    leave_out: str = "",
    driver: Driver = "local",
    keep_going: bool = False,
) -> Counter[str]:
    """Run the pieces of a job in parallel, and count their notes.

    The piece of a worker that ends, for lack of memory or with its machine, is tried again on
    another one. If it ends three workers, it counts as failed, and the others are finished first.

    Args:
        works: The pieces.
        workers: Number of workers; 1 on this machine: only this process.
        description: Description of the job for the display of progress.
        leave_out: Way to continue without a faulty piece.
        driver: Kind of workers.
        keep_going: Whether to finish the others first, too, if a piece raises an error.

    Raises:
        ChildProcessError: No worker can be started, or all end without a result.
        ValueError: There is no worker, or a piece fails: the error names it, the number of earlier
            pieces, whose results stay, and the number of pieces left.
    """
    check_workers(workers, driver)
    way_on = f"{_CORRECT}, or {leave_out}" if leave_out else _CORRECT
    outcomes = run_pieces(_Attempt(works, way_on), len(works), workers, driver)
    failed: list[str] = []
    notes: Counter[str] = Counter()
    with closing(outcomes):  # else an error's traceback would keep the workers alive
        tracked = track(outcomes, description=description, total=len(works))
        for num_done, outcome in enumerate(tracked):
            if isinstance(outcome, Lost):
                failed.append(f"{works[num_done]}: {outcome.reason}")
                continue
            error, _, remedy = outcome.rpartition("\n")
            if error:
                if not keep_going or remedy == _RUN_AGAIN:
                    progress = _progress(num_done, len(works), workers, remedy)
                    raise ValueError(f"{error}{progress}")
                failed.append(error)
            elif remedy:
                notes[remedy] += 1
    if failed:
        named = [*failed[:_MAX_NAMED], *([".."] if len(failed) > _MAX_NAMED else [])]
        raise ValueError(
            f"{len(failed):,} of {len(works):,} failed, the others are done: {'; '.join(named)}. "
            "To make only what failed, run the same again"
        )
    return notes


def run_pieces(
    piece: Piece, count: int, workers: int, driver: Driver = "local"
) -> Generator[str | Lost, None, None]:
    """Run pieces 0 to `count` - 1 of a job and yield their return values, in order.

    A piece returns its error instead of raising it: an exception in a worker becomes a RuntimeError
    with a traceback. Pieces write files atomically, so that a job stopped by Ctrl-C, for example,
    leaves only complete files.

    Args:
        piece: Function of a piece; must be picklable on systems that spawn workers (macOS,
            Windows), and for Ray.
        count: Number of pieces.
        workers: Number of workers; 1 on this machine: only this process.
        driver: Kind of workers.

    Raises:
        ChildProcessError: See `run_job`.
    """
    if driver == "local" and workers == 1:
        with one_blas_thread():
            for position in range(count):  # not map: a StopIteration of a piece would end it
                yield piece(position)
    elif count:
        yield from run_on_crew(_crew(piece, driver), count, workers)


def _crew(piece: Piece, driver: Driver) -> Crew:
    if driver == "local":
        return ProcessCrew(piece)
    from sightline.jobs.ray_crew import RayCrew

    return RayCrew(piece)


def _progress(num_done: int, total: int, workers: int, way_on: str) -> str:
    """Describe the state of a job that a fault has stopped; empty: it had one piece.

    Of several workers, the others may have done later pieces.
    """
    if total == 1:
        return ""
    if workers > 1:
        return f". At least {num_done:,} of {total:,} are done and stay: {way_on}"
    left = f"{total - num_done:,} are left"
    return f". {num_done:,} of {total:,} are done and stay, {left}: {way_on}"


@named_arguments
def check_workers(workers: int, driver: Driver = "local") -> None:
    """Refuse an invalid number of workers, and a driver whose library is not installed.

    Raises:
        ValueError: There is no worker, or Ray is not installed.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if driver == "ray":
        require_library("ray", "ray")


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Function that runs a piece by its index; returns the error and a remedy, a line each.

    Without an error the second line is the piece's note; empty: it has none. A full disk, an engine
    that cannot run in the process and a lack of memory are no faults of the piece.
    """

    works: Sequence[Work]
    way_on: str
    """Remedy for a faulty piece."""

    def __call__(self, position: int) -> str:
        work = self.works[position]
        try:
            note = work.run()
        except SetupError as error:
            return f"{work}: {error}\n{_RUN_AGAIN}"
        except (ValueError, OSError, UserWarning) as error:  # a warning as an error: `python -W`
            text = error_text(error)
            named = text if text.startswith(f"{work} ") else f"{work}: {text}"
            return f"{named}\n{self.way_on}"
        except SystemExit as end:
            if isinstance(end.__context__, KeyboardInterrupt):
                raise
            problem = f"its code ends Python by sys.exit({end.code!r}), expected an exception"
            return f"{work}: {problem}\n{self.way_on}"
        except Exception as error:
            if (fault := memory_fault(error)) is None:
                error.add_note(str(work))
                raise
            return f"{work}: {fault}\n{_RUN_AGAIN}"
        return f"\n{note}" if note else ""

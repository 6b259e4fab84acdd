"""Lets methods answer to every frame in every case, and keeps what is needed of the answers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sightline.corruptions.suites import Case
from sightline.data.jobs import JobResult, check_workers, run_job
from sightline.data.open import SampleDataset
from sightline.inference.predictor import Predictor
from sightline.robustness.scoring import Answered, Keeper

_CASES_AT_A_TIME = 8  # of a frame that is read once: few enough for many workers on few frames


@dataclass(frozen=True, kw_only=True, slots=True)
class Asked:
    """A method, and in which cases it is asked."""

    predictor: Predictor
    cases: tuple[Case, ...]
    folder: Path
    """For what is kept of its answers: CASE/NAME with the keeper's suffix."""
    also: Callable[[Case, Answered], None] | None = None
    """What else is done with an answer, before it is kept; picklable."""


def answer_in_cases(
    dataset: SampleDataset,
    asked: Sequence[Asked],
    keeper: Keeper,
    *,
    seed: int,
    workers: int,
    description: str,
) -> JobResult:
    """Lets every method answer to every frame as each of its cases has it.

    Methods never see the truth: labels and true depth are taken off what they are given. What a
    frame meets depends on the seed, its name and the kind of corruption alone. A file appears whole
    or not at all, and what is there is skipped: a job that was stopped goes on where it was.

    Args:
        dataset: The frames; they are only read.
        asked: The methods; their folders are claimed already.
        keeper: Says what methods get of a frame, and what is kept of their answers.
        seed: Another one draws other boxes, discs and noise.
        workers: Processes that work; 1 is this process alone.
        description: What happens, for the display of progress.

    Returns:
        Answers written and skipped.

    Raises:
        ValueError: A frame cannot be read, posed or answered. The error names it; frames done
            before stay done.
    """
    check_numbers(seed, workers)
    present = {
        (each.folder, case.name): _present(each.folder / case.name, keeper.suffix)
        for each in asked
        for case in each.cases
    }
    cases = {case.name: case for each in asked for case in each.cases}
    works, written = [], 0
    for index, name in enumerate(dataset.sample_ids):
        pending = []
        for case in cases.values():
            lacking = tuple(
                each for each in asked if name not in present.get((each.folder, case.name), (name,))
            )
            if lacking:
                pending.append((case, lacking))
                written += len(lacking)
        for start in range(0, len(pending), _CASES_AT_A_TIME):
            some = tuple(pending[start : start + _CASES_AT_A_TIME])
            works.append(_FrameWork(dataset, index, name, keeper, seed, some))
    run_job(works, workers, description=description)
    total = len(dataset) * sum(len(each.cases) for each in asked)
    return JobResult(written=written, skipped=total - written)


def check_numbers(seed: int, workers: int) -> None:
    """Refuses what makes no sense, before a folder is claimed.

    Raises:
        ValueError: The seed is negative, or there is no worker.
    """
    check_workers(workers)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")


def _present(folder: Path, suffix: str) -> frozenset[str]:
    """Names of the frames that are done."""
    return frozenset(path.stem for path in folder.glob(f"*{suffix}"))


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Reads a frame once, breaks it once for each case, and lets the methods answer."""

    dataset: SampleDataset
    index: int
    name: str
    keeper: Keeper
    seed: int
    pending: tuple[tuple[Case, tuple[Asked, ...]], ...]

    def __str__(self) -> str:
        return f"frame {self.name}"

    def run(self) -> None:
        posed = self.keeper.pose(self.dataset[self.index])
        for case, methods in self.pending:
            corrupted = case.corrupt(posed.sample, self.seed)
            given = replace(corrupted.sample, objects=None, depth=None)
            for each in methods:
                answered = Answered(posed, corrupted, each.predictor(given))
                if each.also is not None:
                    each.also(case, answered)
                path = each.folder / case.name / f"{self.name}{self.keeper.suffix}"
                self.keeper.keep(path, answered)

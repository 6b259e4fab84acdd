"""Predictions of methods for every frame in every case, stored for scoring."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sightline.corruptions.suites import Case
from sightline.data.open import SampleDataset
from sightline.inference.predictor import Predictor
from sightline.jobs.run import JobResult, check_workers, run_job
from sightline.robustness.scoring import BenchPrediction, ResultWriter

_CASES_AT_A_TIME = 8  # cases per read of a frame: few enough for many workers on few frames


@dataclass(frozen=True, kw_only=True, slots=True)
class MethodRun:
    """Method with the cases to run it in."""

    predictor: Predictor
    cases: tuple[Case, ...]
    folder: Path
    """Folder of the stored predictions: CASE/NAME with the keeper's suffix."""
    also: Callable[[Case, BenchPrediction], None] | None = None
    """Further processing of a prediction, before it is stored; picklable."""


def answer_in_cases(
    dataset: SampleDataset,
    asked: Sequence[MethodRun],
    keeper: ResultWriter,
    *,
    seed: int,
    workers: int,
    description: str,
) -> JobResult:
    """Run every method on every frame in each of its cases.

    Methods never get the ground truth: labels and true depth are removed from their input. A
    frame's corruption depends only on the seed, its name and the kind. A file appears whole or not
    at all, and existing files are skipped, so a stopped job can be resumed.

    Args:
        dataset: The frames; they are only read.
        asked: The methods; their folders are already claimed.
        keeper: Defines the methods' input and the stored part of their predictions.
        seed: Another seed draws other boxes, discs and noise.
        workers: Number of processes; 1 uses this process alone.
        description: Text for the progress display.

    Returns:
        Predictions written and skipped.

    Raises:
        ValueError: A frame cannot be read, prepared or predicted. The error contains its name;
            finished frames are kept.
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
    """Check the numbers before a folder is claimed.

    Raises:
        ValueError: The seed is negative, or there is no worker.
    """
    check_workers(workers)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")


def _present(folder: Path, suffix: str) -> frozenset[str]:
    """List the names of finished frames."""
    return frozenset(path.stem for path in folder.glob(f"*{suffix}"))


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Job that reads a frame once, corrupts it once for each case, and runs the methods."""

    dataset: SampleDataset
    index: int
    name: str
    keeper: ResultWriter
    seed: int
    pending: tuple[tuple[Case, tuple[MethodRun, ...]], ...]

    def __str__(self) -> str:
        return f"frame {self.name}"

    def run(self) -> None:
        posed = self.keeper.pose(self.dataset[self.index])
        for case, methods in self.pending:
            corrupted = case.corrupt(posed.sample, self.seed)
            given = replace(corrupted.sample, objects=None, depth=None)
            for each in methods:
                answered = BenchPrediction(posed, corrupted, each.predictor(given))
                if each.also is not None:
                    each.also(case, answered)
                path = each.folder / case.name / f"{self.name}{self.keeper.suffix}"
                self.keeper.keep(path, answered)

"""Predictions of methods for every frame in every case, stored for scoring."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sightline.corruptions.combined import hits_objects
from sightline.corruptions.suites import Case
from sightline.data.datasets.newer_frames import warn_of_newer_frames
from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.layouts.kitti_trees import Part
from sightline.inference.predictor import Predictor, warn_of_unversioned
from sightline.jobs.crew import Driver
from sightline.jobs.run import LEAVE_OUT, JobResult, check_workers, run_job
from sightline.robustness.labels import check_placing_labels
from sightline.robustness.scoring import BenchPrediction, ResultWriter
from sightline.structures.sample import copy_of_sensors

_CASES_PER_READ = 8  # of a frame: few enough for many workers on few frames


@dataclass(frozen=True, kw_only=True, slots=True)
class MethodRun:
    """Method with the cases to run it in."""

    predictor: Predictor
    cases: tuple[Case, ...]
    folder: Path
    """Folder of the stored predictions: CASE/NAME with the writer's suffix."""
    also: Callable[[Case, BenchPrediction], None] | None = None
    """Further processing of a prediction, before it is stored; picklable."""


def predict_in_cases(
    dataset: SampleDataset,
    runs: Sequence[MethodRun],
    writer: ResultWriter,
    *,
    seed: int,
    workers: int,
    description: str,
    driver: Driver = "local",
) -> JobResult:
    """Run every method on every frame in each of its cases.

    Methods never get the ground truth: labels and true depth are removed from their input. A
    frame's corruption depends only on the seed, its name and the kind. Files are
    written atomically, and existing files are skipped, so a stopped job can be resumed.

    Args:
        dataset: The frames; they are only read.
        runs: The methods with their cases; their folders are already claimed.
        writer: Defines the methods' input and the stored part of their predictions.
        seed: Another seed draws other boxes, discs and noise.
        workers: Number of workers; 1 on this machine uses this process alone.
        description: Text for the progress display.
        driver: Kind of workers.

    Returns:
        Predictions written and skipped.

    Raises:
        ValueError: A frame cannot be read, prepared or predicted. The error contains its name;
            finished frames are kept.
    """
    check_numbers(seed, workers, driver)
    present = {
        (each.folder, case.name): writer.finished(each.folder / case.name)
        for each in runs
        for case in each.cases
    }
    cases = {case.name: case for each in runs for case in each.cases}
    works, written = [], 0
    for index, name in enumerate(dataset.sample_ids):
        pending = []
        for case in cases.values():
            lacking = tuple(
                each for each in runs if name not in present.get((each.folder, case.name), (name,))
            )
            if lacking:
                pending.append((case, lacking))
                written += len(lacking)
        for start in range(0, len(pending), _CASES_PER_READ):
            cases_of_read = tuple(pending[start : start + _CASES_PER_READ])
            works.append(_FrameWork(dataset, index, name, writer, seed, cases_of_read))
    kept = (
        (
            index,
            [
                folder / case / f"{name}{writer.suffix}"
                for (folder, case), finished in present.items()
                if name in finished
            ],
        )
        for index, name in enumerate(dataset.sample_ids)
    )
    folders = ", ".join(dict.fromkeys(str(each.folder) for each in runs))
    parts: tuple[Part, ...] = ("image", "points", "depth")  # labels are read for the scores
    remedy = f"to make them anew, remove {folders}"
    warn_of_newer_frames(dataset, kept, parts=parts, remedy=remedy)
    total = len(dataset) * sum(len(each.cases) for each in runs)
    warn_of_unversioned([each.predictor for each in runs], total - written, remedy=remedy)
    hitting = {name for name, case in cases.items() if hits_objects(case.corruption)}
    placed = {folder / case: names for (folder, case), names in present.items() if case in hitting}
    check_placing_labels(dataset, placed)
    run_job(works, workers, description=description, leave_out=LEAVE_OUT, driver=driver)
    return JobResult(written=written, skipped=total - written)


def check_numbers(seed: int, workers: int, driver: Driver = "local") -> None:
    """Check the numbers before a folder is claimed.

    Raises:
        ValueError: The seed is negative, there is no worker, or Ray is not installed.
    """
    check_workers(workers, driver)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Job that reads a frame once, corrupts it once for each case, and runs the methods."""

    dataset: SampleDataset
    index: int
    name: str
    writer: ResultWriter
    seed: int
    pending: tuple[tuple[Case, tuple[MethodRun, ...]], ...]

    def __str__(self) -> str:
        return f"frame {self.name}"

    def run(self) -> None:
        frame = self.writer.prepare(self.dataset[self.index])
        for case, methods in self.pending:
            corrupted = case.corrupt(copy_of_sensors(frame.sample), self.seed)
            blind = replace(corrupted.sample, objects=None, depth=None)
            for each in methods:
                found = each.predictor(copy_of_sensors(blind))
                prediction = BenchPrediction(frame, corrupted, found)
                if each.also is not None:
                    each.also(case, prediction)
                path = each.folder / case.name / f"{self.name}{self.writer.suffix}"
                self.writer.store(path, prediction)

"""Runs detectors over the cases of a suite and keeps what they find, frame by frame."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sightline.corruptions.generate import case_settings
from sightline.corruptions.suites import Case, Suite
from sightline.data.jobs import JobResult, check_workers, claim_folder, run_job
from sightline.data.kitti_object import KittiObjectDataset
from sightline.detection2d.config import Fusion
from sightline.detection2d.files import write_results
from sightline.detection2d.gate_record import (
    GateRecord,
    measure_gates,
    read_gate_record,
    write_gate_record,
)
from sightline.detection2d.predictor import DetectionPredictor

_GATES = "gates"


@dataclass(frozen=True, kw_only=True, slots=True)
class System:
    """A detector, and the cases in which it is wanted."""

    fusion: Fusion
    predictor: DetectionPredictor
    cases: tuple[Case, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseFolder:
    """What a detector has found in one case.

    `NAME.txt` is a frame's KITTI result file; `gates/NAME.json`, of a detector with gates, what
    they say. The latter is written first: a frame with a result file is done.
    """

    path: Path

    def finished(self) -> set[str]:
        """Names of the frames that are done."""
        return {file.stem for file in self.path.glob("*.txt")}

    def results_file(self, name: str) -> Path:
        """Of a frame."""
        return self.path / f"{name}.txt"

    def gates_file(self, name: str) -> Path:
        """Of a frame."""
        return self.path / _GATES / f"{name}.json"

    def gate_records(self, names: Iterable[str]) -> Iterator[GateRecord]:
        """Of these frames, in their order, read one after the other.

        Raises:
            ValueError: A file is missing or damaged.
        """
        return (read_gate_record(self.gates_file(name)) for name in names)


def case_folder(out: Path, fusion: Fusion, case: Case) -> CaseFolder:
    """Where `detect_in_cases` keeps what a detector finds in a case."""
    return CaseFolder(path=out / fusion / case.name)


def detect_in_cases(
    dataset: KittiObjectDataset,
    systems: Sequence[System],
    out: Path,
    *,
    suite: Suite,
    seed: int = 0,
    workers: int = 2,
) -> JobResult:
    """Lets every detector answer to every frame as each of its cases has it.

    A file appears whole or not at all, and what is there is skipped: a job that was stopped goes on
    where it was. Each detector's folder says what made it; see `claim_folder`.

    Args:
        dataset: Frames with image, sweep and labels; these are only read.
        systems: The detectors, one of each way of fusion.
        out: Folder for what they find, see `case_folder`.
        suite: Of which the cases are.
        seed: Another one draws other boxes, discs and noise.
        workers: Processes that work; 1 is this process alone.

    Returns:
        Answers written and skipped.

    Raises:
        ValueError: A frame cannot be read, or a folder holds what something else made or cannot be
            written to. Errors about a frame name it; frames done before stay done.
    """
    check_workers(workers)
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")
    pending: list[tuple[Case, System, CaseFolder, set[str]]] = []
    for system in systems:
        made_by = {"method": system.predictor.name, **system.predictor.made_by}
        settings = case_settings(dataset, suite, seed) | made_by
        claim_folder(out / system.fusion, settings, results=("*/*.txt",))
        for case in system.cases:
            folder = case_folder(out, system.fusion, case)
            pending.append((case, system, folder, folder.finished()))
    works = []
    for index, name in enumerate(dataset.sample_ids):
        answers = tuple(
            _Answer(case, system.predictor, folder)
            for case, system, folder, finished in pending
            if name not in finished
        )
        works.append(_FrameWork(dataset, index, name, seed, answers))
    run_job(
        [work for work in works if work.answers], workers, description=f"detecting in {suite.name}"
    )
    written = sum(len(work.answers) for work in works)
    return JobResult(written=written, skipped=len(works) * len(pending) - written)


@dataclass(frozen=True, slots=True)
class _Answer:
    """One that is wanted of a frame."""

    case: Case
    predictor: DetectionPredictor
    folder: CaseFolder


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Reads a frame once, breaks it once for each case, and lets the detectors answer."""

    dataset: KittiObjectDataset
    index: int
    name: str
    seed: int
    answers: tuple[_Answer, ...]

    def __str__(self) -> str:
        return f"frame {self.name}"

    def run(self) -> None:
        sample = self.dataset[self.index]
        by_case = {wanted.case.name: wanted.case for wanted in self.answers}
        for name, case in by_case.items():
            corrupted = case.corrupt(sample, self.seed)
            for wanted in self.answers:
                if wanted.case.name != name:
                    continue
                answer = wanted.predictor(corrupted.sample)
                if answer.camera_gate is not None:
                    record = measure_gates(answer, sample, corrupted)
                    write_gate_record(wanted.folder.gates_file(self.name), record)
                write_results(wanted.folder.results_file(self.name), sample, answer)

"""Runs detectors over the cases of a suite and keeps what they find, frame by frame."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sightline.corruptions.generate import case_settings
from sightline.corruptions.suites import Case, Suite
from sightline.data.jobs import JobResult, claim_folder
from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.output_links import check_links
from sightline.detection2d.config import Fusion
from sightline.detection2d.files import write_results
from sightline.detection2d.gate_record import (
    GateRecord,
    measure_gates,
    read_gate_record,
    write_gate_record,
)
from sightline.detection2d.predictor import DetectionPredictor
from sightline.robustness.answers import Asked, answer_in_cases, check_numbers
from sightline.robustness.scoring import Answered, PosedFrame
from sightline.structures.sample import CameraLidarSample

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

    Each detector's folder says what made it, see `claim_folder`; otherwise as `answer_in_cases`.

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
    check_numbers(seed, workers)
    check_links(out)
    asked = []
    for system in systems:
        made_by = {"method": system.predictor.name, **system.predictor.made_by}
        folder = out / system.fusion
        claim_folder(folder, case_settings(dataset, suite, seed) | made_by, results=("*/*.txt",))
        asked.append(Asked(predictor=system.predictor, cases=system.cases, folder=folder))
    return answer_in_cases(
        dataset,
        asked,
        _ResultsAndGates(),
        seed=seed,
        workers=workers,
        description=f"detecting in {suite.name}",
    )


class _ResultsAndGates:
    """Keeps KITTI's result files, and what gates say beside them: a `Keeper`."""

    suffix = ".txt"

    def pose(self, sample: CameraLidarSample) -> PosedFrame:
        """As it is."""
        return PosedFrame(sample, None)

    def keep(self, path: Path, answered: Answered) -> None:
        """Writes the gates first: a frame with a result file is done."""
        sample, answer = answered.posed.sample, answered.answer
        if answer.camera_gate is not None:
            record = measure_gates(answer, sample, answered.corrupted)
            write_gate_record(CaseFolder(path=path.parent).gates_file(path.stem), record)
        write_results(path, sample, answer)

"""Job that runs detectors over the cases of a suite and saves their output by frame."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sightline.corruptions.generate import case_settings
from sightline.corruptions.suites import Case, Suite
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
from sightline.files.output_links import check_links
from sightline.jobs.output_dirs import acquire_output_dir
from sightline.jobs.run import JobResult
from sightline.robustness.answers import MethodRun, answer_in_cases, check_numbers
from sightline.robustness.scoring import BenchFrame, BenchPrediction
from sightline.structures.sample import CameraLidarSample

_GATES = "gates"


@dataclass(frozen=True, kw_only=True, slots=True)
class System:
    """Detector, and its cases."""

    fusion: Fusion
    predictor: DetectionPredictor
    cases: tuple[Case, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class CaseFolder:
    """Folder with a detector's output in one case.

    `NAME.txt` is a frame's KITTI result file; `gates/NAME.json` contains the gates of a gated
    detector. The latter is written first: a frame with a result file is complete.
    """

    path: Path

    def gates_file(self, name: str) -> Path:
        """Path of a frame's gates."""
        return self.path / _GATES / f"{name}.json"

    def gate_records(self, names: Iterable[str]) -> Iterator[GateRecord]:
        """Read the gate records of frames, in their order, one at a time.

        Raises:
            ValueError: A file is missing or damaged.
        """
        return (read_gate_record(self.gates_file(name)) for name in names)


def case_folder(out: Path, fusion: Fusion, case: Case) -> CaseFolder:
    """Folder where `detect_in_cases` saves a detector's output in a case."""
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
    """Run every detector on every frame in each of its cases.

    Each detector's folder records its origin, see `acquire_output_dir`; otherwise as
    `answer_in_cases`.

    Args:
        dataset: Frames with image, sweep and labels; these are only read.
        systems: The detectors, one of each fusion type.
        out: Output folder, see `case_folder`.
        suite: Suite of the cases.
        seed: Seed of the corruptions' boxes, discs and noise.
        workers: Number of processes; 1 is this process alone.

    Returns:
        Answers written and skipped.

    Raises:
        ValueError: A frame cannot be read, or a folder holds other results or cannot be written to.
            Errors about a frame name it; frames done before stay done.
    """
    check_numbers(seed, workers)
    check_links(out)
    asked = []
    for system in systems:
        made_by = {"method": system.predictor.name, **system.predictor.made_by}
        folder = out / system.fusion
        acquire_output_dir(
            folder, case_settings(dataset, suite, seed) | made_by, results=("*/*.txt",)
        )
        asked.append(MethodRun(predictor=system.predictor, cases=system.cases, folder=folder))
    return answer_in_cases(
        dataset,
        asked,
        _ResultsAndGates(),
        seed=seed,
        workers=workers,
        description=f"detecting in {suite.name}",
    )


class _ResultsAndGates:
    """`ResultWriter` that saves KITTI's result files with the gates beside them."""

    suffix = ".txt"

    def pose(self, sample: CameraLidarSample) -> BenchFrame:
        """Return the sample unchanged."""
        return BenchFrame(sample, None)

    def keep(self, path: Path, answered: BenchPrediction) -> None:
        """Write the gates first: a frame with a result file is complete."""
        sample, answer = answered.posed.sample, answered.answer
        if answer.camera_gate is not None:
            record = measure_gates(answer, sample, answered.corrupted)
            write_gate_record(CaseFolder(path=path.parent).gates_file(path.stem), record)
        write_results(path, sample, answer)

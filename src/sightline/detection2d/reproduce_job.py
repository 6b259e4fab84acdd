"""Runs detectors over the cases of a suite and keeps what they find, frame by frame."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from sightline.corruptions.suites import Case, Suite
from sightline.data.jobs import claim_folder, run_job
from sightline.data.kitti_object import KittiObjectDataset
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
class CaseFolder:
    """What one detector finds in one case: KITTI's result files, and records of gates.

    `NAME.txt` holds a frame's detections; `gates/NAME.json`, of a detector with gates, what they
    say. The latter is written first: a frame with a result file is done.
    """

    path: Path
    has_gates: bool

    def finished(self) -> set[str]:
        """Names of the frames that are done."""
        return {file.stem for file in self.path.glob("*.txt")}

    def gate_records(self, frames: Sequence[str]) -> list[GateRecord]:
        """Of these frames, in their order.

        Raises:
            ValueError: A file is missing or damaged.
        """
        return [read_gate_record(self._gate_file(name)) for name in frames]

    def _gate_file(self, name: str) -> Path:
        return self.path / _GATES / f"{name}.json"

    def add(self, case: Case, seed: int, predictor: DetectionPredictor) -> "_Answering":
        """What fills it."""
        return _Answering(self, case, seed, predictor)


@dataclass(frozen=True, slots=True)
class Task:
    """One detector in one case."""

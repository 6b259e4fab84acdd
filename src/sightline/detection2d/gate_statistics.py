"""How well gates tell broken sensors from sound ones, over the frames of a case."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float64

from sightline.corruptions.corruption import Sensor
from sightline.detection2d.gate_record import GateCells, GateRecord, SensorGate
from sightline.evaluation.auroc import auroc, auroc_of_values


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorGateScore:
    """One sensor's gate in one case. AUROC is that of 1 less the gate: 1 is perfect, 0.5 chance."""

    mean: float
    """Of the frames' mean gates."""
    masked_mean: float | None
    """Over the cells that the corruption has changed; None where there are none."""
    clear_mean: float | None
    """Over the others."""
    auroc_cells: float | None
    """Changed cells against the others of the same frames; None where there are none of either."""
    auroc_clean_cells: float | None
    """Changed cells against all cells of the clean frames."""
    auroc_frames: float | None
    """Mean gates of the case's frames against those of the clean ones; None where the case leaves
    the sensor alone."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CaseGates:
    """What the gates say in one case."""

    case: str
    camera: SensorGateScore
    lidar: SensorGateScore
    camera_means: Float64[np.ndarray, " num_frames"]
    """Each frame's mean gate."""
    lidar_means: Float64[np.ndarray, " num_frames"]

    def to_json(self) -> dict[str, object]:
        """What a report file holds."""
        return {"case": self.case, "camera": asdict(self.camera), "lidar": asdict(self.lidar)}


class _Pooled:
    """A sensor's gate over all frames of a case."""

    def __init__(self, gates: Sequence[SensorGate]) -> None:
        self.means = np.array([gate.mean for gate in gates])
        self.masked = _sum([gate.masked for gate in gates])
        self.clear = _sum([gate.clear for gate in gates])


def _sum(parts: Sequence[GateCells]) -> GateCells:
    return GateCells(
        total=sum(part.total for part in parts),
        counts=np.sum([part.counts for part in parts], axis=0, dtype=np.int64),
    )


def score_gates(
    case: str, records: Sequence[GateRecord], clean: Sequence[GateRecord]
) -> CaseGates:
    """Compares the gates of a case's frames with its masks and with those of the clean frames.

    Args:
        case: Name of the case.
        records: Of its frames, one or more.
        clean: Of the same frames without corruption.
    """
    scores, means = {}, {}
    sensors: tuple[Sensor, ...] = ("camera", "lidar")
    for sensor in sensors:
        pooled = _Pooled([getattr(record, sensor) for record in records])
        sound = _Pooled([getattr(record, sensor) for record in clean])
        scores[sensor], means[sensor] = _score(pooled, sound), pooled.means
    return CaseGates(
        case=case,
        camera=scores["camera"],
        lidar=scores["lidar"],
        camera_means=means["camera"],
        lidar_means=means["lidar"],
    )


def _score(pooled: _Pooled, sound: _Pooled) -> SensorGateScore:
    masked, is_changed = pooled.masked, pooled.masked.num_cells > 0
    return SensorGateScore(
        mean=float(pooled.means.mean()),
        masked_mean=masked.mean,
        clear_mean=pooled.clear.mean,
        # Counts from the most open level on: what is closed is what is sought.
        auroc_cells=auroc(masked.counts[::-1], pooled.clear.counts[::-1]),
        auroc_clean_cells=auroc(masked.counts[::-1], sound.clear.counts[::-1]),
        auroc_frames=auroc_of_values(-pooled.means, -sound.means) if is_changed else None,
    )

"""Statistics of gates over the frames of a case: detection of corrupted sensors."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float64

from sightline.corruptions.corruption import Sensor
from sightline.detection2d.gate_record import NUM_LEVELS, GateCells, GateRecord, SensorGate
from sightline.evaluation.auroc import auroc, auroc_of_values

_NO_CELLS = np.zeros(NUM_LEVELS, dtype=np.int64)


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorGateScore:
    """One sensor's gate in one case. AUROC is that of 1 - gate: 1 is perfect, 0.5 is chance."""

    mean: float
    """Mean of the frames' mean gates."""
    masked_mean: float | None
    """Mean over the cells that the corruption has changed; None if there are none."""
    clear_mean: float | None
    """Mean over the unchanged cells."""
    auroc_cells: float | None
    """AUROC of changed against unchanged cells of the same frames; None if one group is empty."""
    auroc_clean_cells: float | None
    """AUROC of changed cells against all cells of the clean frames."""
    auroc_frames: float | None
    """AUROC of mean gates of the case's frames against those of clean frames; None if the case does
    not change the sensor."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CaseGates:
    """Gates of all frames in one case."""

    case: str
    camera: SensorGateScore
    lidar: SensorGateScore
    camera_means: Float64[np.ndarray, " num_frames"]
    """Each frame's mean gate."""
    lidar_means: Float64[np.ndarray, " num_frames"]

    def to_json(self) -> dict[str, object]:
        """Convert to the contents of a report file."""
        return {"case": self.case, "camera": asdict(self.camera), "lidar": asdict(self.lidar)}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PooledGate:
    """One sensor's gate over the frames of a case."""

    means: Float64[np.ndarray, " num_frames"]
    """Each frame's mean gate."""
    masked: GateCells
    clear: GateCells


def pool_gates(records: Iterable[GateRecord]) -> dict[Sensor, PooledGate]:
    """Pool the gates of a case's frames, one or more, one at a time."""
    means: dict[Sensor, list[float]] = {"camera": [], "lidar": []}
    masked = {sensor: GateCells(total=0.0, counts=_NO_CELLS) for sensor in means}
    clear = dict(masked)
    for record in records:
        gates: dict[Sensor, SensorGate] = {"camera": record.camera, "lidar": record.lidar}
        for sensor, gate in gates.items():
            means[sensor].append(gate.mean)
            masked[sensor] = _sum(masked[sensor], gate.masked)
            clear[sensor] = _sum(clear[sensor], gate.clear)
    return {
        sensor: PooledGate(
            means=np.array(means[sensor]), masked=masked[sensor], clear=clear[sensor]
        )
        for sensor in means
    }


def _sum(first: GateCells, second: GateCells) -> GateCells:
    return GateCells(total=first.total + second.total, counts=first.counts + second.counts)


def score_gates(
    case: str, pooled: Mapping[Sensor, PooledGate], clean: Mapping[Sensor, PooledGate]
) -> CaseGates:
    """Compare the gates of a case with its masks, and with those of the same frames when clean."""
    camera, lidar = pooled["camera"], pooled["lidar"]
    return CaseGates(
        case=case,
        camera=_score(camera, clean["camera"]),
        lidar=_score(lidar, clean["lidar"]),
        camera_means=camera.means,
        lidar_means=lidar.means,
    )


def _score(pooled: PooledGate, clean: PooledGate) -> SensorGateScore:
    masked, is_changed = pooled.masked, pooled.masked.num_cells > 0
    return SensorGateScore(
        mean=float(pooled.means.mean()),
        masked_mean=masked.mean,
        clear_mean=pooled.clear.mean,
        # Counts start at the most open level: closed gates are the positives.
        auroc_cells=auroc(masked.counts[::-1], pooled.clear.counts[::-1]),
        auroc_clean_cells=auroc(masked.counts[::-1], clean.clear.counts[::-1]),
        auroc_frames=auroc_of_values(-pooled.means, -clean.means) if is_changed else None,
    )

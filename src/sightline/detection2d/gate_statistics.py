"""How well gates tell broken sensors from sound ones, over the frames of a case."""

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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PooledGate:
    """One sensor's gate over the frames of a case."""

    means: Float64[np.ndarray, " num_frames"]
    """Each frame's mean gate."""
    masked: GateCells
    clear: GateCells


def pool_gates(records: Iterable[GateRecord]) -> dict[Sensor, PooledGate]:
    """The gates of a case's frames, one or more, added up as they come."""
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
    """Compares the gates of a case with its masks, and with those of the same frames when clean."""
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
        # Counts from the most open level on: what is closed is what is sought.
        auroc_cells=auroc(masked.counts[::-1], pooled.clear.counts[::-1]),
        auroc_clean_cells=auroc(masked.counts[::-1], clean.clear.counts[::-1]),
        auroc_frames=auroc_of_values(-pooled.means, -clean.means) if is_changed else None,
    )

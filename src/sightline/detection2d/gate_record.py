"""Record of a frame's gates over corrupted and intact parts of the sensors' images."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from sightline.corruptions.corruption import Corrupted
from sightline.detection2d.predictor import DetectorAnswer
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import read_text
from sightline.files.problem import FileError
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.sample import CameraLidarSample

NUM_LEVELS = 1024
_LEVELS_A_LOGIT = 32  # for log odds from -16 to 16
_MOST_CELLS = 2**31  # in a map
_REMEDY = "remove it and run the same command again"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GateCells:
    """One sensor's gate over some cells of its map."""

    total: float
    """Sum of the gate values."""
    counts: Int64[np.ndarray, "1024"]
    """Number of cells for each gate level, the most closed first. Levels are equal steps of log
    odds, which separate gates near 0 and near 1, too."""

    @property
    def num_cells(self) -> int:
        """Number of cells."""
        return int(self.counts.sum())

    @property
    def mean(self) -> float | None:
        """Mean gate value; None if there are no cells."""
        return self.total / self.num_cells if self.num_cells else None


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorGate:
    """One sensor's gate in one frame, or in several."""

    mean: float
    """Mean over the whole map."""
    masked: GateCells
    """Cells of which a corruption has changed more than half."""
    clear: GateCells
    """Unchanged cells."""


@dataclass(frozen=True, kw_only=True, slots=True)
class GateRecord:
    """Both gates of a frame at the network's finest map."""

    camera: SensorGate
    lidar: SensorGate


def measure_gates(
    answer: DetectorAnswer, sound: CameraLidarSample, corrupted: Corrupted
) -> GateRecord:
    """Measure a frame's gates over changed and unchanged cells.

    Cells where the intact sweep has no point are left out of the LiDAR's masked and clear cells:
    they lost nothing.

    Args:
        answer: Output for the corrupted sample.
        sound: The sample before the corruption.
        corrupted: The sample after the corruption.

    Raises:
        ValueError: The answer has no gates.
    """
    if answer.camera_gate is None or answer.lidar_gate is None:
        raise ValueError(
            f"the network that answered to sample {sound.sample_id} has no gates to measure; name "
            "weights of a gated one"
        )
    size = sound.image_size
    everywhere = torch.ones(size, dtype=torch.bool)
    has_point = everywhere
    if sound.points is not None:
        has_point = sparse_depth_map(sound.points, sound.calibration, size) > 0
    return GateRecord(
        camera=_sensor_gate(answer.camera_gate, corrupted.camera_mask, everywhere),
        lidar=_sensor_gate(answer.lidar_gate, corrupted.lidar_mask, has_point),
    )


def _sensor_gate(
    gate: Float32[Tensor, "rows columns"],
    mask: Bool[Tensor, "height width"],
    could_be_seen: Bool[Tensor, "height width"],
) -> SensorGate:
    cells = (gate.shape[0], gate.shape[1])
    masked_share = F.adaptive_avg_pool2d(mask.float()[None], cells)[0]
    is_known = F.adaptive_max_pool2d(could_be_seen.float()[None], cells)[0] > 0
    return SensorGate(
        mean=float(gate.double().mean()),
        masked=_cells(gate[is_known & (masked_share > 0.5)]),
        clear=_cells(gate[is_known & (masked_share == 0)]),
    )


def _cells(gates: Float32[Tensor, " num_cells"]) -> GateCells:
    exact = gates.double()
    log_odds = torch.logit(exact, eps=1e-9)
    levels = (log_odds * _LEVELS_A_LOGIT).round().long() + NUM_LEVELS // 2
    counts = torch.bincount(levels.clamp(0, NUM_LEVELS - 1), minlength=NUM_LEVELS)
    return GateCells(total=float(exact.sum()), counts=counts.numpy())


def write_gate_record(path: Path, record: GateRecord) -> None:
    """Write a JSON file atomically."""
    plain = {"camera": _to_plain(record.camera), "lidar": _to_plain(record.lidar)}
    atomic_write_text(path, json.dumps(plain) + "\n")


def read_gate_record(path: Path) -> GateRecord:
    """Read a file of `write_gate_record`.

    Raises:
        FileError: The file is not such a record.
    """
    text = read_text(path)
    try:
        plain = json.loads(text)
        return GateRecord(camera=_from_plain(plain["camera"]), lidar=_from_plain(plain["lidar"]))
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise FileError(path, "is no record of gates", _REMEDY) from error


def _to_plain(gate: SensorGate) -> dict[str, object]:
    groups = {"masked": gate.masked, "clear": gate.clear}
    return {"mean": gate.mean} | {
        name: {
            "total": cells.total,
            "counts": [
                [int(level), int(cells.counts[level])] for level in np.flatnonzero(cells.counts)
            ],
        }
        for name, cells in groups.items()
    }


def _from_plain(plain: Mapping[str, Any]) -> SensorGate:
    return SensorGate(
        mean=_number(plain["mean"], 1),
        masked=_cells_from_plain(plain["masked"]),
        clear=_cells_from_plain(plain["clear"]),
    )


def _cells_from_plain(plain: Mapping[str, Any]) -> GateCells:
    counts = np.zeros(NUM_LEVELS, dtype=np.int64)
    for level, count in plain["counts"]:
        is_whole = isinstance(level, int) and isinstance(count, int)
        if not (is_whole and 0 <= level < NUM_LEVELS and 0 <= count < _MOST_CELLS):
            raise ValueError(f"no {count} cells can be at level {level}")
        counts[level] = count
    return GateCells(total=_number(plain["total"], _MOST_CELLS), counts=counts)


def _number(value: object, most: int) -> float:
    if not isinstance(value, int | float) or not 0 <= value <= most:
        raise ValueError(f"no {value} can be a mean or a sum of gates")
    return float(value)

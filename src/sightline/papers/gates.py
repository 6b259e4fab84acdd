"""Gates of Kim et al. 2018 over corrupted and intact parts of the sensors' images.

Records of frames, statistics of cases, and Fig. 4 and 5.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from torch import Tensor

from sightline.corruptions.corruption import Corrupted
from sightline.corruptions.suites import Case, Suite
from sightline.data.formats.image_file import write_rgb
from sightline.detection2d.predictor import DetectionPredictor, DetectionResult
from sightline.detection2d.results import CAMERA_COLOR, LIDAR_COLOR, prediction_row
from sightline.evaluation.auroc import auroc, auroc_of_values
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import read_text
from sightline.files.problem import REMAKE, FileError
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.sample import CameraLidarSample, Sensor
from sightline.visualization.cells import PAGE
from sightline.visualization.shares import ShareSeries, draw_histogram

NUM_LEVELS = 1024
_LEVELS_A_LOGIT = 32  # for log odds from -16 to 16
_MAX_CELLS = 2**31  # in a map
_SENSORS: Final[tuple[Sensor, ...]] = ("camera", "lidar")


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


_NO_CELLS = GateCells(total=0.0, counts=np.zeros(NUM_LEVELS, dtype=np.int64))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SensorGate:
    """One sensor's gate in a frame, or in all frames of a case."""

    means: Float64[np.ndarray, " num_frames"]
    """Each frame's mean over the whole map."""
    masked: GateCells
    """Cells of which a corruption has changed more than half."""
    clear: GateCells
    """Unchanged cells."""


Gates = Mapping[Sensor, SensorGate]
"""Both sensors' gates at the network's finest map."""


def measure_gates(result: DetectionResult, sound: CameraLidarSample, corrupted: Corrupted) -> Gates:
    """Measure a frame's gates over changed and unchanged cells.

    Cells where the intact sweep has no point are left out of the LiDAR's masked and clear cells:
    they lost nothing.

    Args:
        result: Output for the corrupted sample.
        sound: The sample before the corruption.
        corrupted: The sample after the corruption.

    Raises:
        ValueError: The result has no gates.
    """
    if result.camera_gate is None or result.lidar_gate is None:
        raise ValueError(
            f"the network has no gates to measure in sample {sound.sample_id}; name weights of a "
            "gated one"
        )
    size = sound.image_size
    everywhere = torch.ones(size, dtype=torch.bool)
    has_point = everywhere
    if sound.points is not None:
        has_point = sparse_depth_map(sound.points, sound.calibration, size) > 0
    return {
        "camera": _sensor_gate(result.camera_gate, corrupted.camera_mask, everywhere),
        "lidar": _sensor_gate(result.lidar_gate, corrupted.lidar_mask, has_point),
    }


def _sensor_gate(
    gate: Float32[Tensor, "rows columns"],
    mask: Bool[Tensor, "height width"],
    is_measurable: Bool[Tensor, "height width"],
) -> SensorGate:
    cells = (gate.shape[0], gate.shape[1])
    masked_share = F.adaptive_avg_pool2d(mask.float()[None], cells)[0]
    is_known = F.adaptive_max_pool2d(is_measurable.float()[None], cells)[0] > 0
    return SensorGate(
        means=np.array([float(gate.double().mean())]),
        masked=_cells(gate[is_known & (masked_share > 0.5)]),
        clear=_cells(gate[is_known & (masked_share == 0)]),
    )


def _cells(gates: Float32[Tensor, " num_cells"]) -> GateCells:
    exact = gates.double()
    log_odds = torch.logit(exact, eps=1e-9)
    levels = (log_odds * _LEVELS_A_LOGIT).round().long() + NUM_LEVELS // 2
    counts = torch.bincount(levels.clamp(0, NUM_LEVELS - 1), minlength=NUM_LEVELS)
    return GateCells(total=float(exact.sum()), counts=counts.numpy())


def write_gate_record(path: Path, record: Gates) -> None:
    """Write a frame's gates to a JSON file atomically."""
    plain = {sensor: _to_plain(gate) for sensor, gate in record.items()}
    atomic_write_text(path, json.dumps(plain) + "\n")


def read_gate_record(path: Path) -> Gates:
    """Read a file of `write_gate_record`.

    Raises:
        FileError: The file is not such a record.
    """
    text = read_text(path)
    try:
        plain = json.loads(text)
        return {sensor: _from_plain(plain[sensor]) for sensor in _SENSORS}
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise FileError(path, "is no record of gates", REMAKE) from error


def _to_plain(gate: SensorGate) -> dict[str, object]:
    groups = {"masked": gate.masked, "clear": gate.clear}
    return {"mean": float(gate.means[0])} | {
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
        means=np.array([_number(plain["mean"], 1)]),
        masked=_cells_from_plain(plain["masked"]),
        clear=_cells_from_plain(plain["clear"]),
    )


def _cells_from_plain(plain: Mapping[str, Any]) -> GateCells:
    counts = np.zeros(NUM_LEVELS, dtype=np.int64)
    for level, count in plain["counts"]:
        is_whole = isinstance(level, int) and isinstance(count, int)
        if not (is_whole and 0 <= level < NUM_LEVELS and 0 <= count < _MAX_CELLS):
            raise ValueError(f"no {count} cells can be at level {level}")
        counts[level] = count
    return GateCells(total=_number(plain["total"], _MAX_CELLS), counts=counts)


def _number(value: object, maximum: int) -> float:
    if not isinstance(value, int | float) or not 0 <= value <= maximum:
        raise ValueError(f"no {value} can be a mean or a sum of gates")
    return float(value)


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
    scores: Mapping[Sensor, SensorGateScore]
    means: Mapping[Sensor, Float64[np.ndarray, " num_frames"]]
    """Each frame's mean gate."""

    def to_json(self) -> dict[str, object]:
        """Convert to the contents of a report file."""
        return {"case": self.case} | {name: asdict(each) for name, each in self.scores.items()}


def pool_gates(records: Iterable[Gates]) -> Gates:
    """Pool the gates of a case's frames, one or more, one at a time."""
    means: dict[Sensor, list[float]] = {sensor: [] for sensor in _SENSORS}
    masked, clear = dict.fromkeys(_SENSORS, _NO_CELLS), dict.fromkeys(_SENSORS, _NO_CELLS)
    for record in records:
        for sensor, gate in record.items():
            means[sensor] += gate.means.tolist()
            masked[sensor] = _sum(masked[sensor], gate.masked)
            clear[sensor] = _sum(clear[sensor], gate.clear)
    return {
        sensor: SensorGate(
            means=np.array(means[sensor]), masked=masked[sensor], clear=clear[sensor]
        )
        for sensor in _SENSORS
    }


def _sum(first: GateCells, second: GateCells) -> GateCells:
    return GateCells(total=first.total + second.total, counts=first.counts + second.counts)


def score_gates(case: str, pooled: Gates, clean: Gates) -> CaseGates:
    """Compare the gates of a case with its masks, and with those of the same frames when clean."""
    return CaseGates(
        case=case,
        scores={sensor: _score(gate, clean[sensor]) for sensor, gate in pooled.items()},
        means={sensor: gate.means for sensor, gate in pooled.items()},
    )


def _score(pooled: SensorGate, clean: SensorGate) -> SensorGateScore:
    masked, is_changed = pooled.masked, pooled.masked.num_cells > 0
    return SensorGateScore(
        mean=float(pooled.means.mean()),
        masked_mean=masked.mean,
        clear_mean=pooled.clear.mean,
        # Reversed, counts start at the most open level: closed gates are the positives.
        auroc_cells=auroc(masked.counts[::-1], pooled.clear.counts[::-1]),
        auroc_clean_cells=auroc(masked.counts[::-1], clean.clear.counts[::-1]),
        auroc_frames=auroc_of_values(-pooled.means, -clean.means) if is_changed else None,
    )


GATE_MEANS: Final = "gate_means.png"
"""File name of the picture of `write_gate_means`."""
GATE_MAPS: Final = "gate_maps.png"
"""File name of the picture of `write_gate_maps`."""

_CHART_SIZE = (190, 470)  # height, width [px]
_COLUMNS = 2
_GAP_PX = 10


def write_gate_means(path: Path, gates: Sequence[CaseGates], suite: Suite) -> None:
    """Draw a histogram of the frames' mean gates for each case: Fig. 4."""
    titles = {case.name: case.title for case in suite.cases}
    charts = [
        draw_histogram(
            titles[case.case],
            (
                ShareSeries(name="camera gate", values=case.means["camera"], color=CAMERA_COLOR),
                ShareSeries(name="LiDAR gate", values=case.means["lidar"], color=LIDAR_COLOR),
            ),
            size=_CHART_SIZE,
        )
        for case in gates
    ]
    blanks = [np.full((*_CHART_SIZE, 3), PAGE, np.uint8)] * (-len(charts) % _COLUMNS)
    cells = [_framed(chart) for chart in charts + blanks]
    rows = [
        np.concatenate(cells[start : start + _COLUMNS], axis=1)
        for start in range(0, len(cells), _COLUMNS)
    ]
    write_rgb(path, np.concatenate(rows))


def write_gate_maps(
    path: Path,
    sample: CameraLidarSample,
    predictor: DetectionPredictor,
    suite: Suite,
    seed: int = 0,
) -> None:
    """Draw a frame's detections and gates in each case, one below the other: Fig. 5."""
    write_rgb(path, np.concatenate([_row(case, sample, predictor, seed) for case in suite.cases]))


def _row(
    case: Case, sample: CameraLidarSample, predictor: DetectionPredictor, seed: int
) -> UInt8[np.ndarray, "height width 3"]:
    corrupted = case.corrupt(sample, seed)
    result = predictor(corrupted.sample)
    masks = (corrupted.camera_mask, corrupted.lidar_mask)
    return prediction_row(case.title, corrupted.sample, result, masks=masks)


def _framed(
    picture: UInt8[np.ndarray, "height width 3"],
) -> UInt8[np.ndarray, "new_height new_width 3"]:
    """Add the page's margin."""
    height, width = picture.shape[:2]
    page = np.full((height + _GAP_PX, width + _GAP_PX, 3), PAGE, np.uint8)
    page[_GAP_PX // 2 :, _GAP_PX // 2 :][:height, :width] = picture
    return page

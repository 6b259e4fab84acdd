"""Depth completion with faults: `python -m benchmarks.depth_robustness --data KITTI`.

The robustness bench with a suite of its own: misalignments by a known yaw, faults that training
draws, too, and every kind of suite `core` at severity 3. The last line is kept in
benchmarks/results/depth_robustness.json.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from sightline.augmentation.faults import FalseEchoes, Fault, NoCamera, TurnedLidar
from sightline.corruptions.corruption import Corrupted, Corruption, NoCorruption, Record
from sightline.corruptions.suites import CLEAN, Case, Suite, find_suite
from sightline.data.open import open_dataset
from sightline.depth_completion.registration import TASK
from sightline.evaluation.held_out import evaluate_held_out
from sightline.export.names import EngineName
from sightline.robustness.bench import BenchSettings, run_bench
from sightline.robustness.report import RobustnessReport
from sightline.structures.sample import CameraLidarSample

_SEVERITY = 3  # of the kinds of suite core
_FAULTS: tuple[Fault, ...] = (  # with all 64 beams
    *(TurnedLidar(yaw_deg=yaw_deg) for yaw_deg in (0.2, 0.5, 1.0, 2.0)),
    NoCamera(),
    FalseEchoes(share=0.05),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Faulty(Corruption):
    """Fault in the form of the bench, without a mask of the affected pixels."""

    kind = "fault"
    sensors = ("camera", "lidar")

    fault: Fault

    def corrupt(self, sample: CameraLidarSample, rng: np.random.Generator) -> Corrupted:
        """See `Corruption.corrupt`."""
        everywhere = torch.ones(sample.image_size, dtype=torch.bool)
        return Corrupted(
            sample=self.fault(sample, rng),
            record=Record(kind=self.kind, sensors=self.sensors, parameters={}),
            camera_mask=everywhere,
            lidar_mask=everywhere,
        )


def main(
    data: Path,
    out: Path = Path("depth-robustness"),
    methods: tuple[str, ...] = ("linear", "adaptive"),
    weights: tuple[str, ...] = ("depth-best", "depth-fast-cpu"),
    sample_list: str = "sample_val",
    engine: EngineName = "torch",
    workers: int = 2,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        data: KITTI object tree with calibration, images and sweeps.
        out: Folder for a run of each method; a stopped benchmark is resumed from it.
        methods: Methods without training.
        weights: Names or files of trained weights.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        engine: Inference engine of the networks.
        workers: Number of processes, each of one thread.
    """
    torch.set_num_threads(2)
    settings = BenchSettings(suite=_suite(), sample_list=sample_list, workers=workers)
    results, reports = [], []
    chosen = [(name, None) for name in methods] + [(None, name) for name in weights]
    for method, named in chosen:  # all before an engine runs here, which then cannot be forked
        completer = TASK.predictor(method=method, weights=named, engine=engine)
        report = run_bench(
            TASK,
            data,
            out / completer.name,
            settings,
            method=method,
            weights=named,
            engine=engine,
        )
        reports.append((completer, report))
    for completer, report in reports:
        dataset = open_dataset(data, sample_list=sample_list, parts={"image", "points"})
        samples = (dataset[index] for index in range(len(dataset)))
        by_beams = evaluate_held_out(samples, completer, total=len(dataset)).scores
        row = {f"{each.beams} beams": [each.rmse_mm, each.mae_mm] for each in by_beams}
        row = {name: [round(x, 1) for x in pair] for name, pair in (row | _row(report)).items()}
        print(f"{completer.name}, {sample_list} of {data}, RMSE / MAE in mm")
        for name, (rmse, mae) in row.items():
            print(f"{name:<40}{rmse:9.0f} /{mae:6.0f}")
        results.append({"method": completer.name, "rmse_mae_mm": row})
    setting = {"frames": len(dataset), "engine": engine}
    print_record({**setting, "results": results}, seed=0, weights=weights)


def _suite() -> Suite:
    clean = Case(name=CLEAN, title="sound sensors", corruption=NoCorruption(), probability=1.0)
    cases = (
        Case(
            name=str(fault).replace(" ", "_"),
            title=str(fault),
            corruption=_Faulty(fault=fault),
            probability=0.0,
        )
        for fault in _FAULTS
    )
    kinds = (
        replace(each, probability=0.0)
        for each in find_suite("core").cases
        if each.severity == _SEVERITY
    )
    return Suite(name="depth-faults", cases=(clean, *cases, *kinds))


def _row(report: RobustnessReport) -> dict[str, list[float]]:
    """Collect RMSE and MAE of each fault."""
    record = report.record
    rmse, mae = record.setting.metrics[:2]
    return {
        case.title: [record.score(name, rmse) or 0.0, record.score(name, mae) or 0.0]
        for name, case in record.cases.items()
        if name != CLEAN
    }


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)

"""Breaks sensors and scores depth completion: `python -m benchmarks.depth_robustness --data KITTI`.

The held-out-rings protocol (`sightline.evaluation.held_out`): the truth is the same for all, what a
method is given gets worse. Its last line is kept in benchmarks/results/depth_robustness.json.
"""

import json
from functools import partial
from pathlib import Path

import jsonargparse
import torch

from benchmarks.machine import describe_machine
from sightline.data.faults import FalseEchoes, Fault, NoCamera, TurnedLidar, fault_rng
from sightline.data.open import open_dataset
from sightline.depth_completion.predictor import Completer, choose_completer
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import BEAMS
from sightline.export.names import EngineName
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample

_FAULTS: tuple[Fault, ...] = (  # with all 64 beams
    *(TurnedLidar(yaw_deg=yaw_deg) for yaw_deg in (0.2, 0.5, 1.0)),
    NoCamera(),
    FalseEchoes(share=0.05),
)


def main(
    data: Path,
    methods: tuple[str, ...] = ("linear", "adaptive"),
    weights: tuple[str, ...] = ("depth-best", "depth-fast-cpu"),
    sample_list: str = "sample_val",
    engine: EngineName = "torch",
) -> None:
    """Prints a table, then one line of JSON.

    Args:
        data: KITTI object tree with calibration, images and sweeps.
        methods: Methods without training.
        weights: Names or files of trained weights.
        sample_list: Which frames: a list in ImageSets, or a text file with one name a line.
        engine: What runs the networks.
    """
    torch.set_num_threads(2)
    dataset = open_dataset(data, sample_list=sample_list, parts={"image", "points"})
    samples = [dataset[index] for index in range(len(dataset))]
    completers = [choose_completer(method=name) for name in methods]
    completers += [choose_completer(weights=name, engine=engine) for name in weights]
    columns = [f"{beams} beams" for beams in BEAMS] + [str(fault) for fault in _FAULTS]
    print(f"{len(samples)} frames, RMSE / MAE in mm")
    print(" " * 16 + "".join(f"{name:>16}" for name in columns))
    results = []
    for completer in completers:
        row = _score(completer, samples)
        print(f"{completer.name:<16}" + "".join(f"{r:9.0f} /{m:5.0f}" for r, m in row.values()))
        results.append({"method": completer.name, "rmse_mae_mm": row})
    setting = {"frames": len(samples), "engine": engine}
    print(json.dumps({"machine": describe_machine(), **setting, "results": results}))


def _score(completer: Completer, samples: list[CameraLidarSample]) -> dict[str, list[float]]:
    row = {}
    for score in evaluate_held_out(samples, completer).scores:
        row[f"{score.beams} beams"] = [round(score.rmse_mm, 1), round(score.mae_mm, 1)]
    for fault in _FAULTS:
        (score,) = evaluate_held_out(
            samples, partial(_complete, completer, fault), beams=[64]
        ).scores
        row[str(fault)] = [round(score.rmse_mm, 1), round(score.mae_mm, 1)]
    return row


def _complete(completer: Completer, fault: Fault, sample: CameraLidarSample) -> DepthMap:
    """Each method meets the same faults."""
    return completer(fault(sample, fault_rng(sample)))


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)

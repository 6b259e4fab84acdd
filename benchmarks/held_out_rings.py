"""Scores and times of depth completion: `python -m benchmarks.held_out_rings --data KITTI`.

The held-out-rings protocol (`sightline evaluate held-out`) on frames in KITTI's object tree, at
each number of beams, for methods without training and for networks. One thread, one run; the last
line is kept in benchmarks/results/held_out_rings.json.

Times are processor time of one call, from the sweep to the dense map. Other programs disturb it
least, and a second thread would show. Frames narrower or lower than 1216x352 are completed at their
own size.
"""

import statistics
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import jsonargparse
import numpy as np
import torch

from benchmarks.record import print_record
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.depth_completion.adaptive import adaptive_depth
from sightline.depth_completion.classical import ClassicalConfig, classical_depth
from sightline.depth_completion.interpolation import linear_depth, nearest_depth
from sightline.depth_completion.predictor import DepthPredictor
from sightline.evaluation.held_out import evaluate_held_out
from sightline.evaluation.held_out_frame import BEAMS, CROP_SIZE
from sightline.export.names import EngineName
from sightline.geometry.projection import sparse_depth_map
from sightline.structures.predictions import DepthMap
from sightline.structures.sample import CameraLidarSample

_BILATERAL = ClassicalConfig(blur="bilateral", extrapolate=False)
Completer = Callable[[CameraLidarSample], DepthMap]
_METHODS: dict[str, Callable[[np.ndarray], DepthMap]] = {
    "nearest": nearest_depth,
    "linear": linear_depth,
    "classical, Gaussian, extrapolated": classical_depth,
    "classical, bilateral": lambda sparse: classical_depth(sparse, _BILATERAL),
    "adaptive": adaptive_depth,
}


def main(
    data: Path,
    sample_list: str = "sample_val",
    weights: Sequence[str] = ("depth-fast-cpu", "depth-best"),
    engine: EngineName = "openvino",
    beams: Sequence[int] = BEAMS,
) -> None:
    """Print a table, then one line of JSON.

    Args:
        data: KITTI object tree with calibration, images and sweeps.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        weights: Names or files of trained weights.
        engine: Inference engine of the networks.
        beams: Densities to score.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    dataset = KittiObjectDataset(data, sample_list=sample_list, parts={"image", "points"})
    samples = [dataset[index] for index in range(len(dataset))]
    completers = {name: _by_method(method) for name, method in _METHODS.items()}
    completers |= {
        name: DepthPredictor.load(name, engine=engine, threads=1).__call__ for name in weights
    }
    results = [_measure(name, complete, samples, beams) for name, complete in completers.items()]
    print(f"{len(samples)} frames; RMSE / MAE in mm, median ms, by beams")
    for row in results:
        cells = (
            f"{s['rmse_mm']:6.0f} / {s['mae_mm']:5.0f} {s['median_ms']:6.1f}" for s in row["scores"]
        )
        print(f"{row['method']:<34}" + " |".join(cells))
    setting = {"frames": len(samples), "largest_size": list(CROP_SIZE), "threads": 1}
    print_record({**setting, "results": results}, seed=None, weights=weights)


def _by_method(method: Callable[[np.ndarray], DepthMap]) -> Completer:
    def complete(sample: CameraLidarSample) -> DepthMap:
        assert sample.points is not None, "the protocol sets them"
        sparse = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
        return method(sparse.numpy())

    return complete


def _measure(
    name: str, method: Completer, samples: list[CameraLidarSample], beams: Sequence[int]
) -> dict[str, Any]:
    """Score and time one method."""
    times_ms: list[float] = []

    def complete(sample: CameraLidarSample) -> DepthMap:
        start = time.process_time()
        dense = method(sample)
        times_ms.append((time.process_time() - start) * 1e3)
        return dense

    evaluate_held_out(samples[:1], complete, beams=beams)  # compiles, and fills caches
    times_ms.clear()
    report = evaluate_held_out(samples, complete, beams=beams, total=len(samples))
    rows = []
    for place, score in enumerate(report.scores):
        low, median, high = statistics.quantiles(times_ms[place :: len(beams)], n=4)
        rows.append(
            {
                "beams": score.beams,
                "rmse_mm": round(score.rmse_mm, 1),
                "mae_mm": round(score.mae_mm, 1),
                "median_error_mm": round(score.median_mm, 1),
                "coverage": round(score.coverage, 4),
                "median_ms": round(median, 2),
                "iqr_ms": round(high - low, 2),
                "frames_rmse_mm": [round(each[place].rmse_mm, 1) for _, each in report.frames],
            }
        )
    return {"method": name, "scores": rows}


if __name__ == "__main__":
    jsonargparse.auto_cli(main, as_positional=False)

"""Time of all answers of a frame, and of joining them: `python -m benchmarks.joined_time DATA`.

Wall time of `sightline.MultiTaskPredictor`, which `sightline perceive` runs, by task, with sound
sensors and without either: medians over frames. Run it on an idle machine. Prints a row for each
choice of weights and state, then one line of JSON.
"""

import statistics
import time
from pathlib import Path
from typing import Final

import jsonargparse
import numpy as np

from benchmarks.joined_frames import CASES
from benchmarks.record import print_record
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.export.names import EngineName
from sightline.joining.models import JOINED
from sightline.perception.perceiver import MultiTaskPredictor
from sightline.structures.sample import CameraLidarSample

_CASES: Final = ("clean", "camera_blank", "lidar_blank")
_WEIGHTS: Final = {
    "best": ("detection2d-best", "detection3d-best", "depth-best"),
    "best, fast depth": ("detection2d-best", "detection3d-best", "depth-fast-cpu"),
    "fast": ("detection2d-fast-cpu", "detection3d-fast-cpu", "depth-fast-cpu"),
}
_TASKS: Final = ("detection2d", "detection3d", "depth-completion")


def main(
    data: Path,
    sample_list: str = "sample_val",
    velodyne: Velodyne | None = None,
    frames: int = 24,
    engine: EngineName = "openvino",
    threads: int = 2,
) -> None:
    """Print a row for each choice of weights and state, then one line of JSON.

    Args:
        data: KITTI object tree.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        velodyne: Folder of the sweeps; None: velodyne, or else velodyne_reduced.
        frames: Number of frames, evenly spread over the list.
        engine: Inference engine.
        threads: Number of threads of the engines and of PyTorch.
    """
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne)
    frames = min(frames, len(dataset))
    samples = [dataset[index * len(dataset) // frames] for index in range(frames)]
    results = []
    for name, weights in _WEIGHTS.items():
        chosen = dict(zip(_TASKS, weights, strict=True))
        predictor = MultiTaskPredictor.load(chosen, engine=engine, threads=threads)
        for case in _CASES:
            broken = [CASES[case](sample, 0) for sample in samples]
            predictor.predict_by_task(broken[0])  # starts the engines
            times = [_times(predictor, sample) for sample in broken]
            medians: dict[str, str | float] = {
                part: round(statistics.median(each[part] for each in times), 1)
                for part in (*_TASKS, JOINED, "whole")
                if part in times[0]
            }
            slowest = round(float(np.percentile([each["whole"] for each in times], 95)), 1)
            row = {"weights": name, "case": case} | medians | {"percentile_95": slowest}
            results.append(row)
            print(row, flush=True)
    print_record(
        {"frames": frames, "engine": engine, "threads": threads, "unit": "ms", "results": results},
        seed=None,
        weights=sorted({each for weights in _WEIGHTS.values() for each in weights}),
    )


def _times(predictor: MultiTaskPredictor, sample: CameraLidarSample) -> dict[str, float]:
    """Wall time [ms] of each task, of joining, and of the whole answer."""
    start = time.perf_counter()
    found = predictor.predict_by_task(sample)
    whole = 1000 * (time.perf_counter() - start)
    return {**found.milliseconds, "whole": whole}


if __name__ == "__main__":
    jsonargparse.auto_cli(main)

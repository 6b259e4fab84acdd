"""Processor time of joined objects beside its parts: `python -m benchmarks.joined_time DATA`.

Medians over frames of the time of one thread, in which other jobs hardly show, with sound sensors
and without either: both detectors, the join of their boxes, and `sightline.load("joined")`. Prints
a row for each state, then one line of JSON.
"""

import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import jsonargparse
import torch

from benchmarks.joined_frames import CASES
from benchmarks.record import print_record
from sightline.data.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.export.names import EngineName
from sightline.joining.join import join_detections
from sightline.joining.predictor import JoinedPredictor
from sightline.structures.sample import CameraLidarSample

_CASES: Final = ("clean", "camera_blank", "lidar_blank")
_PARTS: Final = ("detection2d", "detection3d", "join", "joined")


def main(
    data: Path,
    sample_list: str = "sample_val",
    velodyne: Velodyne | None = None,
    frames: int = 10,
    engine: EngineName = "openvino",
) -> None:
    """Print a row for each state, then one line of JSON.

    Args:
        data: KITTI object tree.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        velodyne: Folder of the sweeps; None: velodyne, or else velodyne_reduced.
        frames: Number of frames, evenly spread over the list.
        engine: Inference engine.
    """
    torch.set_num_threads(1)
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne)
    samples = [dataset[index * len(dataset) // frames] for index in range(frames)]
    predictor = JoinedPredictor.load(engine=engine, threads=1)
    predictor(samples[0])  # starts the engines
    results = []
    for case in _CASES:
        times = [_times(predictor, CASES[case](sample, 0)) for sample in samples]
        medians = {part: round(statistics.median(t[part] for t in times), 1) for part in _PARTS}
        more = [t["joined"] - t["detection2d"] - t["detection3d"] for t in times]
        row = {"case": case, **medians, "more_than_detectors": round(statistics.median(more), 1)}
        row["largest_join"] = round(max(t["join"] for t in times), 1)
        results.append(row)
        print(row, flush=True)
    print_record(
        {"frames": frames, "engine": engine, "threads": 1, "unit": "ms", "results": results},
        seed=None,
        weights=[predictor.detector2d.name, predictor.detector3d.name],
    )


def _times(predictor: JoinedPredictor, sample: CameraLidarSample) -> dict[str, float]:
    """Processor time [ms] of each part for a sample."""
    found3d, refine = None, predictor.detector3d.refine_boxes
    times = dict.fromkeys(_PARTS, 0.0)
    times["detection2d"], result = _timed(lambda: predictor.detector2d(sample))
    found2d = result.detections
    if sample.points is not None:
        times["detection3d"], found3d = _timed(lambda: predictor.detector3d(sample))
    times["join"], _ = _timed(
        lambda: join_detections(
            sample, found2d, found3d, predictor.models, predictor.config, refine
        )
    )
    times["joined"], _ = _timed(lambda: predictor(sample))
    return times


def _timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [ms] of a call, and its result."""
    start = time.process_time()
    result = run()
    return 1000 * (time.process_time() - start), result


if __name__ == "__main__":
    jsonargparse.auto_cli(main)

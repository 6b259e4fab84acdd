"""Scores of the detectors on labelled frames: `python -m benchmarks.detection_accuracy DATA`.

2D detectors see sound sensors and the six broken cases of suite `dgfn7`, 3D detectors the whole
sweep and every second and fourth ring. Scores by KITTI's rules, and AP over all points of the curve
with the 95 % interval of a bootstrap over frames. Prints a row for each case, then one line of
JSON, kept in benchmarks/results/detection_accuracy.json.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import jsonargparse
import torch

from benchmarks.record import print_record
from sightline.corruptions.suites import Case, find_suite
from sightline.data.layouts.kitti_trees import Part, Velodyne
from sightline.data.open import open_dataset
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_rules import (
    DIFFICULTIES,
    STRICT,
    ClassOverlaps,
    MinimumOverlaps,
)
from sightline.evaluation.object_report import ObjectEntry, ObjectReport
from sightline.export.names import EngineName
from sightline.inference.predictor import Predictor
from sightline.jobs.progress import track
from sightline.structures.sample import CameraLidarSample
from sightline.tasks import Task, choose_task

_WEIGHTS: Final = (
    "detection2d-best",
    "detection2d-fast-cpu",
    "detection3d-best",
    "detection3d-fast-cpu",
)
_CASES: Final = {
    "detection2d": find_suite("dgfn7").cases,
    "detection3d": find_suite("core").select(("clean", "lidar_beams-2", "lidar_beams-3")),
}
_METRICS: Final = {"detection2d": ("bbox",), "detection3d": ("3d", "bev", "bbox")}
_PARTS: Final[tuple[Part, ...]] = (
    "image",
    "points",
    "objects",
)  # boxes hide labelled objects
_HALF: Final = MinimumOverlaps(car=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5))
_OVERLAPS: Final = {0.7: STRICT, 0.5: _HALF}
"""Overlaps by the IoU of cars; for other classes it is 0.5 in both."""


def main(
    data: Path,
    weights: Sequence[str] = _WEIGHTS,
    sample_list: str = "sample_val",
    velodyne: Velodyne | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
    engine: EngineName = "openvino",
) -> None:
    """Print a row for each network and case, then one line of JSON.

    Args:
        data: KITTI object tree with labels.
        weights: Names or files of detectors' weights.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        velodyne: Folder of the sweeps; None: velodyne, or else velodyne_reduced.
        bootstrap: Number of resamples of the frames.
        seed: Seed of the corruptions and of the resamples.
        engine: Inference engine.
    """
    torch.set_num_threads(1)
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne, parts=_PARTS)
    samples = [dataset[index] for index in range(len(dataset))]
    labels = data / "training" / "label_2"
    results: list[dict[str, Any]] = []
    for name in weights:
        task = choose_task(None, name)
        predictor = task.predictor(weights=name, engine=engine, threads=1)
        for case in _CASES[task.name]:
            scores = []
            with tempfile.TemporaryDirectory() as folder:
                _detect(task, predictor, samples, case, seed, Path(folder))
                names = [sample.sample_id for sample in samples]
                for iou, overlaps in _OVERLAPS.items():
                    report = evaluate_objects(
                        folder,
                        labels,
                        sample_list=names,
                        overlaps=overlaps,
                        bootstrap=bootstrap,
                        seed=seed,
                    )
                    scores += _scores(report, iou, _METRICS[task.name])
            results.append({"weights": name, "case": case.name, "scores": scores})
            scores_text = " ".join(
                f"{row['class']} {row['metric']} {row['iou']}: {row['ap'][1]:.1f}" for row in scores
            )
            print(f"{name:<22} {case.name:<20} {scores_text}")
    print_record(
        {
            "frames": len(samples),
            "sample_list": sample_list,
            "engine": engine,
            "resamples": bootstrap,
            "results": results,
        },
        seed=seed,
        weights=weights,
    )


def _detect(
    task: Task,
    predictor: Predictor,
    samples: Sequence[CameraLidarSample],
    case: Case,
    seed: int,
    folder: Path,
) -> None:
    for sample in track(samples, description=f"{predictor.name}, {case.name}"):
        given = case.corrupt(sample, seed).sample
        path = folder / f"{sample.sample_id}.txt"
        task.outputs[0].write(path, given, predictor(given))


def _scores(report: ObjectReport, iou: float, metrics: Sequence[str]) -> list[dict[str, Any]]:
    """Collect a row for each class and metric, with lists by difficulty.

    Classes other than cars have the same overlaps in both reports and are taken from the first.
    """
    groups: dict[tuple[str, str], dict[str, ObjectEntry]] = {}
    for entry in report.entries:
        if entry.metric in metrics and (iou == max(_OVERLAPS) or entry.class_name == "Car"):
            groups.setdefault((entry.class_name, entry.metric), {})[entry.difficulty] = entry
    rows = []
    for (class_name, metric), by_difficulty in groups.items():
        entries = [by_difficulty[difficulty] for difficulty in DIFFICULTIES]
        points = [entry.all_points for entry in entries]
        interval = points[1]
        flipped = by_difficulty["moderate"].flipped_share
        rows.append(
            {
                "class": class_name,
                "metric": metric,
                "iou": iou if class_name == "Car" else 0.5,
                "objects": [entry.n_gt for entry in entries],
                "ap": [round(each.ap, 2) if each else 0.0 for each in points],
                "ap_95": interval and [round(end or 0, 2) for end in (interval.low, interval.high)],
                "ap_r40": [round(entry.ap_r40, 2) for entry in entries],
                "ap_r11": [round(entry.ap_r11, 2) for entry in entries],
                "max_recall": [round(100 * entry.max_recall, 2) for entry in entries],
                "flipped": None if flipped is None else round(100 * flipped, 1),
            }
        )
    return rows


if __name__ == "__main__":
    jsonargparse.auto_cli(main)

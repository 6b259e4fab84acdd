"""Scores of joined objects beside those of each detector: `python -m benchmarks.joined DATA CACHE`.

Sensors are sound, blank, or have 16 of 64 beams (each of the four choices of rings). Scores by
KITTI's rules, moderate, AP over all points of the curve; differences with the 95 % interval of a
paired bootstrap over frames. Prints a row for each state and score, then one line of JSON, kept in
benchmarks/results/joined.json.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import jsonargparse
import torch

from benchmarks.joined_frames import CASES, DetectionStore
from benchmarks.record import print_record
from sightline.data.kitti_conversion import kitti_from_detections, kitti_from_labels
from sightline.data.kitti_labels import KittiObjects
from sightline.data.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.evaluation.kitti_object_comparison import PairedDifference, compare_submissions
from sightline.evaluation.kitti_object_pairs import find_pairs
from sightline.evaluation.kitti_object_rules import STRICT, ClassOverlaps, MinimumOverlaps
from sightline.export.names import EngineName
from sightline.geometry.boxes2d import Boxes2D
from sightline.joining.files import kitti_from_objects
from sightline.joining.fitting import FitFrame
from sightline.joining.join import JoinConfig, join_detections
from sightline.joining.models import SHIPPED, JoinModels, read_models
from sightline.structures.level import level_calibration
from sightline.structures.predictions import Detections2D, Detections3D

_HALF: Final = MinimumOverlaps(car=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5))
_SCORES: Final = (
    ("Car", "bbox", 0.7, STRICT),
    ("Car", "3d", 0.7, STRICT),
    ("Car", "3d", 0.5, _HALF),
    ("Pedestrian", "bbox", 0.5, STRICT),
    ("Pedestrian", "3d", 0.5, STRICT),
)


class _Results(NamedTuple):
    """Results of all frames in one state: of each detector, and joined."""

    image: list[KittiObjects]
    sweep: list[KittiObjects]
    joined_image: list[KittiObjects]
    joined_space: list[KittiObjects]


def main(
    data: Path,
    cache: Path,
    models: Path = SHIPPED,
    sample_list: str = "sample_val",
    velodyne: Velodyne | None = None,
    cases: Sequence[str] = tuple(CASES),
    resamples: int = 1000,
    seed: int = 0,
    engine: EngineName = "openvino",
) -> None:
    """Print a row for each state and score, then one line of JSON.

    Args:
        data: KITTI object tree with labels.
        cache: Folder for detections, which a second run reads.
        models: File of the models.
        sample_list: List of frames in ImageSets, or a text file with one name a line.
        velodyne: Folder of the sweeps; None: velodyne, or else velodyne_reduced.
        cases: States of the sensors.
        resamples: Number of resamples of the frames.
        seed: Seed of the resamples.
        engine: Inference engine.
    """
    torch.set_num_threads(1)
    dataset = open_dataset(data, sample_list=sample_list, velodyne=velodyne)
    samples = [dataset[index] for index in range(len(dataset))]
    labels = [kitti_from_labels(s.objects, s.calibration) for s in samples if s.objects is not None]
    fitted = read_models(models)
    weights: dict[str, str] = fitted.provenance["weights"]
    store = DetectionStore(weights["detection2d"], weights["detection3d"], cache, engine)
    results: list[dict[str, Any]] = []
    for case in cases:
        found = join_all(list(store.frames(samples, case, CASES[case])), fitted)
        for row in _compare(found, labels, resamples, seed):
            results.append({"case": case, **row})
            print(f"{case:<18} {_text(row)}", flush=True)
    print_record(
        {
            "frames": len(samples),
            "sample_list": sample_list,
            "engine": engine,
            "resamples": resamples,
            "results": results,
        },
        seed=seed,
        weights=list(weights.values()),
    )


def join_all(frames: Sequence[FitFrame], models: JoinModels) -> _Results:
    """Join the detections of all frames of one state, as result files."""
    found = _Results([], [], [], [])
    for frame in frames:
        sample = frame.sample
        objects = join_detections(sample, frame.found2d, frame.found3d, models, JoinConfig())
        found.image.append(_columns(frame, frame.found2d))
        found.sweep.append(_columns(frame, frame.found3d))
        found.joined_image.append(kitti_from_objects(objects, sample))
        found.joined_space.append(kitti_from_objects(objects, sample, in_space=True))
    return found


def _columns(frame: FitFrame, found: Detections2D | Detections3D | None) -> KittiObjects:
    sample = frame.sample
    if found is None:
        found = Detections2D(
            class_names=(), boxes=Boxes2D(torch.zeros(0, 4)), scores=torch.zeros(0)
        )
    calibration = level_calibration(sample.calibration, sample.level_from_lidar)
    return kitti_from_detections(found, calibration, sample.image_size)


def _compare(
    found: _Results, labels: list[KittiObjects], resamples: int, seed: int
) -> list[dict[str, Any]]:
    """Rows of joined less alone; in the image less each detector."""
    rows = []
    for class_name, metric, iou, overlaps in _SCORES:
        joined = found.joined_image if metric == "bbox" else found.joined_space
        row: dict[str, Any] = {"class": class_name, "metric": metric, "iou": iou}
        for name, alone in (("image", found.image), ("sweep", found.sweep)):
            if metric == "3d" and name == "image":
                continue
            pair = _difference(
                joined, alone, labels, overlaps, (class_name, metric), resamples, seed
            )
            if pair is not None:
                row["joined"] = round(pair.first, 2)
                row[name] = round(pair.second, 2)
                row[f"less_{name}_95"] = (
                    None if pair.low is None else [round(pair.low, 2), round(pair.high or 0, 2)]
                )
        rows.append(row)
    return rows


def _difference(
    joined: list[KittiObjects],
    alone: list[KittiObjects],
    labels: list[KittiObjects],
    overlaps: MinimumOverlaps,
    score: tuple[str, str],
    resamples: int,
    seed: int,
) -> PairedDifference | None:
    """Compare by class and metric, moderate; None: neither has results."""
    entries = compare_submissions(
        find_pairs(joined, labels, overlaps.as_array()),
        find_pairs(alone, labels, overlaps.as_array()),
        overlaps,
        num_resamples=resamples,
        seed=seed,
    )
    for entry in entries:
        if (entry.class_name, entry.metric) == score and entry.difficulty == "moderate":
            return entry.all_points
    return None


def _text(row: dict[str, Any]) -> str:
    alone = " ".join(f"{name} {row[name]:.1f}" for name in ("image", "sweep") if name in row)
    return (
        f"{row['class']} {row['metric']} {row['iou']}: {alone} joined {row.get('joined', 0):.1f} "
        + " ".join(str(row[key]) for key in row if key.endswith("_95"))
    )


if __name__ == "__main__":
    jsonargparse.auto_cli(main)

"""Scores of joined objects beside those of each detector: `python -m benchmarks.joined DATA CACHE`.

States of the sensors are `CASES` of joined_frames.py. Scores by KITTI's rules, moderate, AP over
all points of the curve, with differences and the 95 % interval of a paired bootstrap over frames;
and nuScenes' AP by centre distance. In each state the LiDAR's mount is measured by the frames, as
`JoinedPredictor.aligned` does, unless these are of several rigs (`--align false`). Prints a row for
each state and score, then one line of JSON, kept in benchmarks/results/joined.json.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import jsonargparse
import torch

from benchmarks.joined_frames import CASES, DetectionStore, open_labelled
from benchmarks.record import print_record
from sightline.data.formats.kitti_conversion import kitti_from_detections
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.evaluation.kitti_object_comparison import (
    ComparedEntry,
    PairedDifference,
    compare_submissions,
)
from sightline.evaluation.kitti_object_pairs import find_pairs
from sightline.evaluation.kitti_object_rules import STRICT, ClassOverlaps, MinimumOverlaps
from sightline.export.names import EngineName
from sightline.geometry.boxes2d import Boxes2D
from sightline.joining.alignment import Alignment, AlignmentConfig
from sightline.joining.alignment_by_boxes import turn_by_boxes
from sightline.joining.config import JoinConfig
from sightline.joining.files import kitti_from_objects
from sightline.joining.fitting import FitFrame
from sightline.joining.join import join_detections
from sightline.joining.models import SHIPPED, JoinModels
from sightline.joining.recording import measure_recording
from sightline.joining.refining import Refine
from sightline.structures.level import level_calibration
from sightline.structures.lidar_turn import undo_turn
from sightline.structures.predictions import Detections2D, Detections3D
from sightline.structures.sample import CameraLidarSample

_CENTRE: Final = "centre_2m"
_HALF: Final = MinimumOverlaps(car=ClassOverlaps(bbox=0.5, bev=0.5, box3d=0.5))
_SCORES: Final = (
    ("Car", "bbox", 0.7),
    ("Car", "3d", 0.7),
    ("Car", "3d", 0.5),
    ("Car", _CENTRE, None),
    ("Pedestrian", "bbox", 0.5),
    ("Pedestrian", "3d", 0.5),
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
    *,
    align: bool = True,
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
        align: Measure the LiDAR's mount, which must be that of all frames.
    """
    torch.set_num_threads(1)
    given = open_labelled(data, sample_list, velodyne, models, cache, engine)
    samples, labels, store = given.samples, given.labels, given.store
    results: list[dict[str, Any]] = []
    for case in cases:
        frames = list(store.frames(samples, case, CASES[case]))
        by_name = {frame.sample.sample_id: (frame.found2d, frame.found3d) for frame in frames}
        alignment = Alignment()
        if align:
            alignment = measure_recording(
                [frame.sample for frame in frames], partial(_found, by_name), AlignmentConfig()
            )
        aligned = _aligned(store, samples, case, frames, alignment)
        found = join_all(
            frames,
            given.models,
            aligned,
            JoinConfig(sweep_in_image=not alignment.late),
            store.detector3d.refine_boxes,
        )
        told = {
            "by_boxes": alignment.by_boxes,
            "late": alignment.late,
            "undone": alignment.turn.to_json(),
        }
        for row in _compare(found, labels, resamples, seed):
            results.append({"case": case, **told, **row})
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
        weights=given.weights,
    )


def _found(
    by_name: Mapping[str, tuple[Detections2D | None, Detections3D | None]],
    sample: CameraLidarSample,
) -> tuple[Detections2D | None, Detections3D | None]:
    return by_name[sample.sample_id]


def _aligned(
    store: DetectionStore,
    samples: list[CameraLidarSample],
    case: str,
    frames: list[FitFrame],
    alignment: Alignment,
) -> list[FitFrame]:
    """Frames with the rotation of their LiDAR undone, and detections in them."""

    def undone(sample: CameraLidarSample, position: int) -> CameraLidarSample:
        return undo_turn(CASES[case](sample, position), alignment.turn)

    if alignment.turn:
        return list(store.frames(samples, f"{case}_undone", undone))
    if not alignment.by_boxes:
        return frames
    turns = [turn_by_boxes(frame.sample, frame.found2d, frame.found3d) for frame in frames]
    return [
        replace(frame, sample=undo_turn(frame.sample, turn))
        for frame, turn in zip(frames, turns, strict=True)
    ]


def join_all(
    frames: Sequence[FitFrame],
    models: JoinModels,
    aligned: Sequence[FitFrame] | None = None,
    config: JoinConfig | None = None,
    refine: Refine | None = None,
) -> _Results:
    """Join the detections of all frames of one state, as result files.

    `aligned` has the same frames with the rotation of their LiDAR undone, which are joined in their
    place.
    """
    config = config or JoinConfig()
    found = _Results([], [], [], [])
    for given, frame in zip(frames, aligned or frames, strict=True):
        sample = frame.sample
        objects = join_detections(sample, frame.found2d, frame.found3d, models, config, refine)
        found.image.append(_columns(given, given.found2d))
        found.sweep.append(_columns(given, given.found3d))
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

    def compare(
        joined: list[KittiObjects], alone: list[KittiObjects], overlaps: MinimumOverlaps
    ) -> Sequence[ComparedEntry]:
        return compare_submissions(
            find_pairs(joined, labels, overlaps.as_array()),
            find_pairs(alone, labels, overlaps.as_array()),
            overlaps,
            num_resamples=resamples,
            seed=seed,
        )

    in_image = {
        "image": compare(found.joined_image, found.image, STRICT),
        "sweep": compare(found.joined_image, found.sweep, STRICT),
    }
    in_space = {
        iou: {"sweep": compare(found.joined_space, found.sweep, overlaps)}
        for iou, overlaps in ((0.7, STRICT), (0.5, _HALF))
    }
    rows = []
    for class_name, metric, iou in _SCORES:
        row: dict[str, Any] = {"class": class_name, "metric": metric, "iou": iou}
        # Only cars' overlap differs between both entries in space.
        space = in_space[0.5 if iou == 0.5 else 0.7]
        for name, entries in (in_image if metric == "bbox" else space).items():
            pair = _pair(entries, class_name, metric)
            if pair is not None:
                row["joined"] = round(pair.first, 2)
                row[name] = round(pair.second, 2)
                row[f"less_{name}_95"] = (
                    None if pair.low is None else [round(pair.low, 2), round(pair.high or 0, 2)]
                )
        rows.append(row)
    return rows


def _pair(
    entries: Sequence[ComparedEntry], class_name: str, metric: str
) -> PairedDifference | None:
    """Find the moderate scores of a class and metric; None: neither has results."""
    for entry in entries:
        if entry.class_name == class_name and entry.difficulty == "moderate":
            if metric == _CENTRE and entry.metric == "3d":
                return entry.centre_2m
            if metric == entry.metric:
                return entry.all_points
    return None


def _text(row: dict[str, Any]) -> str:
    alone = " ".join(f"{name} {row[name]:.1f}" for name in ("image", "sweep") if name in row)
    return (
        f"{row['class']} {row['metric']} {row['iou'] or ''}: {alone} "
        f"joined {row.get('joined', 0):.1f} "
        + " ".join(str(row[key]) for key in row if key.endswith("_95"))
    )


if __name__ == "__main__":
    jsonargparse.auto_cli(main)

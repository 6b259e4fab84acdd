"""Calibration of the joined score: `python -m benchmarks.joined_calibration DATA CACHE`.

Detection expected calibration error (D-ECE, Kueppers et al. 2020, by the score) of joined objects
and of each detector, moderate, over ten bins of detections with a score of 0.3 or more; differences
with the 95 % interval of a paired bootstrap over frames. Prints a row for each state and class,
then one line of JSON, kept in benchmarks/results/joined_calibration*.json.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import jsonargparse
import numpy as np
import torch

from benchmarks.joined import join_all
from benchmarks.joined_frames import CASES, open_labelled
from benchmarks.record import print_record
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.data.layouts.kitti_trees import Velodyne
from sightline.evaluation.calibration_errors import Outcomes, find_outcomes, find_reliability
from sightline.evaluation.kitti_object_matching import index_pairs, select
from sightline.evaluation.kitti_object_pairs import find_pairs
from sightline.evaluation.kitti_object_rules import CLASSES, DIFFICULTIES, METRICS, Metric
from sightline.export.names import EngineName
from sightline.joining.models import SHIPPED
from sightline.structures.score_curves import Reliability
from sightline.visualization.reliability import draw_reliability_sheet

_BINS: Final = 10
_MIN_SCORE: Final = 0.3


class _Score(NamedTuple):
    class_name: str
    metric: Metric
    iou: float


_SCORES: Final = (
    _Score("Car", "bbox", 0.7),
    _Score("Car", "3d", 0.7),
    _Score("Car", "3d", 0.5),
    _Score("Pedestrian", "bbox", 0.5),
    _Score("Pedestrian", "3d", 0.5),
)
_DRAWN: Final = _SCORES[0]


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
    picture: Path | None = None,
) -> None:
    """Print a row for each state and class, then one line of JSON.

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
        picture: PNG or JPEG for reliability diagrams of cars in the image, a row for each state.
    """
    torch.set_num_threads(1)
    given = open_labelled(data, sample_list, velodyne, models, cache, engine)
    samples, labels, store = given.samples, given.labels, given.store
    results: list[dict[str, Any]] = []
    diagrams = []
    for case in cases:
        frames = list(store.frames(samples, case, CASES[case]))
        found = join_all(frames, given.models, refine=store.detector3d.refine_boxes)
        for score in _SCORES:
            in_image = score.metric == "bbox"
            lists = {
                **({"image": found.image} if in_image else {}),
                "sweep": found.sweep,
                "joined": found.joined_image if in_image else found.joined_space,
            }
            outcomes = {name: _by_frame(each, labels, score) for name, each in lists.items()}
            row = {"case": case, **score._asdict(), **_row(outcomes, resamples, seed)}
            results.append(row)
            print(row, flush=True)
            if score == _DRAWN:
                diagrams.append(
                    [(f"{case}, {name}", _reliability(each)) for name, each in outcomes.items()]
                )
    if picture is not None:
        write_rgb(picture, draw_reliability_sheet(diagrams))
    print_record(
        {
            "frames": len(samples),
            "sample_list": Path(sample_list).stem,
            "engine": engine,
            "bins": _BINS,
            "min_score": _MIN_SCORE,
            "resamples": resamples,
            "results": results,
        },
        seed=seed,
        weights=given.weights,
    )


def _by_frame(
    found: Sequence[KittiObjects], labels: Sequence[KittiObjects], score: _Score
) -> list[Outcomes]:
    """Outcomes of each frame's detections, moderate."""
    code, metric = CLASSES.index(score.class_name), METRICS.index(score.metric)
    overlaps = np.full((len(CLASSES), len(METRICS)), score.iou)
    outcomes = []
    for each, truth in zip(found, labels, strict=True):
        pairs = find_pairs([each], [truth], overlaps)
        task = select(
            pairs,
            index_pairs(pairs),
            code=code,
            metric=metric,
            difficulty=DIFFICULTIES.index("moderate"),
            min_overlap=score.iou,
        )
        outcomes.append(find_outcomes(task, _MIN_SCORE))
    return outcomes


def _row(outcomes: dict[str, list[Outcomes]], resamples: int, seed: int) -> dict[str, Any]:
    """D-ECE and number of detections of each, and intervals of joined less each detector."""
    num_frames = len(outcomes["joined"])
    generator = np.random.default_rng(seed)
    drawn = [generator.integers(num_frames, size=num_frames) for _ in range(resamples)]
    errors = {
        name: [_error([frames[index] for index in each]) for each in drawn]
        for name, frames in outcomes.items()
    }
    row: dict[str, Any] = {}
    for name, frames in outcomes.items():
        error = _error(frames)
        row[name] = None if error is None else round(error, 2)
        row[f"n_{name}"] = sum(len(each.score) for each in frames)
        if name == "joined":
            continue
        pairs = zip(errors["joined"], errors[name], strict=True)
        lead = [ours - other for ours, other in pairs if ours is not None and other is not None]
        if len(lead) == resamples:
            low, high = np.quantile(lead, (0.025, 0.975))
            row[f"less_{name}_95"] = [round(float(low), 2), round(float(high), 2)]
    return row


def _error(frames: Sequence[Outcomes]) -> float | None:
    """D-ECE, percent; None without detections."""
    error = _reliability(frames).error
    return None if error is None else 100 * error


def _reliability(frames: Sequence[Outcomes]) -> Reliability:
    scores = np.concatenate([each.score for each in frames])
    is_true = np.concatenate([each.is_true for each in frames]).astype(np.float64)
    return find_reliability(scores, is_true, _BINS)


if __name__ == "__main__":
    jsonargparse.auto_cli(main)

"""Object detection scores by KITTI's own evaluation, for tasks with KITTI's result files."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DIFFICULTIES,
    ClassName,
    ClassOverlaps,
    Difficulty,
    Metric,
    MinimumOverlaps,
)
from sightline.robustness.scoring import BenchFrame, BenchMetric, BenchPrediction, Panel, Scores

if TYPE_CHECKING:
    from sightline.data.kitti_trees import Part
    from sightline.data.open import SampleDataset
    from sightline.evaluation.object_report import ObjectEntry, ObjectReport
    from sightline.structures.sample import CameraLidarSample

_LEVELS: Final[tuple[Difficulty, ...]] = ("moderate", "easy", "hard")
_METRIC_TITLES: Final[dict[Metric, str]] = {"bbox": "2D", "bev": "bird's eye", "3d": "3D"}
_AVERAGES: Final = {"R40": "AP R40", "all_points": "AP, all points"}
"""Averages of precision over recall: KITTI's own, and over all scores, for small samples."""


class Target(NamedTuple):
    """Class, metric and overlap for scoring detections."""

    class_name: ClassName
    metric: Metric
    iou: float
    """Overlap that a match must exceed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectScoring:
    """`Scoring` by average precision, percent, as in `sightline evaluate objects`."""

    targets: tuple[Target, ...]
    """Targets, the most important first."""
    write: "Callable[[Path, CameraLidarSample, Any], None]"
    """Function that writes the task's prediction as a result file."""
    read_file: "Callable[[Path, CameraLidarSample], Any]"
    """Function that reads a prediction from a result file."""
    panels: Callable[[BenchPrediction, int], tuple[Panel, ...]]
    """Function for `Scoring.draw`."""
    name: str = field(default="KITTI objects", init=False)
    suffix: str = field(default=".txt", init=False)
    parts: "tuple[Part, ...]" = field(default=("objects",), init=False)
    takes_results: bool = field(default=True, init=False)

    @property
    def metrics(self) -> tuple[BenchMetric, ...]:
        """Both averages of each target, moderate first."""
        return tuple(
            BenchMetric(
                name=_metric_name(target, difficulty, average),
                title=(
                    f"{target.class_name}, {_METRIC_TITLES[target.metric]} IoU {target.iou:g}, "
                    f"{difficulty}, {title}"
                ),
                unit="%",
                highest=100.0,
            )
            for target in self.targets
            for average, title in _AVERAGES.items()
            for difficulty in _LEVELS
        )

    def check(self, dataset: "SampleDataset") -> None:
        """Check for labels; see `Scoring.check`."""
        _labels_folder(dataset)

    def notes(self, dataset: "SampleDataset") -> tuple[str, ...]:
        """Note the maximum of R40 if there are fewer objects than recall positions."""
        from sightline.evaluation.object_tables import slots_note

        counts = _object_counts(_labels_folder(dataset), dataset.sample_ids)
        scored = {target.class_name for target in self.targets}
        return tuple(
            slots_note([(*key, n) for key, n in sorted(counts.items()) if key[0] in scored])
        )

    def prepare(self, sample: "CameraLidarSample") -> BenchFrame:
        """Return the frame unchanged."""
        return BenchFrame(sample, None)

    def store(self, path: Path, prediction: BenchPrediction) -> None:
        """Write KITTI's result file."""
        self.write(path, prediction.frame.sample, prediction.output)

    def read(self, path: Path, sample: "CameraLidarSample") -> object:
        """Read a result file; see `Scoring.read`."""
        return self.read_file(path, sample)

    def draw(self, prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
        """Draw a prediction; see `Scoring.draw`."""
        return self.panels(prediction, width_px)

    def score(self, folder: Path, dataset: "SampleDataset") -> Scores:
        """Score result files; see `Scoring.score`. None if no object of the class counts."""
        from sightline.evaluation.kitti_object import evaluate_objects

        labels, names = _labels_folder(dataset), dataset.sample_ids
        scores: dict[str, float | None] = {}
        for chosen in _separable(self.targets):
            report = evaluate_objects(folder, labels, sample_list=names, overlaps=_overlaps(chosen))
            for target in chosen:
                scores |= _scores(target, report, labels, names)
        return {metric.name: scores[metric.name] for metric in self.metrics}


def _metric_name(target: Target, difficulty: Difficulty, average: str) -> str:
    return f"{target.class_name}_{target.metric}_{target.iou:g}_{difficulty}_{average}"


def _labels_folder(dataset: "SampleDataset") -> Path:
    from sightline.data.open import label_file

    files = (label_file(dataset, index) for index in range(len(dataset)))
    labelled = next(filter(None, files), None)
    if labelled is not None:
        return labelled.parent
    raise ValueError(
        "the data have no labels to score detections against, expected a recording with labels or "
        "KITTI's object tree with training/label_2; name a folder that holds them"
    )


def _separable(targets: Sequence[Target]) -> list[list[Target]]:
    """Group targets for single evaluations: one overlap per class and metric."""
    groups: list[list[Target]] = []
    for target in targets:
        for group in groups:
            if all(each[:2] != target[:2] for each in group):
                group.append(target)
                break
        else:
            groups.append([target])
    return groups


def _overlaps(targets: Sequence[Target]) -> MinimumOverlaps:
    """Collect the targets' overlaps, with KITTI's own for all other classes and metrics."""
    strict = MinimumOverlaps()
    ious = {(target.class_name, target.metric): target.iou for target in targets}

    def class_overlaps(name: ClassName) -> ClassOverlaps:
        own: ClassOverlaps = getattr(strict, name.lower())
        return ClassOverlaps(
            bbox=ious.get((name, "bbox"), own.bbox),
            bev=ious.get((name, "bev"), own.bev),
            box3d=ious.get((name, "3d"), own.box3d),
        )

    return MinimumOverlaps(
        car=class_overlaps("Car"),
        pedestrian=class_overlaps("Pedestrian"),
        cyclist=class_overlaps("Cyclist"),
    )


def _scores(
    target: Target, report: "ObjectReport", labels: Path, names: Sequence[str]
) -> dict[str, float | None]:
    entries = {
        entry.difficulty: entry
        for entry in report.entries
        if (entry.class_name, entry.metric) == (target.class_name, target.metric)
    }
    found: dict[str, float | None] = {}
    for difficulty in _LEVELS:
        if entries:
            values = _entry_scores(entries[difficulty])
        else:  # the report omits a class without detections
            count = _object_counts(labels, names)[target.class_name, difficulty]
            values = dict.fromkeys(_AVERAGES, 0.0 if count else None)
        for average, value in values.items():
            found[_metric_name(target, difficulty, average)] = value
    return found


def _entry_scores(entry: "ObjectEntry") -> dict[str, float | None]:
    if entry.n_gt == 0:
        return dict.fromkeys(_AVERAGES)
    assert entry.all_points is not None, "objects count"
    return {"R40": entry.ap_r40, "all_points": entry.all_points.ap}


def _object_counts(labels: Path, names: Sequence[str]) -> Counter[tuple[ClassName, Difficulty]]:
    """Count the labelled objects by class and difficulty."""
    from sightline.data.kitti_labels import read_labels
    from sightline.evaluation.kitti_object_rules import class_code, truth_levels

    counts: Counter[tuple[ClassName, Difficulty]] = Counter()
    for name in names:
        objects = read_labels(labels / f"{name}.txt")
        levels = truth_levels(objects.truncation, objects.occlusion, objects.boxes2d).tolist()
        for class_name, first in zip(objects.class_names, levels, strict=True):
            code = class_code(class_name)
            if code >= 0:
                counts.update((CLASSES[code], each) for each in DIFFICULTIES[first:])
    return counts

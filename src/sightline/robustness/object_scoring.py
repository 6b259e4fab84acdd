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
from sightline.jobs.output_dirs import finished_names
from sightline.robustness.result_doubts import object_doubts
from sightline.robustness.scoring import BenchFrame, BenchMetric, BenchPrediction, Panel, Scores

if TYPE_CHECKING:
    from sightline.data.datasets.sample_dataset import SampleDataset
    from sightline.data.layouts.kitti_trees import Part
    from sightline.evaluation.object_report import ObjectEntry, ObjectReport
    from sightline.evaluation.object_tally import ResultDoubt
    from sightline.structures.sample import CameraLidarSample

_LEVELS: Final[tuple[Difficulty, ...]] = ("moderate", "easy", "hard")
_METRIC_TITLES: Final[dict[Metric, str]] = {"bbox": "2D", "bev": "bird's eye", "3d": "3D"}
_CENTRE_TITLES: Final = {"0.5-4m": "mean of 0.5, 1, 2 and 4 m", "2m": "2 m"}
_IN_SPACE: Final = "3d"
"""Folder within a case's, of result files with the scores of 3D boxes."""
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
    by_centre: tuple[ClassName, ...] = ()
    """Classes that are also scored by nuScenes' centre distance."""
    write_in_space: "Callable[[Path, CameraLidarSample, Any], None] | None" = None
    """Function that writes a second result file, for the metrics of 3D boxes, if their scores
    differ; None: the first file has them. Results of other methods have one file."""
    name: str = field(default="KITTI objects", init=False)
    suffix: str = field(default=".txt", init=False)
    parts: "tuple[Part, ...]" = field(default=("objects",), init=False)
    takes_results: bool = field(default=True, init=False)

    @property
    def metrics(self) -> tuple[BenchMetric, ...]:
        """Both averages of each target, moderate first, then AP by centre distance."""
        by_iou = tuple(
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
        by_centre = tuple(
            BenchMetric(
                name=_centre_name(class_name, difficulty, distance),
                title=f"{class_name}, centre distance, {difficulty}, AP, {title}",
                unit="%",
                highest=100.0,
            )
            for class_name in self.by_centre
            for distance, title in _CENTRE_TITLES.items()
            for difficulty in _LEVELS
        )
        return by_iou + by_centre

    def check(self, dataset: "SampleDataset") -> None:
        """Check for labels; see `Scoring.check`."""
        _labels_folder(dataset)

    def notes(self, dataset: "SampleDataset") -> tuple[str, ...]:
        """Note that no object is labelled, or the maximum of R40 if there are few objects."""
        from sightline.evaluation.object_tables import slots_note
        from sightline.evaluation.object_tally import NOTHING_LABELLED

        counts = _object_counts(_labels_folder(dataset), dataset.sample_ids)
        if not counts.total():
            return (NOTHING_LABELLED,)
        scored = {target.class_name for target in self.targets}
        return tuple(
            slots_note([(*key, n) for key, n in sorted(counts.items()) if key[0] in scored])
        )

    def prepare(self, sample: "CameraLidarSample") -> BenchFrame:
        """Return the frame unchanged."""
        return BenchFrame(sample, None)

    def store(self, path: Path, prediction: BenchPrediction) -> None:
        """Write KITTI's result file, or both of them; the first one last, as it counts as done."""
        sample, output = prediction.frame.sample, prediction.output
        if self.write_in_space is not None:
            in_space = path.parent / _IN_SPACE / path.name
            in_space.parent.mkdir(parents=True, exist_ok=True)
            self.write_in_space(in_space, sample, output)
        self.write(path, sample, output)

    def finished(self, folder: Path) -> frozenset[str]:
        """List the frames with all their result files; see `ResultWriter.finished`."""
        names = finished_names(folder, self.suffix)
        is_pair = self.write_in_space is not None
        return names & finished_names(folder / _IN_SPACE, self.suffix) if is_pair else names

    def read(self, path: Path, sample: "CameraLidarSample") -> object:
        """Read a result file; see `Scoring.read`."""
        return self.read_file(path, sample)

    def draw(self, prediction: BenchPrediction, width_px: int) -> tuple[Panel, ...]:
        """Draw a prediction; see `Scoring.draw`."""
        return self.panels(prediction, width_px)

    def score(self, folder: Path, dataset: "SampleDataset") -> Scores:
        """Score result files; see `Scoring.score`. None if no object of the class counts."""
        return self.score_and_doubt(folder, dataset)[0]

    def score_and_doubt(
        self, folder: Path, dataset: "SampleDataset"
    ) -> "tuple[Scores, tuple[ResultDoubt, ...]]":
        """Score result files, and list doubts about them; see `DoubtingScoring`."""
        labels, names = _labels_folder(dataset), dataset.sample_ids
        in_space = folder / _IN_SPACE
        if not in_space.is_dir():
            scores, doubts = self._scores(folder, self.targets, labels, names)
        else:
            in_image = [target for target in self.targets if target.metric == "bbox"]
            others = [target for target in self.targets if target.metric != "bbox"]
            scores, doubts = self._scores(folder, in_image, labels, names)
            scores_in_space, doubts_in_space = self._scores(in_space, others, labels, names)
            scores |= scores_in_space
            doubts |= doubts_in_space
        return {each.name: scores[each.name] for each in self.metrics}, tuple(doubts.values())

    def _scores(
        self, folder: Path, targets: Sequence[Target], labels: Path, names: Sequence[str]
    ) -> "tuple[dict[str, float | None], dict[str, ResultDoubt]]":
        """Score the targets, and centre distances if a target is in 3D; and doubts by text."""
        from sightline.evaluation.kitti_object import evaluate_objects

        scores: dict[str, float | None] = {}
        doubts: dict[str, ResultDoubt] = {}
        classes = [target.class_name for target in targets]
        is_in_space = any(target.metric != "bbox" for target in targets)
        for chosen in _separable(targets):
            report = evaluate_objects(folder, labels, sample_list=names, overlaps=_overlaps(chosen))
            for target in chosen:
                scores |= _scores(target, report, labels, names)
            if any(target.metric == "3d" for target in chosen):
                scores |= _centre_scores(self.by_centre, report, labels, names)
            if report.tally is not None and not doubts:
                found = object_doubts(report.tally, classes, in_space=is_in_space)
                doubts = {doubt.text: doubt for doubt in found}
        return scores, doubts


def _metric_name(target: Target, difficulty: Difficulty, average: str) -> str:
    return f"{target.class_name}_{target.metric}_{target.iou:g}_{difficulty}_{average}"


def _centre_name(class_name: str, difficulty: Difficulty, distance: str) -> str:
    return f"{class_name}_centre_{distance}_{difficulty}"


def _labels_folder(dataset: "SampleDataset") -> Path:
    from sightline.data.datasets.sample_files import label_file

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


def _centre_scores(
    class_names: Sequence[ClassName], report: "ObjectReport", labels: Path, names: Sequence[str]
) -> dict[str, float | None]:
    entries = {
        (entry.class_name, entry.difficulty): entry
        for entry in report.entries
        if entry.metric == "3d"
    }
    found: dict[str, float | None] = {}
    for class_name in class_names:
        for difficulty in _LEVELS:
            entry = entries.get((class_name, difficulty))
            if entry is None:  # the report omits a class without detections
                count = _object_counts(labels, names)[class_name, difficulty]
                values = dict.fromkeys(_CENTRE_TITLES, 0.0 if count else None)
            elif entry.centres is None:
                values = dict.fromkeys(_CENTRE_TITLES)
            else:
                values = {"0.5-4m": entry.centres.ap, "2m": entry.centres.ap_2m}
            for distance, value in values.items():
                found[_centre_name(class_name, difficulty, distance)] = value
    return found


def _entry_scores(entry: "ObjectEntry") -> dict[str, float | None]:
    if entry.n_gt == 0:
        return dict.fromkeys(_AVERAGES)
    assert entry.all_points is not None, "objects count"
    return {"R40": entry.ap_r40, "all_points": entry.all_points.ap}


def _object_counts(labels: Path, names: Sequence[str]) -> Counter[tuple[ClassName, Difficulty]]:
    """Count the labelled objects by class and difficulty."""
    from sightline.data.formats.kitti_labels import read_labels
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

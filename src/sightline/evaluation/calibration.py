"""Calibration of a detector's scores on KITTI's result files, with and without calibrators.

KITTI's own matching (`kitti_object`) decides which detections are true, false or ignored.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.kitti_labels import KittiObjects, read_results, write_objects
from sightline.data.layouts.frame_lists import lasting_list
from sightline.data.layouts.kitti_trees import describe_absent
from sightline.evaluation.calibration_errors import (
    Outcomes,
    find_outcomes,
    find_reliability,
    optimal_lrp,
)
from sightline.evaluation.calibration_report import (
    CalibrationEntry,
    CalibrationReport,
    ScoreCalibration,
)
from sightline.evaluation.calibrators import (
    CALIBRATORS,
    Calibrator,
    CalibratorName,
    fit_calibrator,
)
from sightline.evaluation.kitti_object import frame_names, read_frames
from sightline.evaluation.kitti_object_matching import (
    MatchingTask,
    count_by_frame,
    index_pairs,
    select,
)
from sightline.evaluation.kitti_object_pairs import MatchingData, find_pairs
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DIFFICULTIES,
    METRICS,
    STRICT,
    ClassName,
    ClassOverlaps,
    Difficulty,
    Metric,
    MinimumOverlaps,
)
from sightline.evaluation.object_tally import ObjectTally, tallied, unread_files
from sightline.files.problem import FileError
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import plain_names
from sightline.geometry.choices import check_choices
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import acquire_output_dir, data_name

Target = Literal["precision", "overlap"]

_ANY_OVERLAP = ClassOverlaps(bbox=0.0, bev=0.0, box3d=0.0)
_ANY: Final = MinimumOverlaps(car=_ANY_OVERLAP, pedestrian=_ANY_OVERLAP, cyclist=_ANY_OVERLAP)
_MAX_BINS = 10_000


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationSettings:
    """Settings of the measurement.

    Raises:
        ValueError: A number is out of range.
    """

    metric: Metric = "bbox"
    difficulty: Difficulty = "moderate"
    overlaps: MinimumOverlaps = STRICT
    """Overlaps that a match must exceed."""
    num_bins: int = 25
    """Number of bins of equal width over the score; the default is that of Oksuz et al. 2023."""
    min_score: float = 0.0
    """Minimum score of the detections."""
    target: Target = "precision"
    """Target of the calibrators: whether a detection is true, or its overlap (0 if false), as
    needed for LaECE."""

    def __post_init__(self) -> None:
        """Check the choices and the ranges."""
        check_choices(self)
        if not 1 <= self.num_bins <= _MAX_BINS:
            raise ValueError(f"bins must be 1 to {_MAX_BINS:,}, got {self.num_bins}")
        if not 0 <= self.min_score < 1:
            raise ValueError(f"min_score must be at least 0 and below 1, got {self.min_score}")


@dataclass(frozen=True, kw_only=True, slots=True)
class ScoredFrames:
    """Result files with their labels."""

    results_dir: Path
    labels_dir: Path
    sample_list: Path | str | Sequence[str] | None = None
    """Frames to score; see `evaluate_objects`."""

    def __post_init__(self) -> None:
        """Keep the frames of an iterator."""
        object.__setattr__(self, "sample_list", lasting_list(self.sample_list))


@named_arguments
def evaluate_calibration(
    data: ScoredFrames,
    *,
    fit_on: ScoredFrames | None = None,
    calibrators: Sequence[CalibratorName] = (),
    settings: CalibrationSettings | None = None,
    progress: bool = False,
) -> CalibrationReport:
    """Compute D-ECE, LaECE and oLRP of each class, for raw and calibrated scores.

    Args:
        data: Frames for the evaluation.
        fit_on: Frames for fitting the calibrators; with `calibrators`, and only then.
        calibrators: Calibrators, fitted separately for each class.
        settings: Settings of the measurement.
        progress: Whether to show the progress.

    Raises:
        TypeError: `calibrators` is a text.
        ValueError: There is no such calibrator, a score is outside [0, 1], a class has no
            detections for fitting, or as for `evaluate_objects`.
    """
    calibrators = plain_names("calibrators", calibrators, CALIBRATORS)
    settings = settings or CalibrationSettings()
    if (fit_on is None) != (not calibrators):
        raise ValueError(
            "calibrators need frames for fitting (fit_on), and only they do: give both or none"
        )
    measured = _read(data, settings, progress=progress)
    codes = [
        code
        for code in range(len(CLASSES))
        if measured.strict.is_evaluated[code, METRICS.index(settings.metric)]
    ]
    fitted: dict[ClassName, dict[CalibratorName, Calibrator]] = {}
    if fit_on is not None:
        _warn_of_shared_frames(data, fit_on)
        fit_data = _read(fit_on, settings, progress=progress)
        for code in codes:
            outcomes = find_outcomes(fit_data.task(code), settings.min_score)
            fitted[CLASSES[code]] = _fit(CLASSES[code], outcomes, calibrators, fit_on, settings)
    entries = tuple(_measure(measured, code, fitted.get(CLASSES[code], {})) for code in codes)
    return CalibrationReport(
        frames=measured.strict.num_frames,
        metric=settings.metric,
        difficulty=settings.difficulty,
        min_score=settings.min_score,
        target=settings.target,
        entries=entries,
        num_results=measured.num_results,
        remarks=measured.remarks,
    )


def _warn_of_shared_frames(measured: ScoredFrames, fitted: ScoredFrames) -> None:
    """Warn of measured frames on which calibrators are fitted."""
    labels_dir = data_path(measured.labels_dir)
    if labels_dir.resolve() != data_path(fitted.labels_dir).resolve():
        return
    names = frame_names(labels_dir, measured.sample_list)
    shared = sorted({*names} & {*frame_names(labels_dir, fitted.sample_list)})
    if shared:
        warn_user(
            f"calibrators are fitted on {len(shared):,} of the {len(names):,} measured frames "
            f"({describe_absent(shared)}), so calibrated scores look too good; fit on other frames "
            "(--fit-list)",
        )


@named_arguments
def write_calibrated(
    data: ScoredFrames, out: Path, report: CalibrationReport, calibrator: CalibratorName
) -> int:
    """Write the result files with calibrated scores; classes not in the report are unchanged.

    Returns:
        Number of files.

    Raises:
        ValueError: The folder is that of the results or of the labels, or has other results, or
            the calibrator was not fitted.
    """
    for folder, content in (
        (data.results_dir, "results to be calibrated"),
        (data.labels_dir, "labels"),
    ):
        if out.resolve() == folder.resolve():
            raise ValueError(f"{out} holds the {content}: name another folder")
    fitted = {
        entry.class_name.lower(): entry.calibrators[calibrator]
        for entry in report.entries
        if calibrator in entry.calibrators
    }
    if len(fitted) < len(report.entries):
        raise ValueError(f"no calibrator {calibrator} was fitted: name one that was")
    names = frame_names(data_path(data.labels_dir), data.sample_list)
    results = data_path(data.results_dir)
    settings = {
        "sightline": version("sightline"),
        "results": data_name(data.results_dir),
        "calibrator": calibrator,
        "fitted": _digest(fitted),
    }
    acquire_output_dir(out, settings, results=("*.txt",))
    for name in names:
        objects = read_results(results / f"{name}.txt")
        assert objects.scores is not None, "result files have scores"
        scores = objects.scores.copy()
        classes = np.array([each.lower() for each in objects.class_names])
        for class_name, calibrate in fitted.items():
            is_class = classes == class_name
            scores[is_class] = calibrate(scores[is_class])
        write_objects(out / f"{name}.txt", replace(objects, scores=scores), decimals=None)
    return len(names)


def _digest(fitted: Mapping[str, Calibrator]) -> str:
    """Describe fitted calibrators in words that differ where a number does."""
    numbers = {
        name: {key: np.asarray(value).tolist() for key, value in asdict(each).items()}
        for name, each in sorted(fitted.items())
    }
    return hashlib.sha256(json.dumps(numbers).encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Measured:
    """Frames paired by the requested overlaps, and by any overlap."""

    strict: MatchingData
    loose: MatchingData
    settings: CalibrationSettings
    num_results: int
    remarks: tuple[str, ...]

    def task(self, code: int, *, any_overlap: bool = False) -> MatchingTask:
        """Select the matching task of a class."""
        settings = self.settings
        overlaps = _ANY if any_overlap else settings.overlaps
        data = self.loose if any_overlap else self.strict
        metric = METRICS.index(settings.metric)
        return select(
            data,
            index_pairs(data),
            code=code,
            metric=metric,
            difficulty=DIFFICULTIES.index(settings.difficulty),
            min_overlap=float(overlaps.as_array()[code, metric]),
        )


def _read(data: ScoredFrames, settings: CalibrationSettings, *, progress: bool) -> _Measured:
    results_dir, labels_dir = data_path(data.results_dir), data_path(data.labels_dir)
    names = frame_names(labels_dir, data.sample_list)
    tally = ObjectTally()
    frames = read_frames(results_dir, labels_dir, names, progress=progress)
    counted = tallied(frames, tally)
    found, labels = zip(*_checked(counted, names, results_dir), strict=True)
    strict = find_pairs(found, labels, settings.overlaps.as_array())
    loose = find_pairs(found, labels, _ANY.as_array())
    # A region excuses a detection independently of its overlap with an object.
    loose = replace(loose, detection_forgiven=strict.detection_forgiven)
    unread: tuple[str, ...] = ()
    if data.sample_list is None:
        unread = unread_files(results_dir, labels_dir, names)
    return _Measured(
        strict=strict,
        loose=loose,
        settings=settings,
        num_results=sum(map(len, found)),
        remarks=(*unread, *tally.remarks(in_space=settings.metric != "bbox")),
    )


def _checked(
    frames: Iterator[tuple[KittiObjects, KittiObjects]], names: Sequence[str], folder: Path
) -> Iterator[tuple[KittiObjects, KittiObjects]]:
    for name, (found, labels) in zip(names, frames, strict=True):
        assert found.scores is not None, "result files have scores"
        beyond = found.scores[(found.scores < 0) | (found.scores > 1)]
        if len(beyond):
            raise FileError(
                folder / f"{name}.txt",
                f"has a score of {beyond[0]:g}, expected 0 to 1: calibration compares "
                "scores with the share of correct detections",
                "write probabilities, such as the sigmoid of logits",
            )
        yield found, labels


def _targets(outcomes: Outcomes, target: Target) -> Float64[np.ndarray, " num_detections"]:
    return outcomes.is_true.astype(np.float64) if target == "precision" else outcomes.overlap


def _fit(
    class_name: ClassName,
    outcomes: Outcomes,
    names: Sequence[CalibratorName],
    source: ScoredFrames,
    settings: CalibrationSettings,
) -> dict[CalibratorName, Calibrator]:
    if not len(outcomes.score):
        raise ValueError(
            f"{source.results_dir} has no {class_name} that counts at difficulty "
            f"{settings.difficulty} by {settings.metric} to fit a calibrator on: give results "
            "that find some"
        )
    targets = _targets(outcomes, settings.target)
    return {name: fit_calibrator(name, outcomes.score, targets) for name in names}


def _measure(
    measured: _Measured, code: int, fitted: dict[CalibratorName, Calibrator]
) -> CalibrationEntry:
    settings = measured.settings
    task = measured.task(code)
    outcomes = find_outcomes(task, settings.min_score)
    any_overlap = find_outcomes(measured.task(code, any_overlap=True), settings.min_score)

    def calibration(calibrator: Calibrator | None) -> ScoreCalibration:
        """Compute the errors of the raw scores, or of a calibrator's scores."""
        scores = outcomes.score if calibrator is None else calibrator(outcomes.score)
        loose = any_overlap.score if calibrator is None else calibrator(any_overlap.score)
        is_true = _targets(outcomes, "precision")
        return ScoreCalibration(
            precision=find_reliability(scores, is_true, settings.num_bins),
            overlap=find_reliability(scores, outcomes.overlap, settings.num_bins),
            any_overlap=find_reliability(loose, any_overlap.overlap, settings.num_bins),
        )

    metric = METRICS.index(settings.metric)
    minimum = float(settings.overlaps.as_array()[code, metric])
    return CalibrationEntry(
        class_name=CLASSES[code],
        n_gt=task.n_gt,
        n_true=int(outcomes.is_true.sum()),
        n_false=int((~outcomes.is_true).sum()),
        lrp=optimal_lrp(count_by_frame(task), task.n_gt, minimum),
        uncalibrated=calibration(None),
        calibrated={name: calibration(each) for name, each in fitted.items()},
        calibrators=fitted,
    )

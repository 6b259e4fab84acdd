"""Report of the calibration evaluation, as JSON and as a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sightline.evaluation.calibration_errors import OptimalLrp
from sightline.evaluation.calibrators import Calibrator, CalibratorName
from sightline.evaluation.kitti_object_rules import ClassName, Difficulty, Metric
from sightline.evaluation.object_tables import add_notes
from sightline.structures.score_curves import Reliability

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ScoreCalibration:
    """Calibration of one set of scores; errors are None if nothing counts."""

    precision: Reliability
    """Reliability against the share of true detections: its error is D-ECE."""
    overlap: Reliability
    """Reliability against precision times mean overlap: its error is LaECE."""
    any_overlap: Reliability
    """Reliability where any overlap makes a detection true: LaECE_0 of Kuzucu et al. 2024, "On
    calibration of object detectors", eq. 7."""

    def to_json(self) -> dict[str, Any]:
        """Convert errors, and the reliability behind the first, to JSON types."""
        bins = zip(
            self.precision.counts.tolist(),
            self.precision.mean_score.tolist(),
            self.precision.mean_target.tolist(),
            strict=True,
        )
        return {
            "D_ECE": self.precision.error,
            "LaECE": self.overlap.error,
            "LaECE_0": self.any_overlap.error,
            "bins": [
                {"count": count, "score": score, "precision": share} if count else {"count": 0}
                for count, score, share in bins
            ],
        }


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CalibrationEntry:
    """Calibration of one class."""

    class_name: ClassName
    n_gt: int
    """Labelled objects that count."""
    n_true: int
    """True detections."""
    n_false: int
    lrp: OptimalLrp | None
    """oLRP of the raw scores; order-preserving calibrators do not change it. None without
    objects."""
    uncalibrated: ScoreCalibration
    calibrated: Mapping[CalibratorName, ScoreCalibration]
    calibrators: Mapping[CalibratorName, Calibrator]

    @property
    def calibrations(self) -> dict[str, ScoreCalibration]:
        """Calibrations by name, raw scores first."""
        calibrated: dict[str, ScoreCalibration] = dict(self.calibrated.items())
        return {"as they are": self.uncalibrated, **calibrated}

    def to_json(self) -> dict[str, Any]:
        """Convert the entry to the report file's content."""
        lrp = self.lrp
        return {
            "class": self.class_name,
            "n_gt": self.n_gt,
            "n_true": self.n_true,
            "n_false": self.n_false,
            "oLRP": lrp
            and {
                "error": lrp.error,
                "localization": lrp.localization,
                "false_positives": lrp.false_positives,
                "false_negatives": lrp.false_negatives,
                "threshold": lrp.threshold,
            },
            "as_they_are": self.uncalibrated.to_json(),
            "calibrated": {
                name: {**each.to_json(), "calibrator": self.calibrators[name].to_json()}
                for name, each in self.calibrated.items()
            },
        }


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CalibrationReport:
    """Calibration of one set of result files; classes without results are absent."""

    frames: int
    metric: Metric
    difficulty: Difficulty
    min_score: float
    target: str
    """Target of the calibrators."""
    entries: tuple[CalibrationEntry, ...]
    num_results: int = 0
    """Number of all results, of any class and metric."""
    remarks: tuple[str, ...] = ()
    """Remarks on omitted files and objects."""

    @property
    def emptiness(self) -> str:
        """Why a report without entries has none."""
        if self.num_results == 0:
            return "nothing was found in any frame, so there is nothing to calibrate"
        return (
            f"none of {self.num_results:,} results is of a class and has values that {self.metric} "
            "measures, so there is nothing to calibrate"
        )

    def to_json(self) -> dict[str, Any]:
        """Convert the report to its file's content."""
        return {
            "frames": self.frames,
            "metric": self.metric,
            "difficulty": self.difficulty,
            "min_score": self.min_score,
            "target": self.target,
            **({"notes": list(self.remarks)} if self.remarks else {}),
            "entries": [entry.to_json() for entry in self.entries],
        }

    def table(self) -> "Table":
        """Make a table with a row per class and calibrator; all in percent; 80 wide."""
        from rich.box import SIMPLE_HEAD
        from rich.table import Table

        title = f"calibration by {self.metric}, {self.difficulty}, {self.frames:,} frames, percent"
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        add_notes(table, (*(() if self.entries else (self.emptiness,)), *self.remarks))
        for name in ("class", "scores"):
            table.add_column(name, no_wrap=True)
        for name in ("D-ECE", "LaECE", "LaECE0", "oLRP", "Loc", "FP", "FN", "boxes"):
            table.add_column(name, justify="right", no_wrap=True)
        for entry in self.entries:
            last = len(entry.calibrated)
            for row, (name, each) in enumerate(entry.calibrations.items()):
                errors = (each.precision.error, each.overlap.error, each.any_overlap.error)
                table.add_row(
                    entry.class_name if row == 0 else "",
                    name,
                    *map(_percentage, errors),
                    *(_counts(entry) if row == 0 else [""] * 5),
                    end_section=row == last,
                )
        return table


def _counts(entry: CalibrationEntry) -> list[str]:
    lrp = entry.lrp
    errors = (
        (lrp.error, lrp.localization, lrp.false_positives, lrp.false_negatives)
        if lrp
        else (None,) * 4
    )
    return [*map(_percentage, errors), f"{entry.n_true + entry.n_false:,}"]


def _percentage(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"

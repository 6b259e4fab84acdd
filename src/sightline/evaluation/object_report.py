"""What the evaluations of objects and of proposals report: as JSON and as tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64, Int64

from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName, Difficulty, Metric

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, kw_only=True, slots=True)
class BootstrapAP:
    """Average precision over all scores, for samples too small to fill KITTI's 41 slots."""

    ap: float
    """Area under the monotone precision-recall curve, percent."""
    low: float
    """2.5 % quantile over resampled frames, percent."""
    high: float
    """97.5 % quantile over resampled frames, percent."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjectEntry:
    """Scores of one class by one metric at one difficulty. Percentages, unless said otherwise."""

    class_name: ClassName
    metric: Metric
    difficulty: Difficulty
    n_gt: int
    """Labelled objects that count."""
    max_recall: float
    """Largest share of them found at a threshold, 0 to 1; 0 where there are none."""
    ap_r11: float
    """Mean precision of the slots 0, 4, ..., 40."""
    ap_r40: float
    """Mean precision of the slots 1 to 40."""
    aos_r11: float | None
    """The same of orientation similarity; None but for bbox, and where a detection has no alpha."""
    aos_r40: float | None
    precision: Float64[np.ndarray, "41"]
    """By slot, 0 to 1, the best of this and later slots; slots never reached are 0."""
    thresholds: Float64[np.ndarray, " num_thresholds"]
    """Scores, descending: the slots that were reached."""
    tp: Int64[np.ndarray, " num_thresholds"]
    fp: Int64[np.ndarray, " num_thresholds"]
    fn: Int64[np.ndarray, " num_thresholds"]
    flipped_share: float | None
    """Of the true positives at the lowest threshold, those whose heading is more than 90 degrees
    off, 0 to 1; None where there are none, or a detection has no alpha. Not one of KITTI's."""
    all_points: BootstrapAP | None = None
    """None where it was not asked for, or nothing counts."""

    def to_json(self, *, with_all_points: bool) -> dict[str, Any]:
        """The entry as the report's file has it."""
        entry: dict[str, Any] = {
            "class": self.class_name,
            "metric": self.metric,
            "difficulty": self.difficulty,
            "n_gt": self.n_gt,
            "max_recall": self.max_recall,
            "AP_R11": self.ap_r11,
            "AP_R40": self.ap_r40,
            "AOS_R11": self.aos_r11,
            "AOS_R40": self.aos_r40,
            "precision": self.precision.tolist(),
            "thresholds": self.thresholds.tolist(),
            "tp": self.tp.tolist(),
            "fp": self.fp.tolist(),
            "fn": self.fn.tolist(),
            "flipped_share": self.flipped_share,
        }
        if with_all_points:
            points = self.all_points
            entry["AP_all_points"] = points.ap if points else None
            entry["AP_all_points_95"] = [points.low, points.high] if points else None
        return entry


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectReport:
    """KITTI's object evaluation of one submission.

    Classes and metrics that the submission holds nothing for are absent.
    """

    frames: int
    entries: tuple[ObjectEntry, ...]
    """By class, then metric, then difficulty."""
    num_resamples: int = 0
    """Bootstrap resamples behind `all_points`; 0 where it was not asked for."""

    def to_json(self) -> dict[str, Any]:
        """The report as its file has it."""
        return {
            "frames": self.frames,
            "entries": [
                entry.to_json(with_all_points=self.num_resamples > 0) for entry in self.entries
            ],
        }

    def table(self) -> "Table":
        """The figures of each class and metric, a column for each difficulty; 80 wide."""
        table = _table(f"KITTI objects, {self.frames:,} frames, AP and AOS in percent")
        for start in range(0, len(self.entries), len(DIFFICULTIES)):
            levels = self.entries[start : start + len(DIFFICULTIES)]
            rows: list[tuple[str, list[str]]] = [
                ("AP R40", [_percentage(level.ap_r40) for level in levels]),
                ("AP R11", [_percentage(level.ap_r11) for level in levels]),
            ]
            if levels[0].aos_r40 is not None:
                rows.append(("AOS R40", [_percentage(level.aos_r40) for level in levels]))
                rows.append(("AOS R11", [_percentage(level.aos_r11) for level in levels]))
            if self.num_resamples:
                points = [level.all_points for level in levels]
                rows.append(("AP all points", [_percentage(p.ap if p else None) for p in points]))
                rows.append(("95 % interval", [_interval(p) for p in points]))
            rows.append(("max recall", [_percentage(100 * level.max_recall) for level in levels]))
            if any(level.flipped_share is not None for level in levels):
                shares = [level.flipped_share for level in levels]
                rows.append(
                    (
                        "heading flipped",
                        [_percentage(None if s is None else 100 * s) for s in shares],
                    )
                )
            rows.append(("objects", [f"{level.n_gt:,}" for level in levels]))
            _add_section(table, (levels[0].class_name, levels[0].metric), rows)
        return table


@dataclass(frozen=True, kw_only=True, slots=True)
class ProposalEntry:
    """Recall of the proposals of one class at one overlap."""

    class_name: ClassName
    metric: Metric
    difficulty: Difficulty | None
    """None: all objects of the class, whatever their difficulty."""
    iou: float
    """An object is found if some proposal overlaps it by this much, or more."""
    n_gt: int
    n_found: int
    recall: float
    """Found over all objects, percent; 0 where there are none."""
    recall_frames_with_objects: float
    """Mean over the frames that have objects of each one's recall, percent."""
    recall_all_frames: float
    """Mean over all frames, those without objects counted as 0, percent."""

    def to_json(self) -> dict[str, Any]:
        """The entry as the report's file has it."""
        return {
            "class": self.class_name,
            "metric": self.metric,
            "difficulty": self.difficulty or "all",
            "iou": self.iou,
            "n_gt": self.n_gt,
            "n_found": self.n_found,
            "recall": self.recall,
            "recall_frames_with_objects": self.recall_frames_with_objects,
            "recall_all_frames": self.recall_all_frames,
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class ProposalReport:
    """Recall of proposals over some frames."""

    frames: int
    entries: tuple[ProposalEntry, ...]
    """By class, metric, overlap, then difficulty."""

    def to_json(self) -> dict[str, Any]:
        """The report as its file has it."""
        return {"frames": self.frames, "entries": [entry.to_json() for entry in self.entries]}

    def table(self) -> "Table":
        """The recalls of each class, metric and overlap, a column for each difficulty; 80 wide."""
        num_levels = len(DIFFICULTIES) + 1
        table = _table(f"recall of proposals, {self.frames:,} frames, percent", "IoU", "all")
        for start in range(0, len(self.entries), num_levels):
            levels = self.entries[start : start + num_levels]
            rows = [
                ("recall", [_percentage(level.recall) for level in levels]),
                (
                    "by frame",
                    [_percentage(level.recall_frames_with_objects) for level in levels],
                ),
                ("by frame, empty 0", [_percentage(level.recall_all_frames) for level in levels]),
                ("objects", [f"{level.n_gt:,}" for level in levels]),
            ]
            names = (levels[0].class_name, levels[0].metric, f"{levels[0].iou:g}")
            _add_section(table, names, rows)
        return table


def _table(title: str, extra_name: str | None = None, extra_level: str | None = None) -> "Table":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("class", "metric", extra_name, ""):
        if name is not None:
            table.add_column(name, no_wrap=True)
    for level in (*DIFFICULTIES, extra_level):
        if level is not None:
            table.add_column(level, justify="right", no_wrap=True)
    return table


def _add_section(
    table: "Table", names: Sequence[str], rows: Sequence[tuple[str, list[str]]]
) -> None:
    """Adds the figures of a class and metric, whose names stand on the first line only."""
    for number, (figure, cells) in enumerate(rows):
        shown = names if number == 0 else [""] * len(names)
        table.add_row(*shown, figure, *cells, end_section=number == len(rows) - 1)


def _percentage(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _interval(points: BootstrapAP | None) -> str:
    return "-" if points is None else f"{points.low:.1f}-{points.high:.1f}"

"""Report of the object evaluation, as JSON, as tables and as rows for spreadsheets."""

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float64, Int64

from sightline.evaluation.bootstrap import MIN_FRAMES, note_without_interval
from sightline.evaluation.centre_scores import (
    CENTRE_COLUMNS,
    CENTRE_INTERVAL,
    CentreScores,
    centre_cells,
    centre_rows,
)
from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName, Difficulty, Metric
from sightline.evaluation.object_tables import (
    add_notes,
    add_section,
    percentage,
    score_table,
    slots_note,
)
from sightline.evaluation.object_tally import ObjectTally
from sightline.files.atomic import atomic_write_text
from sightline.files.problem import markdown_text
from sightline.structures.score_curves import PrecisionRecall

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table

_ROW_NAMES: Final = ("class", "metric", "difficulty", "distance")
_ROW_SCORES: Final = ("AP_R40", "AP_R11", "AOS_R40", "AOS_R11", "max_recall", "flipped_share")
_ALL_POINTS: Final = "AP_all_points"
_INTERVAL: Final = ("AP_all_points_low", "AP_all_points_high")

Cell = str | int | float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class BootstrapAP:
    """Average precision over all scores, for samples too small to fill KITTI's 41 slots."""

    ap: float
    """Area under the monotone precision-recall curve, percent."""
    low: float | None = None
    """2.5 % quantile over resampled frames, percent; None of fewer than `MIN_FRAMES` frames, or if
    no resample has such objects."""
    high: float | None = None
    """97.5 % quantile over resampled frames, percent; None in the same case."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjectEntry:
    """Scores of one class, metric and difficulty. Percentages, unless stated otherwise."""

    class_name: ClassName
    metric: Metric
    difficulty: Difficulty
    n_gt: int
    """Labelled objects that count."""
    max_recall: float
    """Largest share of objects found at a threshold, 0 to 1; 0 without objects."""
    ap_r11: float
    """Mean precision of the slots 0, 4, ..., 40."""
    ap_r40: float
    """Mean precision of the slots 1 to 40."""
    aos_r11: float | None
    """Mean orientation similarity of the slots 0, 4, ..., 40; None except for bbox, or if a
    detection has no alpha."""
    aos_r40: float | None
    precision: Float64[np.ndarray, "41"]
    """Precision by slot, 0 to 1, the best of this and later slots; unreached slots are 0."""
    thresholds: Float64[np.ndarray, " num_thresholds"]
    """Score thresholds of the reached slots, descending."""
    tp: Int64[np.ndarray, " num_thresholds"]
    fp: Int64[np.ndarray, " num_thresholds"]
    fn: Int64[np.ndarray, " num_thresholds"]
    flipped_share: float | None
    """Share of true positives at the lowest threshold with a heading error above 90 degrees, 0 to
    1; None if there are none, or a detection has no alpha. Not one of KITTI's scores."""
    all_points: BootstrapAP | None = None
    """AP over all scores; None if nothing counts."""
    centres: CentreScores | None = None
    """nuScenes' scores by the distance of centres; None except for 3d, or if nothing counts."""

    def curve(self) -> PrecisionRecall:
        """Precision-recall curve for drawing."""
        positives = self.tp + self.fp
        precision = np.zeros(len(self.tp))
        np.divide(self.tp, positives, out=precision, where=positives > 0)
        return PrecisionRecall(
            recall=self.tp / max(self.n_gt, 1),
            precision=precision,
            slots=self.precision,
            ap_r40=self.ap_r40,
            ap_r11=self.ap_r11,
            num_objects=self.n_gt,
        )

    def to_json(self) -> dict[str, Any]:
        """Convert the entry to the report file's content."""
        points = self.all_points
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
        entry["AP_all_points"] = points.ap if points else None
        has_interval = points is not None and points.low is not None
        entry["AP_all_points_95"] = [points.low, points.high] if points and has_interval else None
        entry["centre_distance"] = None if self.centres is None else self.centres.to_json()
        return entry


@dataclass(frozen=True, kw_only=True, slots=True)
class DistanceBand:
    """Scores of one band of distances."""

    from_m: float
    """Minimum horizontal distance from the camera."""
    to_m: float
    """Maximum distance, exclusive; infinity in the last band."""
    entries: tuple[ObjectEntry, ...]
    """Entries in the order of the report's."""

    @property
    def title(self) -> str:
        """Limits of the band as text."""
        if math.isinf(self.to_m):
            return f"{self.from_m:g} m on"
        return f"{self.from_m:g}-{self.to_m:g} m"


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectReport:
    """KITTI's object evaluation of one submission.

    Classes and metrics without detections in the submission are absent.
    """

    frames: int
    entries: tuple[ObjectEntry, ...]
    """Entries by class, then metric, then difficulty."""
    num_resamples: int = 0
    """Number of bootstrap resamples for the intervals of `all_points` and `centres`, which need
    `MIN_FRAMES` frames; 0: there are none."""
    frames_without_results: int = 0
    """Number of frames without a result file, which count as empty."""
    bands: tuple[DistanceBand, ...] = ()
    """Distance bands from the nearest; empty if not requested."""
    remarks: tuple[str, ...] = ()
    """Remarks on files and objects that are not scored."""
    tally: ObjectTally | None = field(default=None, repr=False, compare=False)
    """Counts that the remarks are made from; None: not from files."""

    def to_json(self) -> dict[str, Any]:
        """Convert the report to its file's content."""
        report: dict[str, Any] = {
            "frames": self.frames,
            "frames_without_results": self.frames_without_results,
            "notes": self.notes(),
            "entries": [entry.to_json() for entry in self.entries],
        }
        if self.bands:
            report["by_distance"] = [
                {
                    "from_m": band.from_m,
                    "to_m": None if math.isinf(band.to_m) else band.to_m,
                    "entries": [entry.to_json() for entry in band.entries],
                }
                for band in self.bands
            ]
        return report

    def table(self) -> "Table | Group":
        """Make a table of the scores of each class and metric, a column per difficulty; 80 wide.

        A second table contains the distance bands, if requested.
        """
        if not self.bands:
            return self._scores_table()
        from rich.console import Group

        return Group(self._scores_table(), self._distance_table())

    def _distance_table(self) -> "Table":
        table = score_table("By distance from the camera: AP in percent, and objects", "distance")
        for start in range(0, len(self.entries), len(DIFFICULTIES)):
            for band in self.bands:
                levels = band.entries[start : start + len(DIFFICULTIES)]
                points = [level.all_points for level in levels]
                rows = [
                    ("AP R40", [percentage(level.ap_r40) for level in levels]),
                    ("AP all points", [percentage(p.ap if p else None) for p in points]),
                ]
                centres = [level.centres for level in levels]
                if any(centres):
                    rows.append(centre_rows(centres, with_interval=False)[0])
                rows.append(("objects", [f"{level.n_gt:,}" for level in levels]))
                first = levels[0]
                add_section(table, (first.class_name, first.metric, band.title), rows)
        add_notes(table, _slots_notes([entry for band in self.bands for entry in band.entries]))
        return table

    def _scores_table(self) -> "Table":
        table = score_table(f"KITTI objects, {self.frames:,} frames, AP and AOS in percent")
        add_notes(table, self.notes())
        for start in range(0, len(self.entries), len(DIFFICULTIES)):
            levels = self.entries[start : start + len(DIFFICULTIES)]
            rows: list[tuple[str, list[str]]] = [
                ("AP R40", [percentage(level.ap_r40) for level in levels]),
                ("AP R11", [percentage(level.ap_r11) for level in levels]),
            ]
            if levels[0].aos_r40 is not None:
                rows.append(("AOS R40", [percentage(level.aos_r40) for level in levels]))
                rows.append(("AOS R11", [percentage(level.aos_r11) for level in levels]))
            points = [level.all_points for level in levels]
            rows.append(("AP all points", [percentage(p.ap if p else None) for p in points]))
            if self.num_resamples and self.frames >= MIN_FRAMES:
                rows.append(("95 % interval", [_interval(p) for p in points]))
            rows.append(("max recall", [percentage(100 * level.max_recall) for level in levels]))
            if any(level.flipped_share is not None for level in levels):
                shares = [level.flipped_share for level in levels]
                rows.append(
                    (
                        "heading flipped",
                        [percentage(None if s is None else 100 * s) for s in shares],
                    )
                )
            rows.append(("objects", [f"{level.n_gt:,}" for level in levels]))
            add_section(table, (levels[0].class_name, levels[0].metric), rows)
            centres = [level.centres for level in levels]
            if any(centres):
                with_interval = self.num_resamples > 0 and self.frames >= MIN_FRAMES
                add_section(
                    table,
                    (levels[0].class_name, "centre"),
                    centre_rows(centres, with_interval=with_interval),
                )
        return table

    def notes(self) -> list[str]:
        """List notes on the interpretation of all scores, a sentence or two each."""
        notes = []
        if not self.entries:
            notes.append("No result is of a scored class: nothing that is labelled was found.")
        if self.frames_without_results:
            count = self.frames_without_results
            subject = "1 frame had" if count == 1 else f"{count:,} frames had"
            notes.append(f"{subject} no result file and counted as empty.")
        if self.num_resamples and self.frames < MIN_FRAMES:
            notes.append(note_without_interval(self.frames, "frames"))
        return [*notes, *self.remarks, *_slots_notes(self.entries)]


def _slots_notes(entries: Sequence[ObjectEntry]) -> list[str]:
    return slots_note([(each.class_name, each.difficulty, each.n_gt) for each in entries])


def _interval(points: BootstrapAP | None) -> str:
    if points is None or points.low is None or points.high is None:
        return "-"
    return f"{points.low:.1f}-{points.high:.1f}"


def write_object_rows(
    report: ObjectReport, *, csv: Path | None = None, markdown: Path | None = None
) -> None:
    """Write a report's scores, a row for each class, metric, difficulty and distance band.

    Args:
        report: The report.
        csv: Comma-separated file of unrounded scores; None: not written.
        markdown: File with a table of scores to two places, and the report's notes below it; None:
            not written.
    """
    columns, rows = object_rows(report)
    if csv is not None:
        atomic_write_text(csv, _as_csv(columns, rows))
    if markdown is not None:
        notes = "".join(f"\n{markdown_text(note)}\n" for note in report.notes())
        atomic_write_text(markdown, _as_markdown(columns, rows) + notes)


def object_rows(report: ObjectReport) -> tuple[tuple[str, ...], list[list[Cell]]]:
    """List the names of the columns, and the rows; a missing score is None.

    AP, AOS and their interval are percentages, recall and shares are from 0 to 1, as in JSON.
    """
    interval, centre_interval = (_INTERVAL, CENTRE_INTERVAL) if report.num_resamples else ((), ())
    names = (*_ROW_NAMES, "objects", *_ROW_SCORES, _ALL_POINTS, *interval)
    names = (*names, *CENTRE_COLUMNS, *centre_interval)
    parts = [("all", report.entries), *((band.title, band.entries) for band in report.bands)]
    return names, [
        list(_row(entry, distance, with_interval=report.num_resamples > 0))
        for distance, entries in parts
        for entry in entries
    ]


def _row(entry: ObjectEntry, distance: str, *, with_interval: bool) -> Iterator[Cell]:
    content = entry.to_json()
    yield from (entry.class_name, entry.metric, entry.difficulty, distance, entry.n_gt)
    yield from (content[name] for name in (*_ROW_SCORES, _ALL_POINTS))
    if with_interval:
        points = entry.all_points
        yield from (None, None) if points is None else (points.low, points.high)
    yield from centre_cells(entry.centres, with_interval=with_interval)


def _as_csv(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return file.getvalue()


def _as_markdown(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    lines = [columns, ["---"] * len(_ROW_NAMES) + ["---:"] * (len(columns) - len(_ROW_NAMES))]
    lines += [[_format_cell(cell) for cell in row] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _format_cell(cell: Cell) -> str:
    if cell is None:
        return "-"
    return f"{cell:.2f}" if isinstance(cell, float) else str(cell)

"""Comparison of two submissions on the same frames: AP differences with paired intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int64

from sightline.evaluation.bootstrap import (
    MIN_FRAMES,
    PERCENTILES,
    draw_frames,
    note_without_interval,
)
from sightline.evaluation.centre_distance import CentreCurves, CentreTask, select_centres
from sightline.evaluation.kitti_object_matching import MatchingTask, index_pairs, select
from sightline.evaluation.kitti_object_pairs import MatchingData
from sightline.evaluation.kitti_object_resampling import ResampledCurve
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DIFFICULTIES,
    METRICS,
    ClassName,
    Difficulty,
    Metric,
    MinimumOverlaps,
)
from sightline.evaluation.object_tables import add_notes, add_section, score_table, slots_note

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedDifference:
    """One average precision of two submissions, percent."""

    first: float
    second: float
    difference: float
    """First minus second."""
    low: float | None
    """2.5 % quantile of the difference over resampled frames, the same frames for both; None of
    fewer than `MIN_FRAMES` frames, or if no resample has such an object."""
    high: float | None
    """97.5 % quantile; None in the same case."""

    def to_json(self) -> dict[str, Any]:
        """Convert the difference to the report file's content."""
        return {
            "first": self.first,
            "second": self.second,
            "difference": self.difference,
            "difference_95": None if self.low is None else [self.low, self.high],
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class ComparedEntry:
    """Comparison of two submissions by one class, metric and difficulty."""

    class_name: ClassName
    metric: Metric
    difficulty: Difficulty
    n_gt: int
    """Labelled objects that count."""
    r40: PairedDifference | None
    """AP at KITTI's 40 recall positions; None if no object counts."""
    all_points: PairedDifference | None
    """AP over all points of the curve; None if no object counts."""
    centre: PairedDifference | None = None
    """nuScenes' AP by the distance of centres, mean of 0.5, 1, 2 and 4 m; None except for 3d, or if
    no object counts."""
    centre_2m: PairedDifference | None = None
    """nuScenes' AP at 2 m alone; None in the same cases."""

    def named_pairs(self) -> tuple[tuple[str, PairedDifference | None], ...]:
        """All differences by their name in the file."""
        return (
            ("AP_R40", self.r40),
            ("AP_all_points", self.all_points),
            ("AP_centre", self.centre),
            ("AP_centre_2m", self.centre_2m),
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectComparison:
    """Comparison of two submissions by class; classes without results in both are absent."""

    first: str
    """Name of the first submission: its folder."""
    second: str
    frames: int
    num_resamples: int
    entries: tuple[ComparedEntry, ...]
    """Entries by class, then metric, then difficulty."""
    remarks: tuple[str, ...] = ()
    """Notes: objects and files left out, and limits of the scores."""

    @property
    def has_intervals(self) -> bool:
        """Whether there are enough frames for 95 % intervals: `MIN_FRAMES` or more."""
        return self.frames >= MIN_FRAMES

    def to_json(self) -> dict[str, Any]:
        """Convert the comparison to its file's content."""
        return {
            "first": self.first,
            "second": self.second,
            "frames": self.frames,
            "resamples": self.num_resamples,
            "notes": self.notes(),
            "entries": [
                {
                    "class": entry.class_name,
                    "metric": entry.metric,
                    "difficulty": entry.difficulty,
                    "n_gt": entry.n_gt,
                    **{
                        name: None if pair is None else pair.to_json()
                        for name, pair in entry.named_pairs()
                    },
                }
                for entry in self.entries
            ],
        }

    def table(self) -> "Table":
        """Make a table of both submissions: R40, all points, their differences and intervals."""
        table = score_table(
            f"{self.first} less {self.second}, {self.frames:,} frames, AP in percent"
        )
        add_notes(table, self.notes())
        for start in range(0, len(self.entries), len(DIFFICULTIES)):
            levels = self.entries[start : start + len(DIFFICULTIES)]
            rows = self._rows("R40", [level.r40 for level in levels])
            rows += self._rows("all points", [level.all_points for level in levels])
            rows.append(("objects", [f"{level.n_gt:,}" for level in levels]))
            add_section(table, (levels[0].class_name, levels[0].metric), rows)
            if any(level.centre for level in levels):
                rows = self._rows("0.5-4 m", [level.centre for level in levels])
                rows += self._rows("2 m", [level.centre_2m for level in levels])
                add_section(table, (levels[0].class_name, "centre"), rows)
        return table

    def _rows(
        self, name: str, pairs: Sequence[PairedDifference | None]
    ) -> list[tuple[str, list[str]]]:
        rows = [
            (f"{name}, both", [_both(pair) for pair in pairs]),
            (f"{name}, difference", [_difference(pair) for pair in pairs]),
        ]
        if self.has_intervals:
            rows.append(("95 % interval", [_interval(pair) for pair in pairs]))
        return rows

    def notes(self) -> list[str]:
        """List notes on the interpretation of the scores."""
        paired = (
            f"The interval is of the difference, over {self.num_resamples:,} resamples of the "
            "frames, the same for both: if it contains 0, these frames show no difference."
            if self.has_intervals
            else note_without_interval(self.frames, "frames")
        )
        few = slots_note([(e.class_name, e.difficulty, e.n_gt) for e in self.entries])
        return [paired, *self.remarks, *few]


def compare_submissions(
    first: MatchingData,
    second: MatchingData,
    overlaps: MinimumOverlaps,
    *,
    num_resamples: int,
    seed: int,
) -> tuple[ComparedEntry, ...]:
    """Compare all classes, metrics and difficulties with results in one of two submissions.

    Every resample draws frames once and scores both submissions on them (a paired bootstrap), so
    that variation common to both does not widen the interval.

    Args:
        first: All frames of one submission, pairs found with the same overlaps.
        second: The same frames of the other.
        overlaps: Overlaps that a match must exceed.
        num_resamples: Number of resamples.
        seed: Seed of the draws.
    """
    indices = index_pairs(first), index_pairs(second)
    minima = overlaps.as_array()
    entries = []
    for code, metric in np.argwhere(first.is_evaluated | second.is_evaluated).tolist():
        for level, difficulty in enumerate(DIFFICULTIES):
            tasks = [
                select(
                    data,
                    index,
                    code=code,
                    metric=metric,
                    difficulty=level,
                    min_overlap=float(minima[code, metric]),
                )
                for data, index in zip((first, second), indices, strict=True)
            ]
            near = [
                select_centres(data, index, code=code, difficulty=level)
                for data, index in zip((first, second), indices, strict=True)
                if METRICS[metric] == "3d"
            ]
            r40, all_points, *centres = _paired(tasks, near, num_resamples=num_resamples, seed=seed)
            centre, centre_2m = centres or (None, None)
            entries.append(
                ComparedEntry(
                    class_name=CLASSES[code],
                    metric=METRICS[metric],
                    difficulty=difficulty,
                    n_gt=tasks[0].n_gt,
                    r40=r40,
                    all_points=all_points,
                    centre=centre,
                    centre_2m=centre_2m,
                )
            )
    return tuple(entries)


def _paired(
    tasks: Sequence[MatchingTask], near: Sequence[CentreTask], *, num_resamples: int, seed: int
) -> list[PairedDifference | None]:
    """Compute the differences of AP R40 and of AP over all points; with `near` of the centres' two.

    Args:
        tasks: Matching input of both submissions.
        near: Input of their matching by centres; empty: without.
        num_resamples: Number of resamples.
        seed: Seed of the draws.
    """
    num_scores = 4 if near else 2
    if tasks[0].n_gt == 0:
        return [None] * num_scores
    curves = [ResampledCurve.of(task) for task in tasks]
    centres = [CentreCurves.of(task) for task in near]

    def scores(weights: Int64[np.ndarray, " num_frames"]) -> list[list[float]]:
        rows = [[each.ap_r40(weights), each.ap_all_points(weights)] for each in curves]
        more = [each.ap_and_2m(weights) for each in centres] or [[], []]
        return [[*row, *added] for row, added in zip(rows, more, strict=True)]

    once = np.array(scores(np.ones(curves[0].num_frames, dtype=np.int64)))
    drawn = draw_frames(tasks[0].valid_per_frame, num_resamples, seed)
    resampled = np.array([scores(weights) for weights in drawn]).reshape(-1, 2, num_scores)
    low, high = [None] * num_scores, [None] * num_scores
    if len(resampled):
        differences = resampled[:, 0] - resampled[:, 1]
        low, high = np.percentile(differences, PERCENTILES, axis=0).tolist()
    return [
        PairedDifference(
            first=float(once[0, score]),
            second=float(once[1, score]),
            difference=float(once[0, score] - once[1, score]),
            low=low[score],
            high=high[score],
        )
        for score in range(num_scores)
    ]


def _both(pair: PairedDifference | None) -> str:
    return "-" if pair is None else f"{pair.first:.1f} {pair.second:.1f}"


def _difference(pair: PairedDifference | None) -> str:
    return "-" if pair is None else f"{pair.difference:+.2f}"


def _interval(pair: PairedDifference | None) -> str:
    if pair is None or pair.low is None or pair.high is None:
        return "-"
    return f"{pair.low:+.1f} {pair.high:+.1f}"

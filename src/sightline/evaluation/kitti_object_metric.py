"""KITTI's object evaluation as a torchmetrics metric, combined over processes."""

from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import product
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torchmetrics import Metric

from sightline.data.formats.kitti_labels import KittiObjects, parse_objects
from sightline.evaluation.kitti_object_pairs import MatchingData, find_pairs
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DIFFICULTIES,
    METRICS,
    STRICT,
    MinimumOverlaps,
)
from sightline.evaluation.kitti_object_scores import score_objects
from sightline.evaluation.object_report import ObjectReport
from sightline.geometry.wrong_types import named_arguments

ALL_POINTS: Final = "_all_points"
"""Suffix of the names of scores over all points of the curve."""
R11: Final = "_R11"
"""Suffix of the names of scores over 11 recall positions, as published up to 2019."""


class KittiObjectMetric(Metric):
    """Metric with the scores of `evaluate_objects`, updated by batches of frames.

    Every process gets its own frames; their order does not change the scores. Detections and
    labels come in KITTI's conventions, because the rules need all of their fields.
    """

    is_differentiable = False
    higher_is_better = True
    full_state_update = False

    is_evaluated: Tensor
    has_headings: Tensor

    def __init__(self, overlaps: MinimumOverlaps = STRICT) -> None:
        """Start without frames.

        Args:
            overlaps: Overlaps that a match must exceed, by class and metric.
        """
        super().__init__()
        self._overlaps = overlaps
        self.last_report: ObjectReport | None = None
        self._num_counted: dict[tuple[str, str], int] = {}
        frame = find_pairs(
            [parse_objects(b"", "no detections", with_scores=True)],
            [parse_objects(b"", "no labels", with_scores=False)],
            overlaps.as_array(),
        )
        self.add_state("is_evaluated", torch.zeros(3, 3, dtype=torch.int8), dist_reduce_fx="max")
        self.add_state("has_headings", torch.ones(1, dtype=torch.int8), dist_reduce_fx="min")
        self._no_rows = {
            field.name: getattr(frame, field.name)[:0]
            for field in fields(MatchingData)
            if field.name not in ("is_evaluated", "has_headings")
        }
        for name in self._no_rows:
            self.add_state(name, default=[], dist_reduce_fx="cat")

    @named_arguments
    def update(self, detections: Sequence[KittiObjects], labels: Sequence[KittiObjects]) -> None:
        """Add frames.

        Args:
            detections: One record per frame, with scores.
            labels: One record per frame, in the same order.

        Raises:
            ValueError: If the numbers of frames differ or are 0, or detections have no scores.
        """
        data = find_pairs(detections, labels, self._overlaps.as_array())
        is_evaluated = torch.from_numpy(data.is_evaluated).to(self.is_evaluated)
        has_headings = torch.from_numpy(data.has_headings).to(self.has_headings)
        self.is_evaluated = torch.maximum(self.is_evaluated, is_evaluated)
        self.has_headings = torch.minimum(self.has_headings, has_headings)
        for name in self._no_rows:
            getattr(self, name).append(torch.from_numpy(getattr(data, name)).to(self.device))

    def compute(self) -> dict[str, Tensor]:
        """Compute AP in percent, e.g. `Car/3d/moderate`, also with `_R11` and `_all_points`.

        The first is over 40 recall positions, which few objects cannot fill; the others over 11 of
        them and over all points of the curve. Every class, metric and difficulty has all three, 0
        without detections: so a checkpoint callback that monitors one of them finds it even after
        the first epoch.
        """
        self.last_report = report = self._score()
        scores = {"/".join(names): 0.0 for names in product(CLASSES, METRICS, DIFFICULTIES)}
        scores |= {f"{name}{suffix}": 0.0 for name in scores for suffix in (R11, ALL_POINTS)}
        for entry in report.entries:
            name = "/".join((entry.class_name, entry.metric, entry.difficulty))
            scores[name], scores[f"{name}{R11}"] = entry.ap_r40, entry.ap_r11
            if entry.all_points is not None:
                scores[f"{name}{ALL_POINTS}"] = entry.all_points.ap
        return {name: torch.tensor(score, dtype=torch.float64) for name, score in scores.items()}

    def notes(self, monitored: str) -> tuple[str, ...]:
        """List notes on the interpretation of the last scores from `compute`.

        Args:
            monitored: Name of the score that selects checkpoints.
        """
        if self.last_report is None:
            return ()
        notes = tuple(self.last_report.notes())
        names = monitored.split("/")
        if self._num_counted.get((names[1], names[-1])) == 0:
            return (
                *notes,
                f"WARNING: no label counts for {monitored}: there is none, or none by occlusion (3 "
                "is unknown), truncation and height in the image. It stays 0 and selects nothing: "
                "the weights of the last validation are kept.",
            )
        return (*notes, f"Checkpoints are still selected by {monitored}, R40.") if notes else ()

    def report(self) -> ObjectReport:
        """Compute all scores over the frames of all processes; each process has to call this."""
        with self.sync_context():
            return self._score()

    def sync(
        self,
        dist_sync_fn: Callable[..., Any] | None = None,
        process_group: object | None = None,
        should_sync: bool = True,  # noqa: FBT001 - torchmetrics calls it so
        distributed_available: Callable[[], bool] | None = None,
    ) -> None:
        """Combine the frames of all processes; a process may have none.

        Args:
            dist_sync_fn: As for torchmetrics.
            process_group: As for torchmetrics.
            should_sync: As for torchmetrics.
            distributed_available: As for torchmetrics.
        """
        for name, no_rows in self._no_rows.items():
            # torchmetrics would send a column of another shape and type, and other processes fail
            if isinstance(getattr(self, name), list) and not getattr(self, name):
                getattr(self, name).append(torch.from_numpy(no_rows).to(self.device))
        super().sync(dist_sync_fn, process_group, should_sync, distributed_available)

    def _score(self) -> ObjectReport:
        columns = {}
        for name, no_rows in self._no_rows.items():
            state = getattr(self, name)
            parts = [state] if isinstance(state, Tensor) else state
            columns[name] = np.concatenate([no_rows, *(part.cpu().numpy() for part in parts)])
        data = MatchingData(
            **columns,
            is_evaluated=self.is_evaluated.bool().cpu().numpy(),
            has_headings=self.has_headings.bool().cpu().numpy(),
        )
        self._num_counted = {
            (name, difficulty): int(
                ((data.truth_class == code) & (data.truth_level <= level)).sum()
            )
            for code, name in enumerate(CLASSES)
            for level, difficulty in enumerate(DIFFICULTIES)
        }
        return score_objects(data, self._overlaps)

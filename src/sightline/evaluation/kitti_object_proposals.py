"""Recall of proposals: share of labelled objects found by a first stage, at given overlaps.

The rules of matching are not KITTI's: one proposal may find several objects, an overlap equal to
the limit is enough, and neighbouring classes are not used. Difficulties are KITTI's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int8, Int64

from sightline.data.formats.kitti_labels import KittiObjects
from sightline.evaluation.kitti_object import frame_names, read_frames
from sightline.evaluation.kitti_object_overlaps import ground_and_space_overlap, image_overlap
from sightline.evaluation.kitti_object_pairs import find_evaluated, stack_boxes
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DIFFICULTIES,
    METRICS,
    NEVER,
    ClassName,
    Difficulty,
    Metric,
    class_code,
    truth_levels,
)
from sightline.evaluation.object_tables import add_notes, add_section, percentage, score_table
from sightline.evaluation.object_tally import ObjectTally, tallied, unread_files
from sightline.files.shard_path import data_path
from sightline.geometry.wrong_types import named_arguments
from sightline.ops.compiled import compiled

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, kw_only=True, slots=True)
class ProposalEntry:
    """Recall of the proposals of one class at one overlap."""

    class_name: ClassName
    metric: Metric
    difficulty: Difficulty | None
    """Difficulty; None: all objects of the class."""
    iou: float
    """Minimum overlap of a found object with some proposal."""
    n_gt: int
    n_found: int
    recall: float
    """Share of found objects, percent; 0 if there are no objects."""
    recall_frames_with_objects: float
    """Mean of the recall per frame over the frames with objects, percent."""
    recall_all_frames: float
    """Mean over all frames, with 0 for frames without objects, percent."""

    def to_json(self) -> dict[str, Any]:
        """Convert the entry to the report file's content."""
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
    """Entries by class, metric, overlap, then difficulty."""
    remarks: tuple[str, ...] = ()
    """Remarks on omitted files and objects."""

    def to_json(self) -> dict[str, Any]:
        """Convert the report to its file's content."""
        notes = {"notes": list(self.remarks)} if self.remarks else {}
        entries = [entry.to_json() for entry in self.entries]
        return {"frames": self.frames, **notes, "entries": entries}

    def table(self) -> "Table":
        """Make a table of the recalls, with a column for each difficulty; 80 wide."""
        num_levels = len(DIFFICULTIES) + 1
        table = score_table(f"recall of proposals, {self.frames:,} frames, percent", "IoU", "all")
        for start in range(0, len(self.entries), num_levels):
            levels = self.entries[start : start + num_levels]
            rows = [
                ("recall", [percentage(level.recall) for level in levels]),
                (
                    "by frame",
                    [percentage(level.recall_frames_with_objects) for level in levels],
                ),
                ("by frame, empty 0", [percentage(level.recall_all_frames) for level in levels]),
                ("objects", [f"{level.n_gt:,}" for level in levels]),
            ]
            names = (levels[0].class_name, levels[0].metric, f"{levels[0].iou:g}")
            add_section(table, names, rows)
        add_notes(table, self.remarks)
        return table


@named_arguments
def evaluate_proposals(
    results_dir: Path | str,
    labels_dir: Path | str,
    *,
    sample_list: Path | str | None = None,
    ious: Sequence[float] = (0.5, 0.7),
    max_proposals: int | None = None,
    progress: bool = False,
) -> ProposalReport:
    r"""Compute the recall of proposals in result files, by class, metric, overlap and difficulty.

    An object is found if a proposal of its class overlaps it by `iou` or more. Recall is reported
    over all objects, as the mean over the frames with objects, and as the mean over all frames,
    with 0 for frames without objects; and for each difficulty as well as for all objects.

    Examples:
        >>> import sightline, tempfile
        >>> from pathlib import Path
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> labels = PACKAGED_FRAMES / "training" / "label_2"
        >>> with tempfile.TemporaryDirectory() as results:
        ...     for path in labels.iterdir():  # the labels themselves, each with a score of 1
        ...         lines = [f"{line} 1.0" for line in path.read_text().splitlines()]
        ...         _ = Path(results, path.name).write_text("\n".join(lines))
        ...     report = sightline.evaluate_proposals(results, labels, ious=(0.7,))
        >>> all(entry.n_found == entry.n_gt for entry in report.entries)
        True

    Args:
        results_dir: One file per frame, as for `evaluate_objects`; the class of a proposal counts.
        labels_dir: One file per frame.
        sample_list: The frames, as for `evaluate_objects`.
        ious: Minimum overlaps of a found object, above 0 and up to 1.
        max_proposals: Maximum number per frame, with the highest scores (the first on ties).
        progress: Whether to show the progress.

    Raises:
        ValueError: If an argument is out of range, or a file is missing or invalid.
    """
    ious = tuple(ious)
    if not ious or not all(0 < iou <= 1 for iou in ious):
        values = ", ".join(f"{iou:g}" for iou in ious) or "none"
        raise ValueError(f"ious must be above 0 and at most 1, got {values}: give e.g. 0.5 and 0.7")
    if max_proposals is not None and max_proposals < 1:
        raise ValueError(
            f"max_proposals must be positive, got {max_proposals}: leave it out to take all"
        )
    is_evaluated = np.zeros((len(CLASSES), len(METRICS)), dtype=np.bool_)
    parts: list[_Truths] = []
    results_dir, labels_dir = data_path(results_dir), data_path(labels_dir)
    names = frame_names(labels_dir, sample_list)
    tally, num_beyond = ObjectTally(), 0
    frames = read_frames(results_dir, labels_dir, names, progress=progress)
    for proposals, labels in tallied(frames, tally):
        num_beyond += max(len(proposals) - (max_proposals or len(proposals)), 0)
        boxes, codes = _best_proposals(proposals, max_proposals)
        is_evaluated |= find_evaluated(boxes, codes)
        parts.append(_find_truths(len(parts), labels, boxes, codes))
    tally.conventions.counts_repeats = False  # recall does not depend on repeats
    truths = _Truths(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    entries = tuple(
        _entry(truths, len(parts), int(code), int(metric), float(iou), level)
        for code, metric in np.argwhere(is_evaluated)
        for iou in ious
        for level in range(NEVER + 1)
    )
    remarks = unread_files(results_dir, labels_dir, names) if sample_list is None else ()
    if num_beyond:
        remarks += (
            f"{num_beyond:,} of {tally.results.total():,} proposals were left out: only "
            f"{max_proposals:,} of a frame are taken.",
        )
    return ProposalReport(frames=len(parts), entries=entries, remarks=(*remarks, *tally.remarks()))


class _Truths(NamedTuple):
    """Labelled objects of the evaluated classes, with their best overlaps."""

    frame: Int64[np.ndarray, " num_truths"]
    code: Int8[np.ndarray, " num_truths"]
    level: Int8[np.ndarray, " num_truths"]
    overlap: Float64[np.ndarray, "num_truths 3"]
    """Largest overlap with a proposal of the class, by metric."""


def _find_truths(
    frame: int,
    labels: KittiObjects,
    proposals: Float64[np.ndarray, "num_boxes 11"],
    proposal_codes: Int8[np.ndarray, " num_boxes"],
) -> _Truths:
    codes = _codes(labels)
    kept = np.flatnonzero(codes >= 0)
    levels = truth_levels(labels.truncation, labels.occlusion, labels.boxes2d)
    boxes = stack_boxes([labels])[kept]
    return _Truths(
        frame=np.full(len(kept), frame),
        code=codes[kept],
        level=levels[kept],
        overlap=_best_overlaps(boxes, codes[kept], proposals, proposal_codes),
    )


def _entry(
    truths: _Truths, num_frames: int, code: int, metric: int, iou: float, level: int
) -> ProposalEntry:
    """Compute the recall of a class, metric and overlap; level NEVER stands for all objects."""
    counted = (truths.code == code) & ((truths.level <= level) | (level == NEVER))
    found = counted & (truths.overlap[:, metric] >= iou)
    n_gt, n_found = int(counted.sum()), int(found.sum())
    objects = np.bincount(truths.frame[counted], minlength=num_frames)
    recalls = np.bincount(truths.frame[found], minlength=num_frames) / np.maximum(objects, 1)
    frames_with_objects = int((objects > 0).sum())
    return ProposalEntry(
        class_name=CLASSES[code],
        metric=METRICS[metric],
        difficulty=DIFFICULTIES[level] if level < NEVER else None,
        iou=iou,
        n_gt=n_gt,
        n_found=n_found,
        recall=100 * n_found / max(n_gt, 1),
        recall_frames_with_objects=100 * float(recalls.sum()) / max(frames_with_objects, 1),
        recall_all_frames=100 * float(recalls.mean()),
    )


def _codes(objects: KittiObjects) -> Int8[np.ndarray, " num_objects"]:
    return np.array([class_code(name) for name in objects.class_names], dtype=np.int8)


def _best_proposals(
    proposals: KittiObjects, max_proposals: int | None
) -> tuple[Float64[np.ndarray, "num_boxes 11"], Int8[np.ndarray, " num_boxes"]]:
    """Select boxes and classes of the proposals with the highest scores."""
    assert proposals.scores is not None, "results are read with scores"
    order = np.argsort(-proposals.scores, kind="stable")[:max_proposals]
    return stack_boxes([proposals])[order], _codes(proposals)[order]


@compiled
def _best_overlaps(
    truths: Float64[np.ndarray, "num_truths 11"],
    truth_code: Int8[np.ndarray, " num_truths"],
    proposals: Float64[np.ndarray, "num_proposals 11"],
    proposal_code: Int8[np.ndarray, " num_proposals"],
) -> Float64[np.ndarray, "num_truths 3"]:
    """Compute by metric the largest overlap of each object with a proposal of its class."""
    best = np.zeros((len(truths), 3))
    for i in range(len(truths)):
        for j in range(len(proposals)):
            if proposal_code[j] == truth_code[i]:
                ground, space = ground_and_space_overlap(proposals[j], truths[i])
                best[i, 0] = max(best[i, 0], image_overlap(proposals[j], truths[i]))
                best[i, 1] = max(best[i, 1], ground)
                best[i, 2] = max(best[i, 2], space)
    return best

"""Report of the proposal evaluation, as JSON and as a table."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName, Difficulty, Metric
from sightline.evaluation.object_tables import add_notes, add_section, percentage, score_table

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

"""What the evaluation of proposals reports: as JSON and as a table."""

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
    remarks: tuple[str, ...] = ()
    """Sentences on files and objects that are left out."""

    def to_json(self) -> dict[str, Any]:
        """The report as its file has it."""
        notes = {"notes": list(self.remarks)} if self.remarks else {}
        entries = [entry.to_json() for entry in self.entries]
        return {"frames": self.frames, **notes, "entries": entries}

    def table(self) -> "Table":
        """The recalls of each class, metric and overlap, a column for each difficulty; 80 wide."""
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

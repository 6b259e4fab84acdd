"""Rows of the course's table: their names, the published one, and a row's results."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal

from sightline.evaluation.object_report import ObjectEntry
from sightline.papers.rows import GivenNetwork, Levels, class_scores

Row = Literal["first", "baseline", "improved"]
"""First stage alone; the plain second stage of problem 1; an improved one of problem 2."""

NAMES: Final[dict[Row, str]] = {
    "first": "first stage alone",
    "baseline": "baseline (problem 1)",
    "improved": "improved (problem 2)",
}
"""Names of the rows in tables."""
IOUS: Final = (0.5, 0.7)
"""3D IoU that a match must exceed: the course's, and the benchmark's."""
PUBLISHED: Final[Levels] = (81.34, 72.35, 71.11)
"""Expected result of the baseline at the first of `IOUS`, on the course's test frames."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StageScores:
    """Results for cars of one row, by the IoU that a match must exceed."""

    network: GivenNetwork
    folder: Path
    """Folder of the result files."""
    entries: Mapping[float, Mapping[str, ObjectEntry]]
    """Entries by IoU, then by difficulty; none if no car was found."""

    def to_json(self) -> dict[str, object]:
        """Convert to the contents of a report file."""
        scores = {f"{iou:g}": asdict(class_scores(each)) for iou, each in self.entries.items()}
        return {**asdict(self.network), "is_papers": self.network.is_papers, "scores": scores}

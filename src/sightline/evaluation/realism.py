"""Statistical comparison of simulated frames with real ones.

PyTorch is not needed. Both sides are read from KITTI's object tree by the same code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.text import Text

from sightline.evaluation.realism_measures import Measures, measure_tree
from sightline.evaluation.realism_rows import STATISTICS
from sightline.files.problem import refuse_without_effect
from sightline.files.shard_path import data_path
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments

TOLERANCE: Final = 0.25
"""Relative difference above which a row is marked."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Statistic:
    """Statistic of both sides; None if a side has too little data."""

    name: str
    simulated: float | None
    real: float | None

    @property
    def ratio(self) -> float | None:
        """Ratio of simulated to real."""
        if self.simulated is None or not self.real:
            return None
        return self.simulated / self.real

    @property
    def differs(self) -> bool:
        """Whether the sides differ by more than `TOLERANCE`."""
        return self.ratio is not None and abs(self.ratio - 1) > TOLERANCE


@dataclass(frozen=True, kw_only=True, slots=True)
class RealismReport:
    """All statistics of two data sets."""

    num_simulated: int
    num_real: int
    """Number of frames used."""
    statistics: tuple[Statistic, ...]

    def table(self) -> Text:
        """Make a text table: a row per statistic, marked if the sides differ."""
        header = f"simulated ({self.num_simulated})", f"real ({self.num_real})", "ratio"
        lines = [f"{'':<44}" + "".join(f"{title:>18}" for title in header)]
        for row in self.statistics:
            values = (_format(row.simulated), _format(row.real), _format(row.ratio))
            mark = "  *" if row.differs else ""
            lines.append(f"{row.name:<44}" + "".join(f"{value:>18}" for value in values) + mark)
        count = sum(row.differs for row in self.statistics)
        compared = sum(row.ratio is not None for row in self.statistics)
        lines.append(f"* {count} of {compared} differ by more than {TOLERANCE:.0%}")
        return Text("\n".join(lines))

    def to_json(self) -> Mapping[str, object]:
        """Convert the report to JSON types."""
        return {
            "num_simulated": self.num_simulated,
            "num_real": self.num_real,
            "statistics": [
                {"name": row.name, "simulated": row.simulated, "real": row.real, "ratio": row.ratio}
                for row in self.statistics
            ],
        }


@named_arguments
def evaluate_realism(
    simulated: Path | str,
    real: Path | str | None,
    *,
    real_labels: Path | str | None = None,
    max_frames: int | None = None,
) -> RealismReport:
    """Measure simulated and real frames in the same way and compare the numbers.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> report = sightline.evaluate_realism(PACKAGED_FRAMES, None)
        >>> report.num_simulated, report.num_real
        (2, 0)

    Args:
        simulated: Object tree of `generate.simulate`.
        real: KITTI's object tree; if `velodyne` holds sweeps cut to the image, a folder
            `full_sweeps` beside `training` holds the whole ones. None: no real data.
        real_labels: Folder of more label files than in `real`, for the statistics of objects.
        max_frames: Maximum number of frames of each, evenly spaced; None: all.

    Raises:
        ValueError: A tree holds no labelled frames, or a file cannot be parsed.
    """
    if max_frames is not None and max_frames < 1:
        raise ValueError(f"max_frames must be at least 1, got {max_frames}")
    refuse_without_effect("without real data", real_labels=real is None and real_labels is not None)
    if real is not None and Path(real).resolve() == Path(simulated).resolve():
        warn_user(
            f"{simulated} is compared with itself, so every ratio is 1: name a tree of real frames",
        )
    simulated_measures = measure_tree(data_path(simulated), None, max_frames)
    real_measures = Measures()
    if real is not None:
        labels = None if real_labels is None else data_path(real_labels)
        real_measures = measure_tree(data_path(real), labels, max_frames)
    rows = []
    for name, compute in STATISTICS.items():
        rows.append(
            Statistic(name=name, simulated=compute(simulated_measures), real=compute(real_measures))
        )
    return RealismReport(
        num_simulated=len(simulated_measures.points_in_image),
        num_real=len(real_measures.points_in_image),
        statistics=tuple(rows),
    )


def _format(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"

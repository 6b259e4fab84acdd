"""Compares simulated frames with real ones, number by number.

Needs no PyTorch. Both sides are read from KITTI's object tree by the same code.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rich.text import Text

from sightline.evaluation.realism_measures import Measures, measure_tree
from sightline.evaluation.realism_rows import STATISTICS

TOLERANCE: Final = 0.25
"""Relative difference above which a row is marked."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Statistic:
    """One statistic of both sides; None where a side has too little data."""

    name: str
    simulated: float | None
    real: float | None

    @property
    def ratio(self) -> float | None:
        """Simulated over real."""
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
    """Frames looked at."""
    statistics: tuple[Statistic, ...]

    def table(self) -> Text:
        """For a person: a row for each statistic, marked where the sides differ."""
        header = f"simulated ({self.num_simulated})", f"real ({self.num_real})", "ratio"
        lines = [f"{'':<44}" + "".join(f"{title:>18}" for title in header)]
        for row in self.statistics:
            values = (_shown(row.simulated), _shown(row.real), _shown(row.ratio))
            mark = "  *" if row.differs else ""
            lines.append(f"{row.name:<44}" + "".join(f"{value:>18}" for value in values) + mark)
        count = sum(row.differs for row in self.statistics)
        compared = sum(row.ratio is not None for row in self.statistics)
        lines.append(f"* {count} of {compared} differ by more than {TOLERANCE:.0%}")
        return Text("\n".join(lines))

    def to_json(self) -> Mapping[str, object]:
        """For a script."""
        return {
            "num_simulated": self.num_simulated,
            "num_real": self.num_real,
            "statistics": [
                {"name": row.name, "simulated": row.simulated, "real": row.real, "ratio": row.ratio}
                for row in self.statistics
            ],
        }


def evaluate_realism(
    simulated: Path | str,
    real: Path | str | None,
    *,
    real_labels: Path | str | None = None,
    max_frames: int | None = None,
) -> RealismReport:
    """Measures simulated and real frames in the same way and puts the numbers side by side.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> report = sightline.evaluate_realism(PACKAGED_FRAMES, None)
        >>> report.num_simulated, report.num_real
        (2, 0)

    Args:
        simulated: An object tree that `generate.simulate` wrote.
        real: KITTI's object tree; a folder `full_sweeps` in it, beside `training`, is where
            whole sweeps are where `velodyne` holds those cut to the image. None: nothing real.
        real_labels: A folder of label files for the statistics of objects, where there are more
            than those of `real`.
        max_frames: Uses so many frames of each, evenly spaced; None: all.

    Raises:
        ValueError: A tree holds no labelled frames, or a file of it cannot be understood.
    """
    ours = measure_tree(Path(simulated), None, max_frames)
    theirs = Measures()
    if real is not None:
        labels = None if real_labels is None else Path(real_labels)
        theirs = measure_tree(Path(real), labels, max_frames)
    rows = []
    for name, tell in STATISTICS.items():
        rows.append(Statistic(name=name, simulated=tell(ours), real=tell(theirs)))
    return RealismReport(
        num_simulated=len(ours.points_in_image),
        num_real=len(theirs.points_in_image),
        statistics=tuple(rows),
    )


def _shown(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"

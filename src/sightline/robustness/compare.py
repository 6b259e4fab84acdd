"""Two runs side by side."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sightline.corruptions.suites import CLEAN
from sightline.data.atomic import atomic_write_text
from sightline.robustness.comparable import check_baseline
from sightline.robustness.measured import Measures, measure
from sightline.robustness.page import compare_page
from sightline.robustness.record import Record, read_record
from sightline.robustness.report import rich_table
from sightline.robustness.scoring import Figure
from sightline.robustness.texts import TextTable, ratio_text, score_text, setting_text

if TYPE_CHECKING:
    from rich.console import Group


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """Two runs of the same cases; CE is that of the first against the second."""

    first: Record
    second: Record

    def measured(self) -> list[tuple[Figure, Measures | None, Measures | None]]:
        """Every figure with both runs' measures."""
        return [
            (figure, measure(self.first, figure, self.second), measure(self.second, figure))
            for figure in self.first.setting.figures
        ]

    def tables(self) -> list[TextTable]:
        """Cases by the first figure, and all figures."""
        measured = self.measured()
        return [self._cases_table(measured[0][0]), self._figures_table(measured)]

    def table(self) -> "Group":
        """The tables for a terminal."""
        from rich.console import Group
        from rich.text import Text

        head = Text(f"{setting_text(self.first)}; and by {self.second.method}")
        return Group(head, *(rich_table(each) for each in self.tables()))

    def to_json(self) -> dict[str, object]:
        """Both runs' measures."""
        return {
            "methods": [self.first.method, self.second.method],
            "measures": {
                figure.name: [None if each is None else each.to_json() for each in both]
                for figure, *both in self.measured()
            },
        }

    def write(self, path: Path) -> None:
        """Draws both on a page."""
        measured = self.measured()
        page = compare_page(self.first, self.second, self._figures_table(measured), measured)
        atomic_write_text(path, page)

    def _cases_table(self, figure: Figure) -> TextTable:
        rows = []
        for name in self.first.cases:
            ours, theirs = (each.score(name, figure) for each in (self.first, self.second))
            lead = None if ours is None or theirs is None else figure.lead(ours, theirs)
            texts = (score_text(each, figure) for each in (ours, theirs))
            rows.append((name, *texts, score_text(lead, figure, signed=True)))
        return TextTable(
            title=f"{figure.title}, {figure.unit}; lead of the first, positive where it is better",
            header=("case", *self._names(), "lead"),
            rows=tuple(rows),
        )

    def _figures_table(
        self, measured: Sequence[tuple[Figure, Measures | None, Measures | None]]
    ) -> TextTable:
        rows = []
        for figure, ours, theirs in measured:
            cells: list[str] = []
            for each in (ours, theirs):
                cells += [
                    score_text(None if each is None else each.clean, figure),
                    score_text(None if each is None else each.mpc, figure),
                    ratio_text(None if each is None else each.mrr),
                ]
            cells.append(ratio_text(None if ours is None else ours.mce))
            rows.append((f"{figure.title}, {figure.unit}", *cells))
        header = [f"{what}, {name}" for name in self._names() for what in ("clean", "mPC", "mRR")]
        return TextTable(
            title="All figures",
            header=("figure", *header, "mCE of the first"),
            rows=tuple(rows),
        )

    def _names(self) -> tuple[str, str]:
        """Told apart where both have one name."""
        first, second = self.first.method, self.second.method
        return (first, second) if first != second else (f"{first} (1)", f"{second} (2)")


def compare_runs(paths: Sequence[Path]) -> Comparison:
    """Two runs by their files, as far as both have the same cases.

    Raises:
        ValueError: There are not two, or they are of another task, data set, suite or seed.
    """
    if len(paths) != 2:
        raise ValueError(f"two runs are compared, got {len(paths)} files; give two robustness.json")
    first, second = map(read_record, paths)
    shared = [name for name in first.cases if name in second.cases]
    if CLEAN not in shared:
        raise ValueError(f"{paths[0]} and {paths[1]} have no clean case in common; run them again")
    first, second = (_restricted(each, shared) for each in (first, second))
    check_baseline(second, first.setting, first.cases)
    return Comparison(first=first, second=second)


def _restricted(record: Record, names: Sequence[str]) -> Record:
    return replace(
        record,
        cases={name: record.cases[name] for name in names},
        scores={name: record.scores[name] for name in names},
    )

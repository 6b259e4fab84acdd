"""Report of a bench run: measures of all metrics, as tables and files."""

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from sightline.files.atomic import atomic_write_text
from sightline.files.problem import markdown_text
from sightline.geometry.arguments import json_number
from sightline.robustness.comparable import notes_on_files
from sightline.robustness.measured import Measures, measure
from sightline.robustness.page import run_page
from sightline.robustness.record import (
    CSV_NAME,
    MARKDOWN_NAME,
    PAGE_NAME,
    RECORD_NAME,
    RUN_FILES,
    Record,
)
from sightline.robustness.scoring import BenchMetric
from sightline.robustness.texts import (
    TextTable,
    kinds_table,
    leading_metrics,
    metrics_table,
    setting_text,
)
from sightline.structures.sample import Sensor

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table
_COLUMNS = ("case", "kind", "severity", "metric", "unit", "score", "baseline", "gap")


@dataclass(frozen=True, kw_only=True, slots=True)
class RobustnessReport:
    """Run with its records for comparison."""

    record: Record
    baseline: Record | None = None
    healthy: Mapping[Sensor, Record] = field(default_factory=dict)
    absent_cases: tuple[str, ...] = ()
    """Cases of the suite without results: not scored, and not in any mean."""
    unmade_cases: frozenset[str] = frozenset()
    """Cases of `absent_cases` that are not in the folder of cases: the notes count them."""
    no_cases: tuple[str, ...] = ()
    """Folders of results that match no case of the suite: not scored."""

    @property
    def measured(self) -> list[tuple[BenchMetric, Measures | None]]:
        """Compute the measures of every metric; None if there is nothing to score."""
        return [
            (metric, measure(self.record, metric, self.baseline, self.healthy))
            for metric in self.record.setting.metrics
        ]

    def to_json(self) -> dict[str, object]:
        """Convert the report to the content of robustness.json."""
        absent = {"absent_cases": list(self.absent_cases)} if self.absent_cases else {}
        unknown = {"folders_not_scored": list(self.no_cases)} if self.no_cases else {}
        return {
            "sightline": version("sightline"),
            **self.record.to_json(),
            **absent,
            **unknown,
            "baseline": None if self.baseline is None else _named(self.baseline),
            "healthy": {sensor: _named(record) for sensor, record in self.healthy.items()},
            "measures": {
                metric.name: None if measures is None else measures.to_json()
                for metric, measures in self.measured
            },
        }

    def tables(self) -> list[TextTable]:
        """Make tables of the leading metrics by kind, and of all metrics."""
        measured = self.measured
        leading = leading_metrics(self.record.setting.metrics)
        by_kind = [
            kinds_table(self.record, metric, measures)
            for metric, measures in measured
            if metric in leading and measures is not None
        ]
        return [*by_kind, metrics_table(self.record, measured)]

    def table(self) -> "Group":
        """Make the tables for a terminal."""
        from rich.console import Group
        from rich.text import Text

        head = Text("\n".join((setting_text(self.record), *self.notes())))
        return Group(head, *(rich_table(each) for each in self.tables()))

    def notes(self) -> tuple[str, ...]:
        """List notes on the interpretation of the scores."""
        others = {f"the healthy {sensor}": each for sensor, each in self.healthy.items()}
        if self.baseline is not None:
            others["the baseline"] = self.baseline
        notes = (*notes_on_files({"this run": self.record, **others}), *self.record.notes)
        if self.baseline == self.record:
            notes = ("WARNING: the baseline is this run itself: name another run.", *notes)
        if self.no_cases:
            count = len(self.no_cases)
            notes = (
                f"WARNING: {count} folder{'s' if count > 1 else ''} of results named as no case of "
                f"suite {self.record.setting.suite}, not scored: {', '.join(self.no_cases)}.",
                *notes,
            )
        if self.absent_cases:
            notes = (self._note_of_absent_cases(), *notes)
        return notes

    def _note_of_absent_cases(self) -> str:
        count = len(self.absent_cases)
        listed = [name for name in self.absent_cases if name not in self.unmade_cases]
        if len(listed) < count:
            joint = "and " if listed else "all "
            listed.append(f"{joint}{count - len(listed)} that are not in the folder of cases")
        return (
            f"WARNING: {count} case{'s' if count > 1 else ''} of suite "
            f"{self.record.setting.suite} without results, not scored and in no mean: "
            f"{', '.join(listed)}."
        )

    def markdown(self) -> str:
        """Format the tables as Markdown."""
        return "\n".join(
            [
                f"{markdown_text(setting_text(self.record))}.\n",
                *(f"{markdown_text(note)}\n" for note in self.notes()),
                *(table.markdown() for table in self.tables()),
            ]
        )

    def csv(self) -> str:
        """Format the scores as CSV, one row for each case and metric."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(_COLUMNS)
        for metric, measures in self.measured:
            for name, case in self.record.cases.items():
                baseline = None if self.baseline is None else self.baseline.score(name, metric)
                gap = None if measures is None else measures.gaps[name]
                score = self.record.score(name, metric)
                row = (
                    name,
                    case.kind,
                    case.severity,
                    metric.name,
                    metric.unit,
                    score,
                    baseline,
                    gap,
                )
                writer.writerow("" if value is None else value for value in row)
        return file.getvalue()

    files: ClassVar[tuple[str, ...]] = RUN_FILES
    """Files from `write`."""

    def write(self, out: Path) -> None:
        """Write all files of the report into the folder of the run."""
        atomic_write_text(out / CSV_NAME, self.csv())
        atomic_write_text(out / MARKDOWN_NAME, self.markdown())
        page = run_page(
            self.record, self.measured, self.baseline, self.healthy, out, notes=self.notes()
        )
        atomic_write_text(out / PAGE_NAME, page)
        record = json.dumps(self.to_json(), indent=2, default=json_number) + "\n"
        atomic_write_text(out / RECORD_NAME, record)


def _named(record: Record) -> dict[str, object]:
    return {"method": record.method, "made_by": dict(record.made_by)}


def rich_table(table: TextTable) -> "Table":
    """Make a table for a terminal; its text is not markup."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    drawn = Table(
        title=Text(table.title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    for number, name in enumerate(table.header):
        has_words = any(" " in row[number] for row in table.rows)  # "12.5 camera_fog-3"
        justify: Literal["left", "right"] = "right" if number else "left"
        drawn.add_column(Text(name), justify=justify, no_wrap=not number or not has_words)
    for row in table.rows:
        drawn.add_row(*map(Text, row))
    return drawn

"""Comparison of runs side by side."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sightline.corruptions.suites import CLEAN
from sightline.files.atomic import atomic_write_text
from sightline.robustness.comparable import check_baseline, notes_on_files
from sightline.robustness.measured import Measures, measure
from sightline.robustness.page import compare_page
from sightline.robustness.record import Record, read_record
from sightline.robustness.report import rich_table
from sightline.robustness.scoring import BenchMetric
from sightline.robustness.texts import (
    TextTable,
    leading_metrics,
    ratio_text,
    score_text,
    setting_text,
)

if TYPE_CHECKING:
    from rich.console import Group


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """Runs of the same cases; CE of each but the last is relative to the last."""

    records: tuple[Record, ...]
    """Two or more records."""
    left_out: tuple[str, ...] = ()
    """Cases that are missing in some run."""

    def measured(self) -> list[tuple[BenchMetric, list[Measures | None]]]:
        """Compute the measures of all runs for every metric."""
        *others, last = self.records
        return [
            (metric, [*(measure(each, metric, last) for each in others), measure(last, metric)])
            for metric in last.setting.metrics
        ]

    def tables(self) -> list[TextTable]:
        """Make tables of cases by the leading metrics, and of all metrics."""
        leading = leading_metrics(self.records[0].setting.metrics)
        return [*map(self._cases_table, leading), self._metrics_table()]

    def notes(self) -> tuple[str, ...]:
        """List notes on the interpretation of the scores."""
        notes = tuple(self._notes_of_records())
        notes = (*self._notes_on_equals(), *notes)
        notes = (*notes_on_files(dict(zip(self._names(), self.records, strict=True))), *notes)
        if self.left_out:
            names = ", ".join(self.left_out)
            notes = (f"Left out, as not all runs have these cases: {names}.", *notes)
        return notes

    def _notes_of_records(self) -> Iterator[str]:
        """Yield the notes of the records, with the runs' names unless all have them."""
        names = self._names()
        for note in dict.fromkeys(note for each in self.records for note in each.notes):
            having = [
                name for name, each in zip(names, self.records, strict=True) if note in each.notes
            ]
            yield note if len(having) == len(names) else f"{', '.join(having)}: {note}"

    def _notes_on_equals(self) -> Iterator[str]:
        """Yield a note for each run that is an earlier one."""
        names = self._names()
        for number, each in enumerate(self.records):
            first = self.records.index(each)
            if first < number:
                yield (
                    f"WARNING: {names[number]} is the run of {names[first]}, with the same scores "
                    "in every case: name the file of another run."
                )

    def table(self) -> "Group":
        """Make the tables for a terminal."""
        from rich.console import Group
        from rich.text import Text

        first, *others = self._named_records()
        names = ", ".join(each.method for each in others)
        head = Text("\n".join((f"{setting_text(first)}; and by {names}", *self.notes())))
        return Group(head, *(rich_table(each) for each in self.tables()))

    def to_json(self) -> dict[str, object]:
        """Convert the measures of all runs to JSON types."""
        return {
            "methods": [each.method for each in self.records],
            "measures": {
                metric.name: [None if each is None else each.to_json() for each in measures]
                for metric, measures in self.measured()
            },
        }

    def write(self, path: Path) -> None:
        """Draw all runs on a page."""
        page = compare_page(
            self._named_records(), self._metrics_table(), self.measured(), notes=self.notes()
        )
        atomic_write_text(path, page)

    def _cases_table(self, metric: BenchMetric) -> TextTable:
        rows = []
        for name in self.records[0].cases:
            scores = [each.score(name, metric) for each in self.records]
            first, *others = scores
            leads = [
                None if first is None or other is None else metric.lead(first, other)
                for other in others
            ]
            texts = [score_text(each, metric) for each in scores]
            rows.append((name, *texts, *(score_text(each, metric, signed=True) for each in leads)))
        names = self._names()
        over = ("lead",) if len(names) == 2 else tuple(f"lead over {name}" for name in names[1:])
        return TextTable(
            title=f"{metric.title}, {metric.unit}; lead of the first, positive where it is better",
            header=("case", *names, *over),
            rows=tuple(rows),
        )

    def _metrics_table(self) -> TextTable:
        rows = []
        for metric, measures in self.measured():
            cells: list[str] = []
            for each in measures:
                cells += [
                    score_text(None if each is None else each.clean, metric),
                    score_text(None if each is None else each.mpc, metric),
                    ratio_text(None if each is None else each.mrr),
                ]
            cells += [ratio_text(None if each is None else each.mce) for each in measures[:-1]]
            rows.append((f"{metric.title}, {metric.unit}", *cells))
        names = self._names()
        header = [f"{column}, {name}" for name in names for column in ("clean", "mPC", "mRR")]
        errors = [f"mCE, {name}" for name in names[:-1]]
        if len(names) == 2:
            errors = ["mCE of the first"]
        return TextTable(title="All metrics", header=("metric", *header, *errors), rows=tuple(rows))

    def _named_records(self) -> list[Record]:
        """List the records, each with a name of its own."""
        names = self._names()
        return [replace(each, method=n) for n, each in zip(names, self.records, strict=True)]

    def _names(self) -> tuple[str, ...]:
        """List names of the methods, numbered if several have the same name."""
        counts = Counter(each.method for each in self.records)
        return tuple(
            each.method if counts[each.method] == 1 else f"{each.method} ({number})"
            for number, each in enumerate(self.records, start=1)
        )


def compare_runs(paths: Sequence[Path]) -> Comparison:
    """Compare runs by their files, over their common cases.

    Raises:
        ValueError: There are fewer than two, or they are of another task, data set, suite or seed.
    """
    if len(paths) < 2:
        raise ValueError(
            f"a comparison needs two runs or more, got {len(paths)}; give the folders of two"
        )
    records = [read_record(path) for path in paths]
    shared = [name for name in records[0].cases if all(name in each.cases for each in records)]
    if CLEAN not in shared:
        files = " and ".join(map(str, paths))
        raise ValueError(f"{files} have no clean case in common; run them again")
    every = dict.fromkeys(name for each in records for name in each.cases)
    first, *others = (_restricted(each, shared) for each in records)
    for path, other in zip(paths[1:], others, strict=True):
        check_baseline(other, first.setting, first.cases, title=f"the run {path}")
    return Comparison(
        records=(first, *others), left_out=tuple(name for name in every if name not in shared)
    )


def _restricted(record: Record, names: Sequence[str]) -> Record:
    return replace(
        record,
        cases={name: record.cases[name] for name in names},
        scores={name: record.scores[name] for name in names},
    )

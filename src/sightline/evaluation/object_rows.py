"""Object scores as plain rows, for spreadsheets and documents."""

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from sightline.evaluation.object_report import ObjectEntry, ObjectReport
from sightline.files.atomic import atomic_write_text

_NAMES = ("class", "metric", "difficulty", "distance")
_FIGURES = ("AP_R40", "AP_R11", "AOS_R40", "AOS_R11", "max_recall", "flipped_share")
_ALL_POINTS = "AP_all_points"
_INTERVAL = ("AP_all_points_low", "AP_all_points_high")

Cell = str | int | float | None


def write_object_rows(
    report: ObjectReport, *, csv: Path | None = None, markdown: Path | None = None
) -> None:
    """Write a report's scores, a row for each class, metric, difficulty and distance band.

    Args:
        report: The report.
        csv: Comma-separated file of unrounded figures; None: not written.
        markdown: File with a table of figures to two places, and the report's notes below it; None:
            not written.
    """
    columns, rows = object_rows(report)
    if csv is not None:
        atomic_write_text(csv, _as_csv(columns, rows))
    if markdown is not None:
        notes = "".join(f"\n{note}\n" for note in report.notes())
        atomic_write_text(markdown, _as_markdown(columns, rows) + notes)


def object_rows(report: ObjectReport) -> tuple[tuple[str, ...], list[list[Cell]]]:
    """List the names of the columns, and the rows; a missing figure is None.

    AP, AOS and their interval are percentages, recall and shares are from 0 to 1, as in JSON.
    """
    interval = _INTERVAL if report.num_resamples else ()
    names = (*_NAMES, "objects", *_FIGURES, _ALL_POINTS, *interval)
    parts = [("all", report.entries), *((band.title, band.entries) for band in report.bands)]
    return names, [
        list(_row(entry, distance, with_interval=report.num_resamples > 0))
        for distance, entries in parts
        for entry in entries
    ]


def _row(entry: ObjectEntry, distance: str, *, with_interval: bool) -> Iterator[Cell]:
    told = entry.to_json()
    yield from (entry.class_name, entry.metric, entry.difficulty, distance, entry.n_gt)
    yield from (told[name] for name in (*_FIGURES, _ALL_POINTS))
    if with_interval:
        points = entry.all_points
        yield from (None, None) if points is None else (points.low, points.high)


def _as_csv(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    return file.getvalue()


def _as_markdown(columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    lines = [columns, ["---"] * len(_NAMES) + ["---:"] * (len(columns) - len(_NAMES))]
    lines += [[_told(cell) for cell in row] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _told(cell: Cell) -> str:
    if cell is None:
        return "-"
    return f"{cell:.2f}" if isinstance(cell, float) else str(cell)

"""Tables of scores of objects: a section for each class and metric, a column for each level."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName, Difficulty
from sightline.structures.precision_recall import NUM_SLOTS

if TYPE_CHECKING:
    from rich.table import Table


def score_table(
    title: str, extra_name: str | None = None, extra_level: str | None = None
) -> "Table":
    """An empty table; columns for names, for what the figure is, and for the levels.

    Args:
        title: Above it.
        extra_name: Of a column after class and metric.
        extra_level: Of a column after the difficulties.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    shown = Text(title, style="table.title")  # what folders are named is no markup
    table = Table(title=shown, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("class", "metric", extra_name, ""):
        if name is not None:
            table.add_column(name, no_wrap=True)
    for level in (*DIFFICULTIES, extra_level):
        if level is not None:
            table.add_column(level, justify="right", no_wrap=True)
    return table


def add_section(
    table: "Table", names: Sequence[str], rows: Sequence[tuple[str, list[str]]]
) -> None:
    """Adds the figures of a class and metric, whose names stand on the first line only."""
    for number, (figure, cells) in enumerate(rows):
        shown = names if number == 0 else [""] * len(names)
        table.add_row(*shown, figure, *cells, end_section=number == len(rows) - 1)


def add_notes(table: "Table", notes: Sequence[str]) -> None:
    """Puts sentences below a table; what they name is no markup."""
    from rich.text import Text

    table.caption = Text("\n".join(notes), style="table.caption") if notes else None
    table.caption_justify = "left"


def percentage(value: float | None) -> str:
    """A cell; a dash where there is no value."""
    return "-" if value is None else f"{value:.2f}"


def slots_note(counts: Sequence[tuple[ClassName, Difficulty, int]]) -> list[str]:
    """A sentence on what R40 can be at most where objects are fewer than recall positions.

    Args:
        counts: Class, difficulty and number of objects that count.

    Returns:
        The sentence, on the class with the fewest objects; empty where all have enough.
    """
    few = [each for each in counts if 0 < each[2] < NUM_SLOTS]
    if not few:
        return []
    class_name, difficulty, n_gt = min(few, key=lambda each: each[2])
    most_r40 = 100 * (n_gt - 1) / (NUM_SLOTS - 1)
    return [
        f"With fewer than {NUM_SLOTS} objects not all recall positions can be reached: {n_gt} of "
        f"{class_name}, {difficulty}, found without a fault give R40 {most_r40:.1f}. AP of all "
        "points has no such limit: read that one."
    ]

"""Tables of object scores: a section for each class and metric, a column for each level."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from sightline.evaluation.kitti_object_rules import DIFFICULTIES, ClassName, Difficulty
from sightline.structures.score_curves import NUM_SLOTS

if TYPE_CHECKING:
    from rich.table import Table


def score_table(
    title: str, extra_name: str | None = None, extra_level: str | None = None
) -> "Table":
    """Make an empty table with columns for names, the score and the levels.

    Args:
        title: Title above the table.
        extra_name: Name of a column after class and metric.
        extra_level: Name of a column after the difficulties.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    heading = Text(title, style="table.title")  # folder names are not markup
    table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
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
    """Add the scores of a class and metric, with the names only on the first line."""
    for number, (score, cells) in enumerate(rows):
        first_cells = names if number == 0 else [""] * len(names)
        table.add_row(*first_cells, score, *cells, end_section=number == len(rows) - 1)


def add_notes(table: "Table", notes: Sequence[str]) -> None:
    """Put notes below a table; their text is not markup."""
    from rich.text import Text

    table.caption = Text("\n".join(notes), style="table.caption") if notes else None
    table.caption_justify = "left"


def percentage(value: float | None) -> str:
    """Format a cell; a dash without a value."""
    return "-" if value is None else f"{value:.2f}"


def slots_note(counts: Sequence[tuple[ClassName, Difficulty, int]]) -> list[str]:
    """Note the maximum of R40 if there are fewer objects than recall positions.

    Args:
        counts: Class, difficulty and number of objects that count.

    Returns:
        The sentence, on the class with the fewest objects; empty if all have enough.
    """
    few = [each for each in counts if 0 < each[2] < NUM_SLOTS]
    if not few:
        return []
    class_name, difficulty, n_gt = min(few, key=lambda each: each[2])
    max_r40 = 100 * (n_gt - 1) / (NUM_SLOTS - 1)
    return [
        f"With fewer than {NUM_SLOTS} objects not all recall positions can be reached: the {n_gt} "
        f"of {class_name}, {difficulty}, give R40 of at most {max_r40:.1f}, even if all are found. "
        "AP of all points has no such limit: use that one."
    ]

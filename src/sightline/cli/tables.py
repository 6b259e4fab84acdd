"""Tables in the width of a terminal: texts and headings wrap, columns of figures stay whole."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.measure import Measurement
from rich.table import Column, Table

_TEXT_LETTERS: Final = 27
"""Least width of longer texts, in which long words such as names of frames are folded."""
_HEADING_LETTERS: Final = 12
"""Likewise of headings over figures."""
_UNLIMITED: Final = 100_000  # columns, more than any table has


@dataclass(frozen=True, kw_only=True, slots=True)
class _Needs:
    """Widths of a column without its padding, in letters."""

    natural: int
    """Without any wrapping."""
    least: int
    """With words kept whole, and figures too."""
    longest_word: int
    is_text: bool
    """True for left-aligned columns, which are narrowed last."""
    is_wrapped: bool
    """True if rich may wrap the column's cells."""


def fitted(content: RenderableType, console: Console) -> list[RenderableType]:
    """Divide content into parts whose tables fit the console, without a shortened figure.

    A table that fits stays as it is. In others the headings wrap and long names are folded; if that
    is not enough, the table becomes several, which repeat the columns of names.
    """
    if isinstance(content, Group):
        return [part for each in content.renderables for part in fitted(each, console)]
    return [*_Layout.of(content, console).parts()] if isinstance(content, Table) else [content]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Layout:
    """A table's columns, and the console that they have to fit."""

    table: Table
    console: Console
    needs: list[_Needs]
    names: list[int]
    """The first columns, which name the rows: those at the left, one at least."""

    @classmethod
    def of(cls, table: Table, console: Console) -> "_Layout":
        at_right = [n for n, column in enumerate(table.columns) if column.justify == "right"]
        num_names = max(1, min([*at_right, len(table.columns) - 1]))
        return cls(
            table=table,
            console=console,
            needs=[_needs_of(column, console) for column in table.columns],
            names=[*range(num_names)],
        )

    def parts(self) -> list[Table]:
        """The table, or parts of its columns with the names in each."""
        every = range(len(self.needs))
        if _wraps_between_words(self.needs, self._room(every)):
            return [self.table]
        parts = []
        for chunk in self._chunks():
            chosen = [*self.names, *chunk]
            widths = self._widths(chosen) or [self.needs[n].least for n in chosen]
            part = _part(self.table, chosen, widths)
            part.width = _whole(part, self.console).maximum  # of one figure: maybe too wide
            parts.append(part)
        for part in parts[1:]:
            part.title = None
        for part in parts[:-1]:
            part.caption = None
        return parts

    def _chunks(self) -> list[list[int]]:
        """Columns of each part; those of one subject stay together if they can."""
        numbers = range(len(self.names), len(self.needs))
        chunks: list[list[int]] = [[]]
        for _, group in groupby(numbers, key=lambda n: _subject(self.table.columns[n])):
            subject = [*group]
            if self._widths([*self.names, *chunks[-1], *subject]) is None:
                chunks.append([])
            for number in subject:
                if chunks[-1] and self._widths([*self.names, *chunks[-1], number]) is None:
                    chunks.append([])
                chunks[-1].append(number)
        return [chunk for chunk in chunks if chunk] or [[]]

    def _widths(self, chosen: Sequence[int]) -> list[int] | None:
        return _shrunk([self.needs[n] for n in chosen], self._room(chosen))

    def _room(self, chosen: Sequence[int]) -> int:
        """Width that is left for the cells of some columns."""
        part = _part(self.table, chosen, [1] * len(chosen))
        return self.console.width - _whole(part, self.console).maximum + len(chosen)


def _needs_of(column: Column, console: Console) -> _Needs:
    heading = _whole(column.header, console)
    cells = [_whole(cell, console) for cell in column.cells]
    natural = max(each.maximum for each in (heading, *cells))
    longest_word = max(each.minimum for each in (heading, *cells))
    is_text = column.justify != "right"
    if is_text:
        least = min(longest_word if natural <= _TEXT_LETTERS else natural, _TEXT_LETTERS)
    else:
        sizes = (each.maximum if column.no_wrap else each.minimum for each in cells)
        least = max(min(heading.minimum, _HEADING_LETTERS), *sizes, 1)
    return _Needs(
        natural=natural,
        least=least,
        longest_word=longest_word,
        is_text=is_text,
        is_wrapped=not column.no_wrap,
    )


def _whole(content: RenderableType, console: Console) -> Measurement:
    """Widths of content, whatever the width of the console."""
    return console.measure(content, options=console.options.update(max_width=_UNLIMITED))


def _wraps_between_words(needs: Sequence[_Needs], room: int) -> bool:
    """Predict that rich shows all columns without cutting a word or figure.

    It makes the widest of the columns that wrap equally wide.
    """
    room -= sum(each.natural for each in needs if not each.is_wrapped)
    wrapped = [each for each in needs if each.is_wrapped]
    if sum(each.natural for each in wrapped) <= room:
        return True
    levels = range(1, max(room, 0) + 1)
    fitting = [n for n in levels if sum(min(each.natural, n) for each in wrapped) <= room]
    return bool(fitting) and all(each.longest_word <= fitting[-1] for each in wrapped)


def _shrunk(needs: Sequence[_Needs], room: int) -> list[int] | None:
    """Widths of columns after shrinking the widest, texts last; None: they do not fit."""
    if sum(each.least for each in needs) > room:
        return None
    widths = [each.natural for each in needs]
    while sum(widths) > room:
        wide = [n for n, each in enumerate(needs) if widths[n] > each.least]
        widest = max(wide, key=lambda n: (not needs[n].is_text, widths[n]))
        is_folded = widths[widest] <= needs[widest].longest_word and not needs[widest].is_text
        widths[widest] = needs[widest].least if is_folded else widths[widest] - 1
    return widths


def _subject(column: Column) -> str:
    """End of a heading such as "mPC, my-detector", whose columns stay together."""
    return str(column.header).rpartition(", ")[2]


def _part(table: Table, chosen: Sequence[int], widths: Sequence[int]) -> Table:
    """Make a table of some of the columns in given widths."""
    part = copy.copy(table)
    part.columns = [
        replace(table.columns[number], _index=place, width=width, no_wrap=False, overflow="fold")
        for place, (number, width) in enumerate(zip(chosen, widths, strict=True))
    ]
    return part

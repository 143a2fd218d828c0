"""Tables for terminals of any width, without truncated numbers or names."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
import re

import rich.box
from rich.box import Box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Column, Table

ANY_WIDTH = 10_000  # characters
FRAME, EDGE = 3, 1  # characters in addition to the text: per column, and per table


def print_table(console: Console, table: Table, empty: str = 'none') -> None:
    """Print a table; if it is too wide, wrap its text, then split it by columns.

    Texts are broken between words, and words that are too long after a slash, if they have one.
    Each part of a table starts with its first column. empty: text for a table without rows.
    """
    if not table.row_count:
        console.print(f'{table.title}: {empty}' if table.title else empty)
        return
    needs = [measure_column(console, column) for column in table.columns]
    if width_of([item.maximum for item in needs]) <= console.width:
        console.print(table)
        return
    title = table.title
    for column_indices in parts(needs, console.width, keep_together=not table.show_header):
        part = Table(title=title, box=table.box, show_header=table.show_header)
        columns = [table.columns[place] for place in column_indices]
        widths = shared(console.width, [needs[place] for place in column_indices])
        for column, width in zip(columns, widths, strict=True):
            part.add_column(column.header, justify=column.justify, overflow='fold', width=width)
        for cells in zip(*(column.cells for column in columns), strict=True):
            part.add_row(*map(break_at_slashes, cells, widths))
        console.print(part)
        title = None


def print_rows(
    console: Console,
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    numbers: Collection[int] = (),
    *,
    box: Box = rich.box.HEAVY_HEAD,
    empty: str = 'none',
) -> None:
    """Print rows of texts as a table; numbers: indices of right-aligned columns."""
    table = Table(title=title or None, box=box, show_header=bool(columns))
    for index, column in enumerate(columns or ('', '')):
        table.add_column(column, justify='right' if index in numbers else 'left')
    for row in rows:
        table.add_row(*row)
    print_table(console, table, empty)


def print_facts(console: Console, title: str, facts: Mapping[str, str]) -> None:
    """Print facts as a table with their names on the left."""
    print_rows(console, title, (), facts.items())


def break_at_slashes(text: object, width: int) -> str:
    """Break words longer than `width` after a slash, as in topic and file names."""
    return re.sub(rf'(?=\S{{{width + 1}}})\S{{,{width - 1}}}/', r'\g<0>\n', str(text))


def measure_column(console: Console, column: Column) -> Measurement:
    """Return the widths of a column with and without wrapping.

    A number, right-aligned, stays on the line of its error.
    """
    options = console.options.update(width=ANY_WIDTH)
    header, *cells = (
        Measurement.get(console, options, text) for text in (column.header, *column.cells)
    )
    is_number = column.justify == 'right'
    least = [item.maximum if is_number else item.minimum for item in cells]
    most = [item.maximum for item in cells]
    return Measurement(max(header.minimum, *least), max(header.maximum, *most))


def width_of(widths: Sequence[int]) -> int:
    """Return the width of a table with columns of these widths."""
    return sum(widths) + FRAME * len(widths) + EDGE


def parts(needs: Sequence[Measurement], room: int, *, keep_together: bool) -> Iterator[list[int]]:
    """Split columns, by index, into parts in which no word breaks; else keep all together."""
    shown = [0]
    for index in range(1, len(needs)):
        widths = [needs[other].minimum for other in (*shown, index)]
        if not keep_together and len(shown) > 1 and width_of(widths) > room:
            yield shown
            shown = [0]
        shown.append(index)
    yield shown


def shared(room: int, needs: Sequence[Measurement]) -> list[int]:
    """Return widths that fill the terminal, first for words, then for whole texts, evenly.

    If even the words do not fit, the widest columns are narrowed and their words are folded.
    """
    widths = [item.minimum for item in needs]
    spare = room - width_of(widths)
    while spare < 0 and max(widths) > 1:
        widths[widths.index(max(widths))] -= 1
        spare += 1
    by_span = sorted(range(len(needs)), key=lambda index: needs[index].span)
    for rank, index in enumerate(by_span):
        more = max(min(needs[index].maximum - widths[index], spare // (len(by_span) - rank)), 0)
        widths[index] += more
        spare -= more
    return widths

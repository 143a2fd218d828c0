"""The names of the columns of a table: in its first line, or in comments above its rows."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass, field
import itertools
import math
from pathlib import Path
import re
import shlex

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.tables.clock import is_time
from pneunet_ros.tables.columns import (
    column_of,
    is_known,
    is_unit,
    KNOWN_NAMES,
    likely_name,
    STAMP,
    TIME,
    with_unit,
)

MOST_COLUMNS = 2_000
LONGEST_CELL = 200
LONGEST_PREAMBLE = 50  # lines above a table that are searched for its beginning
NAMES_SHOWN = 30
FEWEST_TIMES = 3  # rows in which an increasing column must increase
UNIX_SECONDS = 1e9, 4.2e9  # since 1970, from 2001 to 2103
MISSING = {'', 'nan', 'na', 'n/a', '#n/a', 'null', 'none'}
_DIGIT = re.compile(r'\d')
_QUOTED = re.compile(r'"[^"]*"')


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRequest:
    """Options for reading a table.

    select: only rows with these texts in these columns are read (names as in the file). rename:
    new name by the name in the file. ignore: columns (by either name) to leave out.
    """

    select: Mapping[str, str] = field(default_factory=dict)
    rename: Mapping[str, str] = field(default_factory=dict)
    ignore: Collection[str] = ()


def lines_from_names(
    path: Path, lines: Iterator[str], request: TableRequest
) -> tuple[Iterator[str], int]:
    """Return the lines starting with the column names, and the number of lines above.

    Lines that begin with # are comments. If a row of the table follows them, one of them names the
    columns, and the next one may contain their units.
    """
    above, first = 0, next(lines, '')
    comments: deque[str] = deque(maxlen=LONGEST_PREAMBLE)
    while first.startswith('#') or first.isspace():
        if first.startswith('#'):
            comments.append(first.lstrip('# '))
        above, first = above + 1, next(lines, '')
    rest = itertools.chain([first], lines)
    mark = delimiter(first)
    row = _cells(first, mark)
    if not any(map(_is_number, row)) or any(_is_name(cell, request) for cell in row):
        return rest, above
    names = _names_in(list(comments), mark, len(row), request)
    if not names and _is_number(next(cell for cell in row if cell.lower() not in MISSING)):
        comment = ', and no comment above it contains a known name' if comments else ''
        raise RecordingError(
            f'{path}: no line names the columns: line {above + 1} is already a row of '
            f'values{comment}; write a line above it that names each column, e.g. '
            f'time_s{mark}pressure_kpa ({KNOWN_NAMES})',
            reason='no_header',
        )
    return itertools.chain(names, rest), above - len(names)


def _names_in(comments: list[str], mark: str, columns: int, request: TableRequest) -> list[str]:
    """Return the comment with the column names, including the next line if it has their units.

    A comment with a cell for each column is preferred, then the comment with more known names,
    then the last. Without any known name, a comment must contain a name similar to a known one.
    """
    best, found = (False, 0), list[str]()
    cells = [_cells(comment, mark) for comment in comments]
    for place, names in enumerate(cells):
        units = units_below(names, [*cells, []][place + 1], request)
        fits = len(names) == columns
        known = sum(_is_name(name, request) for name in renamed_columns(names, units, request))
        if (fits, known) >= best and (known or (fits and any(map(likely_name, names)))):
            best, found = (fits, known), comments[place : place + 1 + bool(units)]
    return found


def _is_name(cell: str, request: TableRequest) -> bool:
    """Whether a cell is the name of a column, known or requested."""
    return is_known(cell) or cell in {*request.rename, *request.ignore, *request.select}


def _is_number(cell: str) -> bool:
    """Whether a cell is a number, with a point or a comma for decimals, or a time."""
    try:
        return not math.isnan(float(cell.replace(',', '.', 1)))
    except ValueError:
        return is_time(cell)


def units_below(header: Sequence[str], cells: Sequence[str], request: TableRequest) -> list[str]:
    """Return the units of all columns from the line below the names; empty if it has none.

    A line of units has a unit in at least one of the columns to be read, and no digits in the
    others.
    """
    left_out = {'', *request.ignore, *request.select}
    units = [cell.strip() for cell in cells]
    if len(units) != len(header):
        return []
    to_read = [unit for name, unit in zip(header, units, strict=True) if name not in left_out]
    if any(_DIGIT.search(cell) and not is_unit(cell) for cell in to_read) or not any(
        map(is_unit, to_read)
    ):
        return []
    return units


def renamed_columns(
    header: Sequence[str], units: Sequence[str], request: TableRequest
) -> list[str]:
    """Return the column names after renaming, with the units from the row below the header.

    A unit in a new name takes precedence over the unit below it.
    """
    names = [request.rename.get(name, name) for name in header]
    if not units:
        return names
    below = [
        new if new != old and column_of(new) else with_unit(new, unit)
        for old, new, unit in zip(header, names, units, strict=True)
    ]
    return [request.rename.get(name, name) for name in below]


def check_no_preamble(path: Path, names: int, preamble: Sequence[str], above: int) -> None:
    """Reject a table with text above it; names: number of cells in the supposed header line.

    preamble: the lines below the header, which is line `above` of the file.
    """
    lines = [_cells(line, delimiter(line)) for line in preamble]
    row = next((place for place, cells in enumerate(lines) if _is_row(cells)), None)
    if row is not None:
        table = _last_text(lines[:row])
        if table is not None and any(map(is_unit, lines[table])):
            table = _last_text(lines[:table])
    else:
        table = next(
            (
                place
                for place, cells in enumerate(lines)
                if len(cells) > names or any(map(is_known, cells))
            ),
            None,
        )
    if table is not None:
        line = above + table + 1
        raise RecordingError(
            f'{path}: the table seems to begin in line {line}, but the first line must name the '
            f'columns. Remove the lines above: tail -n +{line} {shlex.quote(str(path))} > '
            'TABLE.csv, or put # before each of these lines',
            reason='no_header',
        )


def check_separated(path: Path, header: Sequence[str]) -> None:
    """Reject a row that was not split into columns."""
    words = re.split(r'[|\s]+', header[0])
    if len(header) > 1 or len(words) == 1:
        return
    if any(map(is_known, words)) or all(map(_is_number, words)):
        raise RecordingError(
            f'{path}: {header[0][:40]!r} is a single cell: separate the cells by commas, '
            'semicolons or tabs',
            reason='not_csv',
        )


def with_clock(
    names: Sequence[str], left_out: Collection[int], preamble: Sequence[str], mark: str
) -> list[str]:
    """Return the column names with the time column named, if exactly one has dates or times.

    Such a column is unambiguous regardless of its name. left_out: indices of columns that are not
    read; preamble: the lines below the names. A date that is the same in all rows is not a time.
    The names are unchanged if a column is already known as the time.
    """
    if any(_is_time_column(name) for name in names):
        return list(names)
    rows = _rows(preamble, mark)
    clocks = [
        place
        for place in range(len(names))
        if place not in left_out
        and (cells := [row[place] for row in rows if place < len(row)])
        and all(map(is_time, cells))
        and (len(set(cells)) > 1 or len(cells) == 1)
    ]
    if len(clocks) != 1:
        return list(names)
    return [f'{TIME}_s' if place in clocks else name for place, name in enumerate(names)]


def _is_time_column(name: str) -> bool:
    column = column_of(name)
    return name == STAMP or (column is not None and column.quantity == TIME)


def ask_about_time(
    path: Path, places: Mapping[str, int], preamble: Sequence[str], mark: str
) -> None:
    """Ask for the time column if none has such a name but one increases from row to row.

    places: column indices by name; preamble: the lines below the names.
    """
    if any(map(_is_time_column, places)):
        return
    rows = _rows(preamble, mark)
    for name, place in places.items():
        cells = [row[place] for row in rows if place < len(row)]
        likely = likely_name(name)
        other = column_of(name) is not None or (likely and not likely.startswith(TIME))
        if other or len(cells) < FEWEST_TIMES:
            continue
        if not all(map(_is_number, cells)) or any(map(is_time, cells)):
            continue
        numbers = [float(cell.replace(',', '.', 1)) for cell in cells]
        steps = sorted(after - before for before, after in itertools.pairwise(numbers))
        if steps[0] > 0.0:
            units = '|'.join(SI_PER_UNIT['time'])
            known = likely if column_of(likely) else _since_1970(numbers[0])
            new = known or f'{TIME}_UNIT, replacing UNIT with {units}'
            raise RecordingError(
                f'{path}: no column has the name of a time. {name!r} increases from row to row, '
                f'by {steps[len(steps) // 2]:.4g}: if it is the time, add --rename '
                f'{shlex.quote(name)}={new}',
                reason='no_time',
            )


def _since_1970(time: float) -> str:
    """Return the name of a column of Unix times, with the unit of its values; else ''."""
    for name, per_second in (('time_s', 1.0), ('time_ms', 1e3), ('time_us', 1e6), (STAMP, 1e9)):
        if UNIX_SECONDS[0] <= time / per_second < UNIX_SECONDS[1]:
            return name
    return ''


def _rows(preamble: Sequence[str], mark: str) -> list[list[str]]:
    """Return the cells of lines with at least one number or time; others may be text."""
    lines = [_cells(line, mark) for line in preamble]
    return [cells for cells in lines if any(map(_is_number, cells))]


def _is_row(cells: Sequence[str]) -> bool:
    """Whether cells are a data row: numbers, some of which may be missing."""
    filled = [cell for cell in cells if cell.lower() not in MISSING]
    return bool(filled) and all(map(_is_number, filled))


def _last_text(lines: Sequence[Sequence[str]]) -> int | None:
    """Return the last line of text only; a line that also has numbers is a row with a remark."""
    texts = [place for place, cells in enumerate(lines) if not any(map(_is_number, cells))]
    return max((place for place in texts if any(lines[place])), default=None)


def check_header(
    path: Path,
    header: Sequence[str],
    units: Sequence[str],
    renamed: Sequence[str],
    request: TableRequest,
) -> None:
    """Reject missing, duplicate, too many or too long names, and invalid requests."""
    if not header or not any(header):
        raise RecordingError(
            f'{path} is empty: the first line must name the columns', reason='empty'
        )
    if len(header) > MOST_COLUMNS:
        raise RecordingError(f'{path} has more than {MOST_COLUMNS} columns', reason='too_large')
    for name in header:
        if '\0' in name:
            raise RecordingError(
                f'{path} is not UTF-8 text (is it UTF-16?): save it as CSV in UTF-8',
                reason='not_utf8',
            )
        if len(name) > LONGEST_CELL:
            raise RecordingError(
                f'{path}: the name of a column has {len(name)} characters, which is too many',
                reason='too_large',
            )
        if name and header.count(name) > 1:
            raise RecordingError(
                f'{path}: two columns have the name {name!r}', reason='given_twice'
            )
    below = map(with_unit, header, units) if units else ()
    present = {*header, *below, *request.rename.values(), *renamed}
    options = {'--select': request.select, '--rename': request.rename, '--ignore': request.ignore}
    for option, names in options.items():
        for name in names:
            if name not in (header if option == '--select' else present):
                raise RecordingError(
                    f'{path} has no column {name!r} ({option}); it has '
                    f'{", ".join(header[:NAMES_SHOWN])}',
                    reason='missing_column',
                )


def _cells(line: str, mark: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=mark), [])]


def delimiter(header: str) -> str:
    """Return the delimiter: a semicolon or tab if the first line has one, or else a comma."""
    unquoted = _QUOTED.sub('', header)
    return next((mark for mark in (';', '\t') if mark in unquoted), ',')


def plain_number(text: str, mark: str) -> str:
    """Return a number with a decimal point."""
    if mark != ',' and text.count(',') == 1 and '.' not in text:
        return text.replace(',', '.')
    return text

"""A CSV file as columns of numbers: data only, of bounded size; every refusal names its place."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
import csv
from dataclasses import dataclass, field
from datetime import date
from decimal import Decimal, InvalidOperation
import io
import itertools
import math
from pathlib import Path
import re
from typing import TextIO

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.files.regular_file import open_regular
from pneunet_ros.tables.columns import column_of, is_unit, standard_name, TIME, with_unit

MOST_BYTES = 500_000_000
MOST_ROWS = 2_000_000
MOST_COLUMNS = 2_000
MOST_CELLS = 25_000_000
LONGEST_CELL = 200
LONGEST_LINE = 2 * MOST_COLUMNS * LONGEST_CELL  # characters
_NAMES_SHOWN = 30
_LONGEST_PREAMBLE = 50  # lines above a table, to say where it begins
CLOCK = f'{TIME}_s'  # a column that may hold dates and times of day
_RULES = {
    ',': 'cells are separated by commas, and decimals by a point',
    ';': 'cells are separated by semicolons, as in the first line',
    '\t': 'cells are separated by tabs, as in the first line',
}
_MISSING = {'', 'nan', 'na', 'n/a', '#n/a', 'null', 'none'}
_SEPARATOR = re.compile(r'"?sep=(?P<mark>[;,\t])"?\s*', re.IGNORECASE)  # as Excel writes it
_HALF_A_DAY, _DAY = 43_200, 86_400  # s
_DIGIT = re.compile(r'\d')
_QUOTED = re.compile(r'"[^"]*"')
_THOUSANDS = re.compile(r'[-+]?[1-9]\d{0,2}(?:[.,]\d{3})+', re.ASCII)
_APART = re.compile(r"[-+]?\d{1,3}([.,'’\s])\d{3}(?:\1\d{3})*(?:[.,]\d+)?", re.ASCII)
_TIME_OF_DAY = re.compile(
    r'(?:(?P<date>\d{4}-\d\d?-\d\d?|\d\d?\.\d\d?\.\d{4}|\d\d?/\d\d?/\d{4})[T ]+)?'
    r'(?P<hour>[01]?\d|2[0-3]):(?P<minute>[0-5]\d)(?::(?P<second>[0-5]\d(?:[.,]\d{1,9})?))?'
    r' ?(?:Z|UTC|(?P<zone>[+-](?:0\d|1[0-4])(?::?[0-5]\d)?)|(?P<half>[AaPp][Mm]))?',
    re.ASCII,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableRequest:
    """How a table is to be read.

    select: keep only rows that hold these texts in these columns (names as in the file). rename:
    new name by the one in the file. ignore: columns (by either name) to be left out.
    """

    select: Mapping[str, str] = field(default_factory=dict)
    rename: Mapping[str, str] = field(default_factory=dict)
    ignore: Collection[str] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CsvTable:
    """Columns by name: numbers (rows,), NaN where a cell is empty or NaN.

    exact: the same as ratios of integers for the columns that were asked for exactly. `lines` are
    the numbers of the rows' lines in the file, `sentences` say how names were read; `written` has
    the names in the file. clock: the times are times of day or dates.
    """

    numbers: Mapping[str, Array]
    exact: Mapping[str, tuple[Decimal | None, ...]]
    lines: tuple[int, ...]
    sentences: tuple[str, ...]
    written: Mapping[str, str]
    clock: bool


def read_csv(
    path: Path,
    request: TableRequest,
    exact: Collection[str] = (),
    check_names: Callable[[Collection[str]], object] = len,
) -> CsvTable:
    """Return the columns of a file by their new names; raises RecordingError that says where.

    exact: names of columns to be read without rounding, too. check_names: sees the new names
    before any row is read, and may raise.
    """
    try:
        with open_regular(path) as binary:
            if binary.seek(0, io.SEEK_END) > MOST_BYTES:
                raise RecordingError(f'{path} has more than {MOST_BYTES // 10**6} MB: split it')
            binary.seek(0)
            stream = io.TextIOWrapper(binary, encoding='utf-8-sig', newline='')
            return _read(path, stream, request, exact, check_names)
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error.strerror}') from error
    except UnicodeDecodeError as error:
        raise RecordingError(
            f'{path} is no text in UTF-8 (byte {error.start}): save it as CSV UTF-8'
        ) from error
    except csv.Error as error:
        raise RecordingError(f'{path} is no CSV file: {error}') from error


def _read(
    path: Path,
    stream: TextIO,
    request: TableRequest,
    exact: Collection[str],
    check_names: Callable[[Collection[str]], object],
) -> CsvTable:
    given, above = _without_comments(_lines(path, stream))
    first = next(given, '')
    separator = _SEPARATOR.fullmatch(first)
    if separator is not None:
        above += 1
        first = next(given, '')
    mark = _delimiter(first) if separator is None else separator['mark']
    ahead = list(itertools.islice(given, _LONGEST_PREAMBLE))
    reader = csv.reader(itertools.chain([first], ahead, given), strict=True, delimiter=mark)
    header = [name.strip() for name in next(reader, [])]
    below = next(filter(str.strip, ahead), '') if reader.line_num == 1 else ''
    units = _units_below(header, next(csv.reader([below], delimiter=mark), []), request)
    renamed = _renamed(header, units, request)
    _check_header(path, header, renamed, request)
    standard = [standard_name(name) for name in renamed]
    places: dict[str, int] = {}
    for place, (name, *new) in enumerate(zip(header, renamed, standard, strict=True)):
        if not name or {name, *new} & set(request.ignore) or name in request.select:
            continue
        if new[1] in places:
            raise RecordingError(f'{path}: two columns are called {new[1]}: --ignore one of them')
        places[new[1]] = place
    try:
        check_names(places)
    except RecordingError:
        _check_no_preamble(path, len(header), ahead, above + 1)
        raise
    if not places:
        _check_no_preamble(path, len(header), ahead, above + 1)
    selected = {header.index(name): (name, text) for name, text in request.select.items()}
    numbers = {name: array('d') for name in places}  # 8 bytes a number
    exactly: dict[str, list[Decimal | None]] = {name: [] for name in exact if name in places}
    lines: list[int] = []
    others: dict[str, None] = {}
    decimals: dict[str, str] = {}
    clock = Clock()
    rows = _rows(path, reader, len(header), mark, above)
    if units:
        next(rows)
    for line, cells in rows:
        if any(cells[place].strip() != text for place, (_, text) in selected.items()):
            others.update({', '.join(cells[place].strip() for place in selected): None})
            continue
        if len(lines) == MOST_ROWS:
            raise RecordingError(f'{path} has more than {MOST_ROWS} rows: split it')
        if (len(lines) + 1) * len(places) > MOST_CELLS:
            raise RecordingError(f'{path} has more than {MOST_CELLS} cells: split it')
        lines.append(line)
        for name, place in places.items():
            written = cells[place].strip()
            _check_decimals(path, line, written, decimals)
            if name == CLOCK and ':' in written:
                text = clock.seconds(written, line)
            else:
                text = _plain_number(written, mark)
            numbers[name].append(_number(path, line, name, text))
            if name in exactly:
                exactly[name].append(_exact(path, line, name, text))
    if not lines:
        _no_rows(path, request, list(others))
    file_names = {name: renamed[place] for name, place in places.items()}
    return CsvTable(
        numbers={name: freeze(np.array(values)) for name, values in numbers.items()},
        exact={name: tuple(values) for name, values in exactly.items()},
        lines=tuple(lines),
        sentences=(*_spelling(path, file_names), *clock.sentences(path)),
        written=file_names,
        clock=clock.latest is not None,
    )


def _without_comments(lines: Iterator[str]) -> tuple[Iterator[str], int]:
    """Return the lines below those that begin with #, and blank ones, and how many.

    The last of these names the columns where numbers are all that stands below it, or the last but
    one where the last holds their units.
    """
    above, first = 0, next(lines, '')
    comments: deque[str] = deque(maxlen=2)
    while first.startswith('#') or (comments and first.isspace()):
        if first.startswith('#'):
            comments.append(first.lstrip('# '))
        above, first = above + 1, next(lines, '')
    rest = itertools.chain([first], lines)
    if not comments or not all(_is_number(cell) for cell in first.split(_delimiter(first))):
        return rest, above
    names, below = _stripped_cells(comments[0]), _stripped_cells(comments[-1])
    if len(comments) == 2 and not _units_below(names, below, TableRequest()):
        comments.popleft()
    return itertools.chain(comments, rest), above - len(comments)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _units_below(header: Sequence[str], cells: Sequence[str], request: TableRequest) -> list[str]:
    """Return the units of all columns where the line below the names holds such; else nothing.

    That is a line without any digit in the columns to be read, and with a unit in one of them.
    """
    left_out = {'', *request.ignore, *request.select}
    units = [cell.strip() for cell in cells]
    if len(units) != len(header):
        return []
    to_read = [unit for name, unit in zip(header, units, strict=True) if name not in left_out]
    if any(map(_DIGIT.search, to_read)) or not any(map(is_unit, to_read)):
        return []
    return units


def _renamed(header: Sequence[str], units: Sequence[str], request: TableRequest) -> list[str]:
    """Return the names that were asked for, with the units below them.

    A new name that says a unit is the last word on it.
    """
    names = [request.rename.get(name, name) for name in header]
    if not units:
        return names
    return [
        new if new != old and column_of(new) else with_unit(new, unit)
        for old, new, unit in zip(header, names, units, strict=True)
    ]


def _check_no_preamble(path: Path, names: int, ahead: Sequence[str], above: int) -> None:
    """Refuse what stands above a table; names: cells in the line that should name its columns.

    ahead: the lines below that one, which is the `above`th of the file.
    """
    table = next(
        (
            place
            for place, line in enumerate(ahead)
            if len(_cells(line)) > names
            or any(column_of(standard_name(cell)) for cell in _cells(line))
        ),
        None,
    )
    if table is not None:
        raise RecordingError(
            f'{path}: the table seems to begin in line {above + table + 1}; the first line must '
            'name the columns: remove what stands above, or put # before each of these lines'
        )


def _cells(line: str) -> list[str]:
    return next(csv.reader([line], delimiter=_delimiter(line)), [])


def _stripped_cells(line: str) -> list[str]:
    return [cell.strip() for cell in _cells(line)]


def _delimiter(header: str) -> str:
    """Return what stands between cells: a semicolon or tab where the first line has one."""
    unquoted = _QUOTED.sub('', header)
    return next((mark for mark in (';', '\t') if mark in unquoted), ',')


def _plain_number(text: str, mark: str) -> str:
    """Return a number with a decimal point."""
    if mark != ',' and text.count(',') == 1 and '.' not in text:
        return text.replace(',', '.')
    return text


def _check_decimals(path: Path, line: int, written: str, seen: dict[str, str]) -> None:
    """Refuse a number that looks like one with thousands apart where decimals have another mark.

    seen: where each mark stood first for decimals, and for what may be thousands; noted here.
    """
    marks = [mark for mark in '.,' if mark in written]
    if len(marks) != 1 or ':' in written:  # a time of day, or no number
        return
    (mark,) = marks
    thousands = _THOUSANDS.fullmatch(written) is not None
    seen.setdefault(mark + 'thousands' * thousands, f'{written[:40]!r} in line {line}')
    for one, other in ('.,', ',.'):
        if one + 'thousands' in seen and other in seen:
            raise RecordingError(
                f'{path}: {seen[one + "thousands"]} seems to set thousands apart, as '
                f'{seen[other]} has another mark for decimals; write numbers without that'
            )


class Clock:
    """Reads dates and times of day one after the other; those without a date pass midnight."""

    __slots__ = ('_days', '_midnights', 'latest')

    def __init__(self) -> None:
        """Begin on the first day."""
        self.latest: Decimal | None = None
        self._midnights: list[int] = []
        self._days = 0

    def seconds(self, text: str, line: int) -> str:
        """Return seconds, since 1970 where there is a date; the text, where it is no time."""
        match = _TIME_OF_DAY.fullmatch(text)
        seconds = None if match is None else _clock_seconds(match)
        if match is None or seconds is None:
            return text
        if not match['date']:
            seconds += _DAY * self._days
            if self.latest is not None and self.latest - seconds > _HALF_A_DAY:
                self._midnights.append(line)
                self._days += 1
                seconds += _DAY
        self.latest = seconds
        return str(seconds)

    def sentences(self, path: Path) -> tuple[str, ...]:
        """Say where a day was added."""
        if not self._midnights:
            return ()
        lines = ', '.join(str(line) for line in self._midnights[:_NAMES_SHOWN])
        return (f'{path}: the time of day passes midnight in line {lines}: a day was added',)


def _clock_seconds(match: re.Match[str]) -> Decimal | None:
    """Return the seconds of a time of day in UTC, since 1970 where a date is before it."""
    hour, minute = int(match['hour']), int(match['minute'])
    if match['half']:
        hour = hour % 12 + (12 if match['half'].lower() == 'pm' else 0)
    seconds = Decimal((match['second'] or '0').replace(',', '.'))
    try:
        days = _days(match['date']) if match['date'] else 0
    except ValueError:
        return None
    return _DAY * days + 3600 * hour + 60 * minute + seconds - _zone(match['zone'])


def _zone(text: str | None) -> int:
    """Return by how many seconds a clock with this offset, as in +01:00, is ahead of UTC."""
    if not text:
        return 0
    digits = text[1:].replace(':', '').ljust(4, '0')
    return (-1 if text[0] == '-' else 1) * (3600 * int(digits[:2]) + 60 * int(digits[2:]))


def _days(text: str) -> int:
    """Return days since 1970 of 2026-11-22, 22.11.2026 or 11/22/2026; ValueError for no day."""
    first, second, third = (int(part) for part in re.split(r'[-./]', text))
    year, month, day = (first, second, third) if '-' in text else (third, second, first)
    if '/' in text and second > 12:  # the American order; both orders last for one day
        month, day = day, month
    return date(year, month, day).toordinal() - date(1970, 1, 1).toordinal()


def _spelling(path: Path, written: Mapping[str, str]) -> tuple[str, ...]:
    """Say which columns were read under another name than they have."""
    pairs = [f'{name!r} as {new}' for new, name in written.items() if name != new]
    if not pairs:
        return ()
    more = f' and {len(pairs) - _NAMES_SHOWN} more' if len(pairs) > _NAMES_SHOWN else ''
    return (f'{path}: columns were read {", ".join(pairs[:_NAMES_SHOWN])}{more}',)


def _lines(path: Path, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a file, of which none may be without end."""
    number = 0
    while line := stream.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise RecordingError(f'{path}, line {number}: more than {LONGEST_LINE} characters')
        yield line


def _rows(
    path: Path, reader: Iterator[list[str]], columns: int, mark: str, above: int
) -> Iterator[tuple[int, list[str]]]:
    """Yield rows of so many cells, with the numbers of their lines; empty lines pass by.

    above: lines of the file that the reader has not seen.
    """
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        line = above + getattr(reader, 'line_num', 0)
        if len(cells) != columns:
            raise RecordingError(
                f'{path}, line {line}: {len(cells)} cells, but there are {columns} columns; '
                f'{_RULES[mark]}'
            )
        yield line, cells


def _check_header(
    path: Path, header: Sequence[str], renamed: Sequence[str], request: TableRequest
) -> None:
    if not header or not any(header):
        raise RecordingError(f'{path} is empty: the first line must name the columns')
    if len(header) > MOST_COLUMNS:
        raise RecordingError(f'{path} has more than {MOST_COLUMNS} columns')
    for name in header:
        if len(name) > LONGEST_CELL:
            raise RecordingError(f'{path}: a name of a column has {len(name)} characters')
        if name and header.count(name) > 1:
            raise RecordingError(f'{path}: two columns are called {name!r}')
    there = {*header, *request.rename.values(), *renamed}
    asked = {'--select': request.select, '--rename': request.rename, '--ignore': request.ignore}
    for option, names in asked.items():
        for name in names:
            if name not in (there if option == '--ignore' else header):
                raise RecordingError(
                    f'{path} has no column {name!r} ({option}); it has '
                    f'{", ".join(header[:_NAMES_SHOWN])}'
                )


def _number(path: Path, line: int, name: str, text: str) -> float:
    if text.lower() in _MISSING:
        return math.nan
    try:
        value = math.nan if '_' in text or len(text) > LONGEST_CELL else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        hint = ' (decimals need a point)' if ',' in text else ''
        if _APART.fullmatch(text):
            hint = ' (nothing may set thousands apart, and decimals need a point)'
        raise RecordingError(
            f'{path}, line {line}, column {name}: {text[:40]!r} is no number{hint}; a missing '
            'value is an empty cell, NA or nan'
        )
    return value


def _exact(path: Path, line: int, name: str, text: str) -> Decimal | None:
    try:
        value = None if text.lower() in _MISSING else Decimal(text)
    except InvalidOperation as error:  # what float takes, Decimal takes
        raise RecordingError(f'{path}, line {line}, column {name}: no number') from error
    return None if value is None or value.is_nan() else value


def _no_rows(path: Path, request: TableRequest, others: list[str]) -> None:
    if not request.select:
        raise RecordingError(f'{path} has no rows below its first line')
    asked = ', '.join(f'{name}={text}' for name, text in request.select.items())
    more = ', ...' if len(others) > _NAMES_SHOWN else ''
    raise RecordingError(
        f'{path}: no row has {asked}; there are {"; ".join(others[:_NAMES_SHOWN])}{more}'
    )

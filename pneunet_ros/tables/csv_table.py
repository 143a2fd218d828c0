"""Reads a CSV file into columns of numbers, with size limits; errors name the line."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
import csv
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
import io
import itertools
import math
from pathlib import Path
import re
from typing import TextIO

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import read_failure, RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.printable import list_names
from pneunet_ros.core.progress import report_progress, STEP
from pneunet_ros.files.regular_file import open_regular
from pneunet_ros.tables.clock import Clock
from pneunet_ros.tables.columns import is_unit, standard_name, TIME
from pneunet_ros.tables.header import (
    ask_about_time,
    check_header,
    check_no_preamble,
    check_separated,
    delimiter,
    lines_from_names,
    LONGEST_CELL,
    LONGEST_PREAMBLE,
    MISSING,
    MOST_COLUMNS,
    NAMES_SHOWN,
    plain_number,
    renamed_columns,
    TableRequest,
    units_below,
    with_clock,
)

MOST_BYTES = 500_000_000
MOST_ROWS = 2_000_000
MOST_CELLS = 25_000_000
LONGEST_LINE = 2 * MOST_COLUMNS * LONGEST_CELL  # characters
CLOCK = f'{TIME}_s'  # a column that may hold dates and times of day
_RULES = {
    ',': 'cells are separated by commas, and decimals by a point',
    ';': 'cells are separated by semicolons, as in the first line',
    '\t': 'cells are separated by tabs, as in the first line',
}
_SEPARATOR = re.compile(r'"?sep=(?P<mark>[;,\t])"?\s*', re.IGNORECASE)  # as written by Excel
# As the serial monitor of Arduino begins lines.
_MONITOR = re.compile(r'\d\d:\d\d:\d\d\.\d{3} -> ')
_JSON = re.compile(rb'(\xef\xbb\xbf)?\s*(\{\s*["}]|\[\s*[\[{"])')
_THOUSANDS = re.compile(r'[-+]?[1-9]\d{0,2}(?:[.,]\d{3})+', re.ASCII)
_APART = re.compile(r"[-+]?\d{1,3}([.,'’\s])\d{3}(?:\1\d{3})*(?:[.,]\d+)?", re.ASCII)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CsvTable:
    """Columns by name: numbers (rows,), NaN for empty cells.

    exact: columns that were requested exactly, as ratios of integers. lines: line number of each
    row in the file; sentences: how names were interpreted; written: names as in the file. clock:
    whether times are times of day or dates.
    """

    numbers: Mapping[str, Array]
    exact: Mapping[str, tuple[Decimal | None, ...]]
    lines: tuple[int, ...]
    sentences: tuple[str, ...]
    written: Mapping[str, str]
    clock: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Header:
    """The header line: its cells as in the file, and renamed; the separator; the rows that follow.

    above: number of lines of the file above this line; preamble: the lines below it that were read
    to interpret it; reader: all rows below it.
    """

    names: list[str]
    renamed: list[str]
    mark: str
    above: int
    preamble: list[str]
    has_units: bool
    reader: Iterator[list[str]]


def read_csv(
    path: Path,
    request: TableRequest,
    exact: Collection[str] = (),
    check_names: Callable[[Collection[str]], object] = len,
) -> CsvTable:
    """Return the columns of a file by their new names; RecordingError names the place.

    exact: names of columns to be read also without rounding. check_names: called with the new
    names before any row is read, and may raise.
    """
    try:
        with open_regular(path) as binary:
            size = binary.seek(0, io.SEEK_END)
            if size > MOST_BYTES:
                raise RecordingError(
                    f'{path} has more than {MOST_BYTES // 10**6} MB: split it', reason='too_large'
                )
            binary.seek(max(size - 1, 0))
            cut = binary.read(1) not in (b'\n', b'\r')
            binary.seek(0)
            if _JSON.match(binary.read(LONGEST_CELL)):
                raise RecordingError(
                    f'{path} contains JSON, whatever its name: write its numbers as a table '
                    'whose first line names the columns, e.g. time_s,pressure_kpa',
                    reason='json',
                )
            binary.seek(0)
            stream = io.TextIOWrapper(binary, encoding='utf-8-sig', newline='')
            return _read(path, stream, cut, request, exact, check_names, size)
    except OSError as error:
        raise RecordingError(
            f'{path} cannot be read: {error.strerror}', reason=read_failure(error)
        ) from error
    except UnicodeDecodeError as error:
        raise RecordingError(
            f'{path} is not UTF-8 text (byte {error.start}): save it as CSV in UTF-8',
            reason='not_utf8',
        ) from error
    except csv.Error as error:
        raise RecordingError(f'{path} is not a CSV file: {error}', reason='not_csv') from error


def _read(
    path: Path,
    stream: TextIO,
    cut: bool,
    request: TableRequest,
    exact: Collection[str],
    check_names: Callable[[Collection[str]], object],
    size: int,
) -> CsvTable:
    header = _read_header(path, stream, request)
    places = _places(path, header, request)
    _check_places(path, header, places, check_names)
    numbers = {name: array('d') for name in places}  # 8 bytes a number
    exactly: dict[str, list[Decimal | None]] = {name: [] for name in exact if name in places}
    lines: list[int] = []
    decimals: dict[str, str] = {}
    clock = Clock()
    left_out: list[str] = []
    rows = _rows(path, header, cut, left_out)
    if header.has_units:
        next(rows)
    for line, cells in _selected(path, header, request, rows):
        _check_size(path, len(lines) + 1, len(places))
        lines.append(line)
        if len(lines) % STEP == 0:
            report_progress(f'reading {path.name}', stream.buffer.tell(), size)
        for name, place in places.items():
            written = cells[place].strip()
            _check_decimals(path, line, written, decimals)
            if name == CLOCK and ':' in written:
                text = clock.seconds(written, line)
            else:
                text = plain_number(written, header.mark)
            numbers[name].append(_number(path, line, name, text))
            if name in exactly:
                exactly[name].append(_exact(path, line, name, text))
    clock.check(path)
    shifts = clock.shifts()
    for row, line in enumerate(lines if shifts else ()):
        numbers[CLOCK][row] += shifts.get(line, 0)
        before = exactly[CLOCK][row] if CLOCK in exactly else None
        if before is not None:
            exactly[CLOCK][row] = before + shifts.get(line, 0)
    file_names = {name: header.renamed[place] for name, place in places.items()}
    return CsvTable(
        numbers={name: freeze(np.array(values)) for name, values in numbers.items()},
        exact={name: tuple(values) for name, values in exactly.items()},
        lines=tuple(lines),
        sentences=(*_spelling(path, file_names), *left_out, *clock.sentences(path)),
        written=file_names,
        clock=clock.latest is not None,
    )


def _read_header(path: Path, stream: TextIO, request: TableRequest) -> _Header:
    """Read the line of names, with the line of units below it, if there is one."""
    given, above = lines_from_names(path, _lines(path, stream), request)
    first = next(given, '')
    separator = _SEPARATOR.fullmatch(first)
    if separator is not None:
        given, comments = lines_from_names(path, given, request)
        above += 1 + comments
        first = next(given, '')
    mark = delimiter(first) if separator is None else separator['mark']
    preamble = list(itertools.islice(given, LONGEST_PREAMBLE))
    reader = csv.reader(itertools.chain([first], preamble, given), strict=True, delimiter=mark)
    names = [name.strip() for name in next(reader, [])]
    below = next(filter(str.strip, preamble), '') if reader.line_num == 1 else ''
    units = units_below(names, next(csv.reader([below], delimiter=mark), []), request)
    renamed = renamed_columns(names, units, request)
    check_header(path, names, units, renamed, request)
    return _Header(
        names=names,
        renamed=renamed,
        mark=mark,
        above=above,
        preamble=preamble,
        has_units=bool(units),
        reader=reader,
    )


def _places(path: Path, header: _Header, request: TableRequest) -> dict[str, int]:
    """Return the places of the columns to be read, by their standard names."""
    standard = [standard_name(name) for name in header.renamed]
    unread = {
        place
        for place, (name, *new) in enumerate(
            zip(header.names, header.renamed, standard, strict=True)
        )
        if not name or {name, *new} & set(request.ignore) or name in request.select
    }
    standard = with_clock(standard, unread, header.preamble, header.mark)
    places: dict[str, int] = {}
    for place, name in enumerate(standard):
        if place in unread:
            continue
        if name in places:
            raise RecordingError(
                f'{path}: two columns have the name {name}: --ignore one of them',
                reason='given_twice',
            )
        places[name] = place
    return places


def _check_places(
    path: Path,
    header: _Header,
    places: Mapping[str, int],
    check_names: Callable[[Collection[str]], object],
) -> None:
    """Check the names; prefer an error about the form of the table."""
    try:
        check_names(places)
    except RecordingError:
        check_no_preamble(path, len(header.names), header.preamble, header.above + 1)
        check_separated(path, header.names)
        ask_about_time(path, places, header.preamble, header.mark)
        raise
    if not places:
        check_no_preamble(path, len(header.names), header.preamble, header.above + 1)


def _selected(
    path: Path, header: _Header, request: TableRequest, rows: Iterable[tuple[int, list[str]]]
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows with the selected texts; RecordingError if there is none."""
    selected = {header.names.index(name): text for name, text in request.select.items()}
    other_values: dict[str, None] = {}
    is_empty = True
    for line, cells in rows:
        if any(cells[place].strip() != text for place, text in selected.items()):
            other_values.update({', '.join(cells[place].strip() for place in selected): None})
            continue
        is_empty = False
        yield line, cells
    if is_empty:
        _no_rows(path, request, list(other_values))


def _check_size(path: Path, rows: int, columns: int) -> None:
    """Reject a table with too many rows or cells."""
    if rows > MOST_ROWS:
        raise RecordingError(
            f'{path} has more than {MOST_ROWS} rows: split it', reason='too_large'
        )
    if rows * columns > MOST_CELLS:
        raise RecordingError(
            f'{path} has more than {MOST_CELLS} cells: split it', reason='too_large'
        )


def _check_decimals(path: Path, line: int, written: str, seen: dict[str, str]) -> None:
    """Reject a mark that is used both for decimals and, apparently, for thousands.

    seen: where each mark was first used for decimals or, apparently, thousands; updated in place.
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
                f'{path}: {seen[one + "thousands"]} seems to have a thousands separator, because '
                f'{seen[other]} has another decimal mark: write numbers without thousands '
                'separators',
                reason='thousands',
            )


def _spelling(path: Path, written: Mapping[str, str]) -> tuple[Note, ...]:
    """Report columns that were read under another name."""
    pairs = [f'{name!r} as {new}' for new, name in written.items() if name != new]
    if not pairs:
        return ()
    shown = list_names(pairs, NAMES_SHOWN)
    return (Note(f'{path}: columns were read {shown}', reason='renamed'),)


def _lines(path: Path, stream: TextIO) -> Iterator[str]:
    """Yield the lines of a file, limited in length."""
    number = 0
    while line := stream.readline(LONGEST_LINE + 1):
        number += 1
        if len(line) > LONGEST_LINE:
            raise RecordingError(
                f'{path}, line {number}: more than {LONGEST_LINE} characters', reason='too_large'
            )
        yield _MONITOR.sub('', line)


def _rows(
    path: Path, header: _Header, cut: bool, left_out: list[str]
) -> Iterator[tuple[int, list[str]]]:
    """Yield rows with one cell per name, with their line numbers; skips empty lines.

    cut: whether the file ends without a newline. left_out: notes on comments and on an incomplete
    last row are appended.
    """
    reader, columns = header.reader, len(header.names)
    comments: list[int] = []
    # Length of the last cell of this row and of the shortest above: a number may be cut off too.
    digits, before, shortest = 0, math.inf, math.inf
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        line = header.above + getattr(reader, 'line_num', 0)
        if cells[0].startswith('# ') or (len(cells) != columns and cells[0].startswith('#')):
            comments.append(line)
        elif len(cells) < columns and cut and next(reader, None) is None:
            left_out.append(
                Note(
                    f'{path}: the last line, {line}, is incomplete and was skipped',
                    reason='cut_off',
                )
            )
        elif len(cells) != columns:
            noun = 'cell' if len(cells) == 1 else 'cells'
            raise RecordingError(
                f'{path}, line {line}: {len(cells)} {noun}, but there are {columns} columns; '
                f'{_RULES[header.mark]}',
                reason='wrong_shape',
            )
        else:
            before, digits = shortest, len(cells[-1].strip())
            shortest = min(shortest, digits)
            yield line, cells
    if cut and 0 < digits < before < math.inf:
        left_out.append(
            Note(
                f'{path}: it ends without a newline, and its last number has fewer digits than '
                'all others: check that it is whole',
                reason='cut_off',
            )
        )
    if comments:
        lines = ', '.join(map(str, comments[:NAMES_SHOWN]))
        more = ', ...' * (len(comments) > NAMES_SHOWN)
        left_out.append(
            Note(
                f'{path}: comment lines among the rows were skipped: line {lines}{more}',
                reason='comments',
            )
        )


def _number(path: Path, line: int, name: str, text: str) -> float:
    if text.lower() in MISSING:
        return math.nan
    try:
        value = math.nan if '_' in text or len(text) > LONGEST_CELL else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        hint = ' (use a decimal point)' if ',' in text else ''
        if name == CLOCK and not hint:
            hint = ' (nor a time such as 10:15:03.12 or 2026-11-22 10:15:03.12)'
        if _APART.fullmatch(text):
            hint = ' (no thousands separators; use a decimal point)'
        if is_unit(text.lstrip('+-.0123456789 ')):
            hint = ' (put the unit into the column name)'
        raise RecordingError(
            f'{path}, line {line}, column {name}: {text[:40]!r} is not a number{hint}; write a '
            'missing value as an empty cell, NA or nan',
            reason='not_a_number',
        )
    return value


def _exact(path: Path, line: int, name: str, text: str) -> Decimal | None:
    try:
        value = None if text.lower() in MISSING else Decimal(text)
    except InvalidOperation as error:  # Decimal accepts every text that float accepts
        raise RecordingError(
            f'{path}, line {line}, column {name}: no number', reason='not_a_number'
        ) from error
    return None if value is None or value.is_nan() else value


def _no_rows(path: Path, request: TableRequest, other_values: list[str]) -> None:
    if not request.select:
        raise RecordingError(f'{path} has no rows below its first line', reason='no_row')
    selection = ', '.join(f'{name}={text}' for name, text in request.select.items())
    more = ', ...' if len(other_values) > NAMES_SHOWN else ''
    raise RecordingError(
        f'{path}: no row has {selection}; there are {"; ".join(other_values[:NAMES_SHOWN])}{more}',
        reason='no_row',
    )

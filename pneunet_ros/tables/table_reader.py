"""A CSV file with units in its column names -> readings in SI, in the base frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, LARGEST
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.printable import list_names
from pneunet_ros.core.stamps import LATEST_STAMP, Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, SI_PER_UNIT, STANDARD_ATMOSPHERE
from pneunet_ros.measurement.meaning.pressure_convention import pressure_unit
from pneunet_ros.measurement.meaning.pressure_judge import air_density, record_of
from pneunet_ros.messages.readings import PRESSURE, Sensor, SENSORS, TARGETS, TIP_POSE
from pneunet_ros.tables.columns import (
    Column,
    columns_of,
    ESTIMATE,
    IN_BASE,
    names_absolute,
    names_no_unit,
    OF_STRINGS,
    STAMP,
    TIME,
)
from pneunet_ros.tables.csv_table import CsvTable, read_csv
from pneunet_ros.tables.header import TableRequest
from pneunet_ros.tables.placeholders import ask_for_placeholders, without_placeholders
from pneunet_ros.tables.reading_table import ReadingTable

MOST_PLACES = 15_000_000  # rows by targets; 650 MB while they are read
# Row spacings of loggers in seconds, for stamps without a unit; the spacing of 1 kHz in ms is 1,
# and that of 1 Hz in days 1.2e-5. Invented.
LARGEST_STEP, SMALLEST_STEP = 1.0, 2e-5
SPREADSHEET_EPOCH = 25_569  # 1970 in the days of spreadsheets, which count from 1899-12-30
SPREADSHEET_END = 73_050  # 2100 in these days
NAMES_SHOWN = 12
FIRST_STAMP = NANOSECONDS_PER_SECOND  # of a table without stamps: 0 means "no stamp" in a header


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportRequest(TableRequest):
    """Request for an import: the columns to read, offsets, placeholders and rate.

    offsets: number to add to a column (by its new name, in its unit). missing: numbers that stand
    for "no reading", for a target or the tip in both coordinates; None: reject a table that seems
    to contain such numbers, with a question. rate: rows per second of a table without time.
    """

    offsets: Mapping[str, float] = field(default_factory=dict)
    missing: tuple[float, ...] | None = None
    rate: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColumnsInSI:
    """The columns of a table by quantity and target, to be read in SI with their offsets.

    lines: line number of each row in the file. numbers: by the new names of the columns.
    """

    path: Path
    lines: tuple[int, ...]
    columns: Mapping[tuple[str, int | None], Column]
    numbers: Mapping[str, Array]
    offsets: Mapping[str, float]

    @property
    def targets(self) -> int:
        """The number of targets, up to the highest id; 0 if no column is of a target."""
        return 1 + max((target for _, target in self.columns if target is not None), default=-1)

    def of(self, quantity: str, target: int | None = None) -> Array:
        """Return a column in SI; all NaN if the column is missing."""
        column = self.columns.get((quantity, target))
        if column is None:
            return np.full(len(self.lines), np.nan)
        with np.errstate(over='ignore'):
            values = self.numbers[column.name] + self.offsets.get(column.name, 0.0)
            values = values * column.si_per_unit
        if np.any(np.abs(values) > LARGEST):
            line = self.lines[int(np.argmax(np.abs(values) > LARGEST))]
            raise RecordingError(
                f'{self.path}, line {line}, column {column.name}: a number beyond {LARGEST:g} in '
                'SI',
                reason='too_large',
            )
        return values


def read_table(path: Path, request: ImportRequest) -> tuple[ReadingTable, tuple[str, ...]]:
    """Return the readings in a table, and notes on ignored columns.

    A cell that is empty or NaN means no reading, or a target that was not seen; a row without any
    target is not a frame. Two string forces become F1, F2 as in the paper: string A pulls along x,
    B along y, each rotated counter-clockwise by its angle, 0 if not given. Raises RecordingError,
    which names the place, or RequestError for offsets and rates that do not fit.
    """
    if request.rate is not None and not 1e-6 <= request.rate <= 1e6:
        raise RequestError(
            f'--rate {request.rate:g} Hz must lie between 1e-6 and 1e6', reason='out_of_bounds'
        )
    times = [STAMP, *(f'{TIME}_{unit}' for unit in SI_PER_UNIT['time'])]
    table = read_csv(path, request, times, lambda names: columns_of(_readings(names), str(path)))
    sentences = [*table.sentences, *_without_readings(path, table)]
    known = columns_of(_readings(table.numbers), str(path))
    if request.missing is None:
        ask_for_placeholders(path, table.numbers, known, table.lines)
    numbers, count = without_placeholders(table.numbers, known, request.missing or ())
    if request.missing:
        shown = ', '.join(f'{value:.12g}' for value in request.missing)
        sentences.append(
            Note(
                f'{path}: {count} readings of {shown} were taken as missing', reason='placeholder'
            )
        )
    _check_offsets(table, request.offsets)
    columns = {(item.quantity, item.target): item for item in known}
    stamp_ns = _stamps(path, table, columns.get((TIME, None)), request)
    in_si = ColumnsInSI(
        path=path, lines=table.lines, columns=columns, numbers=numbers, offsets=request.offsets
    )
    sentences += _check_targets(in_si)
    along_axes = _along_axes(in_si)
    pressure = columns.get((PRESSURE.name, None))
    found = ReadingTable(
        stamp_ns=stamp_ns,
        values={sensor.name: _rows_of(sensor, in_si, along_axes) for sensor in SENSORS},
        pressure_unit='Pa' if pressure is None else pressure_unit(pressure.si_per_unit),
        absolute=pressure is not None and names_absolute(table.written[pressure.name]),
    )
    if not any(found.counts().values()):
        raise RecordingError(
            f'{path} contains no readings: no pressure, no force, no target',
            reason='nothing_usable',
        )
    sentences += _coincident(path, table.lines, found.values[TARGETS.name])
    sentences += _report_lost_turns(path, table.lines, found)
    if pressure is not None and found.absolute and np.isfinite(found.values[PRESSURE.name]).any():
        sentences.append(_absolute(table.written[pressure.name], found))
    return found, tuple(sentences)


def _without_readings(path: Path, table: CsvTable) -> list[Note]:
    """Report columns that are not readings or have no number."""
    names, notes = _readings(table.numbers), []
    if len(names) + (STAMP in table.numbers) < len(table.numbers):
        notes.append(
            Note(
                f'{path}: columns {ESTIMATE}... are not readings and were ignored',
                reason='estimates',
            )
        )
    empty = [name for name in names if np.all(np.isnan(table.numbers[name]))]
    if empty:
        shown = list_names(empty, NAMES_SHOWN)
        notes.append(Note(f'{path}: no row has a number in {shown}', reason='no_number'))
    return notes


def _check_offsets(table: CsvTable, offsets: Mapping[str, float]) -> None:
    """Reject an offset of a column that was not read, and an offset that is not a number."""
    for name, offset in offsets.items():
        if name not in table.numbers or name == STAMP:
            raise RequestError(
                f'--offset {name}=: no such column was read', reason='unknown_column'
            )
        if not math.isfinite(offset):
            raise RequestError(f'--offset {name}={offset} is not a number', reason='not_a_number')


def _check_targets(in_si: ColumnsInSI) -> list[Note]:
    """Reject more target positions than can be read; report that target 0 has no columns."""
    targets, rows = in_si.targets, len(in_si.lines)
    if targets * rows > MOST_PLACES:
        raise RecordingError(
            f'{in_si.path} has ids up to {targets - 1} in {rows} rows: split it, because at '
            f'most {MOST_PLACES} target positions can be read',
            reason='too_large',
        )
    if not targets or any(target == 0 for _, target in in_si.columns):
        return []
    return [
        Note(
            f'{in_si.path}: target 0 has no columns. Targets are numbered from 0 at the clamp: '
            'are these numbered from 1?',
            reason='no_clamp_target',
        )
    ]


def _along_axes(in_si: ColumnsInSI) -> dict[str, Array]:
    """Return F1, F2 (N) of string forces by column name; empty if no column has one."""
    if not any((name, None) in in_si.columns for name in OF_STRINGS):
        return {}
    zero = np.zeros(len(in_si.lines))
    strings = [in_si.of(name) if (name, None) in in_si.columns else zero for name in OF_STRINGS]
    return dict(zip(IN_BASE, string_force(*strings), strict=True))


def _rows_of(sensor: Sensor[Any], in_si: ColumnsInSI, along_axes: Mapping[str, Array]) -> Array:
    """Return the rows of a sensor; a component without a column is 0, NaN without any column.

    A missing component that is optional is NaN.
    """
    names, rows = [item.name for item in sensor.components], len(in_si.lines)
    if sensor.per_target:
        values = [[in_si.of(name, target) for target in range(in_si.targets)] for name in names]
        return np.array(values).reshape(len(names), in_si.targets, rows).transpose(2, 0, 1)
    given = {name for name in names if name in along_axes or (name, None) in in_si.columns}
    if not given:
        return np.full((rows, len(names)), np.nan)
    parts = [
        along_axes.get(item.name, in_si.of(item.name))
        if item.name in given
        else np.full(rows, np.nan if item.optional else 0.0)
        for item in sensor.components
    ]
    return np.stack(parts, axis=1)


def _coincident(path: Path, lines: Sequence[int], targets: Array) -> list[str]:
    """Report targets at exactly the same position, a sign of targets that were not detected.

    targets: (rows, 2, targets) m.
    """
    places = np.sort(targets[:, 0] + 1j * targets[:, 1], axis=1)
    is_same = places[:, 1:] == places[:, :-1]
    rows = np.flatnonzero(is_same.any(axis=1))
    if not rows.size:
        return []
    place = places[rows[0], int(np.argmax(is_same[rows[0]]))]
    return [
        Note(
            f'{path}: in {rows.size} of {len(lines)} rows several targets have the same position, '
            f'({place.real:.4g}, {place.imag:.4g}) m in line {lines[rows[0]]}: leave the cells of '
            'targets that were not seen empty',
            reason='coincident',
        )
    ]


def _report_lost_turns(path: Path, lines: Sequence[int], table: ReadingTable) -> list[str]:
    """Report headings that lose whole turns in a recording of poses.

    `calibrate` restores those that follow from heading to heading, in the order of the pressure.
    """
    pressure, heading = table.values[PRESSURE.name][:, 0], table.values[TIP_POSE.name][:, 2]
    rows, read = np.flatnonzero(np.isfinite(heading)), np.isfinite(pressure)
    if not rows.size:
        return []
    if read.any():
        at_rows = np.interp(table.stamp_ns[rows], table.stamp_ns[read], pressure[read])
        rows = rows[np.argsort(at_rows, kind='stable')]
    recorded = np.angle(np.exp(1j * heading))
    restored = np.array(heading)
    restored[rows] = np.unwrap(recorded[rows])
    is_lost = (np.abs(heading) > math.pi) & (np.abs(restored - heading) > math.pi)
    if not is_lost.any():
        return []
    row = int(np.argmax(is_lost))
    return [
        Note(
            f'{path}: {np.count_nonzero(is_lost)} headings lose whole turns, because a recording '
            f'holds poses: line {lines[row]} has {math.degrees(heading[row]):.6g} degrees, '
            f'recorded as {math.degrees(recorded[row]):.4g}. In a calibration they must be within '
            'half a turn at the lowest pressure, and change by less from one pressure to the next',
            reason='lost_turns',
        )
    ]


def _absolute(column: str, table: ReadingTable) -> Note:
    """Describe the options of other verbs for absolute pressure."""
    pressure = table.values[PRESSURE.name][:, 0]
    kept = np.isfinite(pressure)
    record = record_of(table.stamp_ns[kept].tolist(), pressure[kept].tolist())
    vented = min(record.low, record.high, key=lambda end: abs(end - STANDARD_ATMOSPHERE))
    if not air_density(vented):
        return Note(
            f'{column!r} is an absolute pressure by its name, but none of its readings can be '
            f'atmospheric pressure (nearest: {vented:.4g} Pa). If it is gauge pressure or has '
            'another unit, use --rename; if the arm was never vented, add --pressure-reference '
            'absolute and --ambient-pressure with the atmospheric pressure in Pa',
            reason='absolute',
        )
    return Note(
        f'{column!r} is an absolute pressure: add --pressure-reference absolute '
        f'--ambient-pressure {vented:.0f} to every command that reads the recording (its reading '
        'nearest to the standard atmosphere, in Pa; if the arm was never vented, give the '
        'atmospheric pressure instead)',
        reason='absolute',
    )


def string_force(
    force_a: npt.ArrayLike, angle_a: npt.ArrayLike, force_b: npt.ArrayLike, angle_b: npt.ArrayLike
) -> tuple[Array, Array]:
    """Return F1, F2 (N) of two strings that pull at the free end.

    At angle 0, string A pulls along x and string B along y; angles (rad) rotate them from there,
    counter-clockwise about z, as the paper's strings rotate when the end moves.
    """
    a, b = np.asarray(force_a), np.asarray(force_b)
    return (a * np.cos(angle_a) - b * np.sin(angle_b), a * np.sin(angle_a) + b * np.cos(angle_b))


def _readings(names: Iterable[str]) -> list[str]:
    """Return the columns other than stamps and estimator outputs."""
    return [name for name in names if name != STAMP and not name.startswith(ESTIMATE)]


def _stamps(path: Path, table: CsvTable, time: Column | None, request: ImportRequest) -> Stamps:
    """Return the stamps of the rows, read or computed from time or rate, at least 1 s."""
    rows = len(table.lines)
    given: list[Decimal | None]
    offset = Decimal(0)
    if STAMP in table.exact:
        name, given = STAMP, list(table.exact[STAMP])
    elif time is not None:
        name, offset = time.name, Decimal(repr(request.offsets.get(time.name, 0.0)))
        _check_unnamed_unit(path, table, time)
        offset -= _spreadsheet_epoch(table, time)
        scale = Decimal(repr(time.si_per_unit)) * NANOSECONDS_PER_SECOND
        given = [None if t is None else (t + offset) * scale for t in table.exact[name]]
    elif request.rate is not None:
        period = NANOSECONDS_PER_SECOND / Decimal(repr(request.rate))
        name, given = '--rate', [row * period for row in range(rows)]
    else:
        raise RequestError(
            f'{path} has no time: no column {STAMP} or {TIME}_s; give --rate HZ, rows per second',
            reason='no_time',
        )
    if request.rate is not None and name != '--rate':
        written = table.written.get(name, name)
        raise RequestError(
            f'{path} has the column {name}: omit --rate, or --ignore {written}', reason='exclusive'
        )
    stamps: list[int] = []
    shift = 0
    for line, value in zip(table.lines, given, strict=True):
        where = f'{path}, line {line}, column {name}'
        if value is None:
            raise RecordingError(f'{where}: the time is missing', reason='no_time')
        stamp_ns = round(value)
        if not stamps and name != STAMP and stamp_ns <= 0:
            shift = FIRST_STAMP - stamp_ns
        stamp_ns += shift
        if not 0 < stamp_ns < LATEST_STAMP:
            unit = '; is it in a smaller unit, such as time_ms or time_us?' if value > 0 else ''
            seconds = float(value) / NANOSECONDS_PER_SECOND
            shown = f'{value} ns' if name == STAMP else f'{seconds:.13g} s'
            raise RecordingError(
                f'{where}: {shown} is not a valid time stamp{unit * (name != STAMP)}',
                reason='no_time',
            )
        if stamps and stamp_ns == stamps[-1]:
            remedy = (
                f'import --ignore {table.written.get(name, name)} --rate HZ counts rows instead'
            )
            raise RecordingError(
                f'{where}: time must increase from row to row, but this row has the same time as '
                f'the one above (are fractions of a second missing? {remedy})',
                reason='not_increasing',
            )
        if stamps and stamp_ns < stamps[-1]:
            raise RecordingError(
                f'{where}: time must increase from row to row, but this row is earlier than the '
                'one above: sort the rows by time, or split the table where the clock was set '
                'back',
                reason='not_increasing',
            )
        stamps.append(stamp_ns)
    return np.array(stamps, dtype=np.int64)


def _check_unnamed_unit(path: Path, table: CsvTable, time: Column) -> None:
    """Reject a time whose name has no unit and whose values are implausible as seconds."""
    written = table.written[time.name]
    if table.clock or not names_no_unit(written):
        return
    times = table.numbers[time.name]
    steps = np.abs(np.diff(times[np.isfinite(times)]))
    steps = steps[steps > 0.0]  # repeated or decreasing times are rejected with their line
    step = float(np.median(steps)) if steps.size else 0.1
    start, end = (times[0], times[-1]) if times.size else (0.0, 0.0)
    serial = SPREADSHEET_EPOCH < start < SPREADSHEET_END and 0.0 <= end - start < 1.0
    if SMALLEST_STEP <= step < LARGEST_STEP and not serial:
        return
    named = written if not any(mark.isspace() for mark in written) else f'"{written}"'
    if serial:
        raise RecordingError(
            f'{path}: the column {written!r} has no unit, and its {times.size} rows go from '
            f'{start:.12g} to {end:.12g}, which may be the days of a spreadsheet. Name the unit: '
            f'--rename {named}=time_d for days, {named}=time_s for seconds',
            reason='no_unit',
        )
    choices = 'time_ms for milliseconds' if step >= LARGEST_STEP else 'time_d for days (Excel)'
    raise RecordingError(
        f'{path}: the column {written!r} has no unit, and its rows are {step:.3g} apart '
        f'(median), which is unusual for seconds. Name the unit: --rename {named}={choices}, '
        f'{named}=time_s for seconds',
        reason='no_unit',
    )


def _spreadsheet_epoch(table: CsvTable, time: Column) -> int:
    """Return the epoch (days) to subtract: that of spreadsheets if the values are large enough."""
    first = next((value for value in table.exact[time.name] if value is not None), Decimal(0))
    days = time.si_per_unit == SI_PER_UNIT['time']['d']
    return SPREADSHEET_EPOCH if days and first >= SPREADSHEET_EPOCH else 0

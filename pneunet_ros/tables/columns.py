"""Names of table columns: the quantity, its target, and its unit."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from difflib import get_close_matches
import re
import shlex

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.messages.readings import SENSORS

STAMP = 'stamp_ns'
TIME = 'time'
ESTIMATE = 'estimate_'  # prefix of the columns with estimates
MOST_TARGETS = 500
_NAMES_SHOWN = 12
KNOWN_NAMES = '`pneunet import --help` lists them'

IN_BASE = ('force_x', 'force_y')
OF_STRINGS = ('force_a', 'angle_a', 'force_b', 'angle_b')
# Components of a sensor with values per target, each with all others that must accompany it.
TOGETHER = {
    item.name: tuple(other.name for other in sensor.components)
    for sensor in SENSORS
    if sensor.per_target
    for item in sensor.components
}
_KINDS = {item.name: item.kind for sensor in SENSORS for item in sensor.components}
# Possible columns and the kind of their unit; those of TOGETHER carry the index of a target.
KINDS = {
    TIME: 'time',
    **{name: kind for name, kind in _KINDS.items() if name not in TOGETHER},
    **{name: name.partition('_')[0] for name in OF_STRINGS},
    **{name: _KINDS[name] for name in TOGETHER},
}
_TARGET = re.compile(r'(.+?)(\d{1,3})')
_BETWEEN_WORDS = re.compile(r'[\s_.,/*·()\[\]-]+')
_OUTER = re.compile(r'[\[(](.*)[\])]')  # brackets around the whole: [kPa], but bar(a)
# Units of pressure that people write as two words: mm Hg, kgf/cm2 (a technical atmosphere).
_TWO_WORDS = (
    (re.compile(r'(?<![^_])(mm|cm|in)_(hg|h2o)(?![^_])'), r'\1\2'),
    (re.compile(r'(?<![^_])kgf?_cm2(?![^_])'), 'at'),
)
_ABSOLUTE = ('a', 'abs', 'absolute')  # the reference of a pressure: psia, bar(a), P abs [kPa]
_REFERENCES = ('g', 'gauge', *_ABSOLUTE)
_IN_WORDS = ('gauge', 'abs', 'absolute')  # before a unit, where an `a` may name a chamber
_UNIT_SPELLINGS = {
    'nm': 'n_m',
    'mnm': 'mn_m',
    'nmm': 'n_mm',
    'sec': 's',
    'seconds': 's',
    'msec': 'ms',
    'millis': 'ms',
    'milliseconds': 'ms',
    'micros': 'us',
    'microseconds': 'us',
    'minutes': 'min',
    'hours': 'h',
    'days': 'd',
    'inch': 'in',
    'inches': 'in',
}
_LETTERS = {
    ord('µ'): 'u',
    ord('μ'): 'u',
    ord('°'): 'deg',
    ord('²'): '2',
    ord('₂'): '2',
    ord('^'): '',
    ord('″'): 'in',
}
_UNITS = {'ns', *(unit for units in SI_PER_UNIT.values() for unit in units)}
# Endings of the column names in tables of ROS messages, for any topic.
_OF_MESSAGES = {
    'fluid_pressure': 'pressure_pa',
    'force_x': 'force_x_n',
    'force_y': 'force_y_n',
    'torque_z': 'moment_n_m',
}
# Units that imply the quantity, used as column names by Arduino sketches; `at` and `atm` may also
# be a time and the pressure of the air.
_BARE = {
    **{unit: f'{TIME}_{unit}' for unit in ('s', 'ms', 'us')},
    **{unit: f'pressure_{unit}' for unit in SI_PER_UNIT['pressure'].keys() - {'at', 'atm'}},
}
_PREPOSITIONS = ('at',)
# Other names of a time or a pressure, made unambiguous by the unit.
_UNMISTAKABLE = {'t': TIME, 'elapsed': TIME, 'timestamp': TIME, 'p': 'pressure'}
# Other names of a quantity, used only for suggestions: a single letter is ambiguous.
_OTHER_WORDS = {
    't': TIME,
    'timestamp': TIME,
    'datetime': TIME,
    'date_time': TIME,
    'p': 'pressure',
    'fx': 'force_x',
    'f1': 'force_x',
    'fy': 'force_y',
    'f2': 'force_y',
    'm': 'moment',
    'mz': 'moment',
    'angle': 'tip_heading',  # not the angle of a string, which loggers rarely record
    'bending_angle': 'tip_heading',
    'theta': 'tip_heading',
    # of other languages
    **dict.fromkeys(('winkel', 'ángulo', 'angulo', 'angolo', 'hoek', '角度'), 'tip_heading'),
    **dict.fromkeys(('zeit', 'temps', 'tiempo', 'tempo', 'tijd', '时间', '時間'), TIME),
    **dict.fromkeys(('druck', 'pression', 'presión', 'presion', 'pressione', 'druk'), 'pressure'),
    **dict.fromkeys(('压力', '圧力'), 'pressure'),
}
# Units of uncalibrated sensors: not units of a quantity.
_RAW = ('v', 'volt', 'volts', 'mv', 'adc', 'raw', 'count', 'counts', 'analog')
_OF_SENSOR = frozenset({'pressure', 'press', 'p', 'sensor', 'adc', 'raw', 'analog'})


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of numbers: its name, its kind (in KINDS), its target, and SI units per unit."""

    name: str
    quantity: str
    si_per_unit: float
    target: int | None = None


def column_of(name: str) -> Column | None:
    """Parse the name of a column, such as 'x3_mm'; None for an unknown name."""
    for quantity, kind in KINDS.items():
        for unit, si_per_unit in SI_PER_UNIT[kind].items():
            if not name.endswith(f'_{unit}'):
                continue
            head = name.removesuffix(f'_{unit}')
            match = _TARGET.fullmatch(head)
            if quantity in TOGETHER and match and match[1] == quantity:
                return Column(
                    name=name, quantity=quantity, si_per_unit=si_per_unit, target=int(match[2])
                )
            if quantity not in TOGETHER and head == quantity:
                return Column(name=name, quantity=quantity, si_per_unit=si_per_unit)
    return None


def standard_name(name: str) -> str:
    """Return the standard form of a name: pressure_kpa for 'Pressure [kPa]', time_s for 'Time'.

    Case, spaces and the brackets of a unit are ignored; an unknown name is returned unchanged.
    """
    plain = _plain(name)
    if plain == TIME:
        return f'{TIME}_s'
    return plain if _is_known(plain) else name


def is_known(name: str) -> bool:
    """Whether a column name is recognized in any spelling, even if the column is then ignored."""
    return _is_known(_plain(name))


def _is_known(plain: str) -> bool:
    return plain in (TIME, STAMP) or plain.startswith(ESTIMATE) or column_of(plain) is not None


def names_no_unit(name: str) -> bool:
    """Whether a name stands for a time without a unit: 'Time'."""
    return _plain(name) == TIME


def names_absolute(name: str) -> bool:
    """Whether a name stands for an absolute pressure: 'psia', 'P abs [kPa]'."""
    return _without_reference(_words(name))[1] in _ABSOLUTE


def _words(name: str) -> list[str]:
    """Return the words of a name in lower case, a unit as one word."""
    plain = _BETWEEN_WORDS.sub('_', name.strip().lower().translate(_LETTERS)).strip('_')
    for written, one in _TWO_WORDS:
        plain = written.sub(one, plain)
    return plain.split('_')


def _without_reference(words: list[str]) -> tuple[list[str], str]:
    """Separate the words for a pressure from the words for its reference, '' if there are none."""
    *head, last = words
    units = SI_PER_UNIT['pressure']
    if last not in units and last[:-1] in units and last[-1] in 'ag':
        return [*head, last[:-1]], last[-1]
    if last in _REFERENCES and head and head[-1] in units:
        return head, last
    named = [word for word in head if word in _IN_WORDS] if last in units else []
    return [word for word in words if word not in named], ''.join(named[:1])


def _plain(name: str) -> str:
    words, _ = _without_reference(_words(name))
    plain = '_'.join(words)
    head, _, unit = plain.rpartition('_')
    unit = _UNIT_SPELLINGS.get(unit, unit)
    quantity = _UNMISTAKABLE.get(head, '')
    if unit in SI_PER_UNIT.get(quantity, ()):
        return f'{quantity}_{unit}'
    if not head and unit in _BARE:
        return _BARE[unit]
    return f'{head}_{unit}' if head else unit


def is_unit(text: str) -> bool:
    """Whether a text is a unit that a column may have: 'kPa', '[mm]', 'N m'."""
    return _unit(text) in _UNITS


def with_unit(name: str, text: str) -> str:
    """Append the unit from the line below to a column name, unless it has one."""
    unit = _unit(text)
    if not unit:
        return name
    if _plain(name).endswith(f'_{unit}'):
        reference = _without_reference(_words(text))[1]
        words = _without_reference(_words(name))[1]
        return f'{name} {reference}' if reference and not words else name
    return f'{name} [{_inner(text)}]'


def _inner(text: str) -> str:
    outer = _OUTER.fullmatch(text.strip())
    return outer[1].strip() if outer else text.strip()


def _unit(text: str) -> str:
    """Convert a unit to the suffix of column names: 'n_mm' for '[N mm]', '' for '-'."""
    return _plain(f'of [{text.strip("[]() ")}]').removeprefix('of').strip('_')


def likely_name(name: str) -> str:
    """Return the known name closest to an unknown one; '' if there is none."""
    plain = _plain(name)
    for end, known_name in _OF_MESSAGES.items():
        if plain not in KINDS and f'_{plain}'.endswith(f'_{end}'):
            return known_name
    for quantity in KINDS.keys() - TOGETHER.keys():  # of a longer name: elapsed_time_s
        _, within, after = f'_{plain}'.rpartition(f'_{quantity}_')
        first, _, further = after.partition('_')  # PT-101 pressure kPa(g) 2, pressure at tip kPa
        for unit in (after, further.rpartition('_')[2], '' if first in _PREPOSITIONS else first):
            if within and unit in SI_PER_UNIT[KINDS[quantity]]:
                return f'{quantity}_{unit}'
    head, _, unit = plain.rpartition('_')
    for other, quantity in _OTHER_WORDS.items():
        if head == other and unit in SI_PER_UNIT[KINDS[quantity]]:
            return f'{quantity}_{unit}'
    quantity = _OTHER_WORDS.get(plain, head if head in KINDS else plain)
    if quantity in KINDS and quantity not in TOGETHER:
        return f'{quantity}_({"|".join(SI_PER_UNIT[KINDS[quantity]])})'
    target = ''.join(filter(str.isdigit, plain)) or '0'
    known = [
        f'{quantity}{target if quantity in TOGETHER else ""}_{unit}'
        for quantity, kind in KINDS.items()
        for unit in SI_PER_UNIT[kind]
    ]
    same_unit = [known_name for known_name in known if known_name.endswith(f'_{unit}')]
    closest = next(iter(get_close_matches(plain, same_unit, 1, 0.75)), '')
    if not closest and unit in SI_PER_UNIT['pressure'] and _without_reference(_words(name))[1]:
        closest = f'pressure_{unit}'  # `at` with its reference is not a word: ata
    return closest or _BARE.get(unit, '')  # a quantity in any language: nyomás [kPa]


def is_raw(name: str) -> bool:
    """Whether a name stands for volts or counts of a sensor: 'pressure_V', 'ADC', 'raw'.

    Volts and counts of other things, e.g. 'battery_V' or 'frame_count', are excluded.
    """
    *before, last = _words(name)
    return last in _RAW and (not before or not _OF_SENSOR.isdisjoint([*before, last]))


def known_names() -> str:
    """Return the patterns of all known names, for messages."""
    patterns = [STAMP]
    for quantity, kind in KINDS.items():
        target = '<target>' if quantity in TOGETHER else ''
        units = '|'.join(SI_PER_UNIT[kind])
        patterns.append(f'{quantity}{target}_({units})')
    return ', '.join(patterns)


def columns_of(names: Iterable[str], where: str) -> list[Column]:
    """Parse the names of columns; raises RecordingError if they are inconsistent.

    Inconsistent are unknown names (all are listed), a repeated quantity, a target with only one
    coordinate, an angle without its string, and end forces given both as components and by
    strings.
    """
    columns: dict[tuple[str, int | None], Column] = {}
    unknown: list[str] = []
    for name in names:
        column = column_of(name)
        if column is None:
            unknown.append(name)
            continue
        key = column.quantity, column.target
        if key in columns:
            raise RecordingError(
                f'{where}: {columns[key].name} and {name} measure the same quantity: --ignore one '
                'of them',
                reason='given_twice',
            )
        columns[key] = column
    if unknown:
        present = {column.quantity for column in columns.values()}
        raw = [name for name in unknown if is_raw(name)]
        not_raw = [name for name in unknown if name not in raw]
        named = any(_quantity(likely_name(name)) == 'pressure' for name in not_raw)
        if raw and not named and 'pressure' not in present:
            raise RecordingError(
                f'{where}: {", ".join(map(repr, raw[:_NAMES_SHOWN]))} seems to be a raw signal, '
                'not a pressure. Convert it to a column such as pressure_kpa with the data sheet '
                'of the sensor (pressure = slope x signal + offset), and drop the raw '
                'column with --ignore',
                reason='raw_signal',
            )
        raise RecordingError(
            f'{where}: {_unknown_columns(unknown, present)}', reason='unknown_column'
        )
    _check_whole({key: column.name for key, column in columns.items()}, where)
    return list(columns.values())


def _unknown_columns(names: list[str], present: Collection[str]) -> str:
    """Name all unknown columns, and the options to use.

    present: the quantities that known columns already provide.
    """
    likely = {
        name: '' if _quantity(known) in present else known
        for name in names[:_NAMES_SHOWN]
        for known in [likely_name(name)]
    }
    shown = ', '.join(
        f'{name!r} ({meant}?)' if meant else repr(name) for name, meant in likely.items()
    )
    more = f' and {len(names) - _NAMES_SHOWN} more' if len(names) > _NAMES_SHOWN else ''
    noun, verb = ('column', 'is') if len(names) == 1 else ('columns', 'are')
    # If there are several units, a placeholder stands for the one to choose.
    meant = [
        f'{name}={_one_unit(known)}{"_abs" * names_absolute(name)}'
        for name, known in likely.items()
        if known
    ]
    options = [f'--rename {shlex.join(meant)}'] * bool(meant)
    unlike = [name for name, known in likely.items() if not known]
    options += [f'--ignore {shlex.join(unlike)}'] * bool(unlike)
    sentence = f'the {noun} {shown}{more} {verb} not known: add {" ".join(options)}'
    if any('UNIT' in word for word in meant):
        sentence += ', replacing UNIT with the unit'
    if unlike:
        sentence += f', or --rename OLD=NEW to a known name ({KNOWN_NAMES})'
    return sentence


def _quantity(pattern: str) -> str:
    """Return the quantity of a name or pattern: pressure_kpa, pressure_(pa|kpa)."""
    head, several, _ = pattern.partition('_(')
    column = None if several else column_of(pattern)
    return head if column is None else column.quantity


def _one_unit(pattern: str) -> str:
    """Return a known name with UNIT in place of several units: pressure_(pa|kpa)."""
    head, several, _ = pattern.partition('_(')
    return f'{head}_UNIT' if several else pattern


def _check_whole(names: dict[tuple[str, int | None], str], where: str) -> None:
    quantities = {quantity for quantity, _ in names}
    for (quantity, target), name in names.items():
        for other in TOGETHER.get(quantity, ()):
            if (other, target) not in names:
                raise RecordingError(
                    f'{where}: {name} has no matching column {other}{target}_UNIT',
                    reason='missing_column',
                )
        if target is not None and target >= MOST_TARGETS:
            raise RecordingError(
                f'{where}: {name}: at most {MOST_TARGETS} targets are possible', reason='too_large'
            )
        if quantity.startswith('angle') and f'force{quantity[5:]}' not in quantities:
            raise RecordingError(
                f'{where}: {name} has no matching column force{quantity[5:]}_UNIT',
                reason='missing_column',
            )
        if quantity == 'imu_wz' and not quantities & {'imu_ax', 'imu_ay', 'imu_az'}:
            raise RecordingError(
                f'{where}: {name} has no matching columns imu_ax_UNIT, imu_ay_UNIT, imu_az_UNIT',
                reason='missing_column',
            )
    if quantities & set(IN_BASE) and quantities & set(OF_STRINGS):
        raise RecordingError(
            f'{where}: the end force is given both along the axes (force_x, force_y) and by '
            'strings (force_a, force_b): --ignore one of them',
            reason='given_twice',
        )

"""Names of table columns: what is measured, of which target, and in which unit."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import re

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.messages.readings import SENSORS

STAMP = 'stamp_ns'
TIME = 'time'
ESTIMATE = 'estimate_'  # begins the columns of what the estimator made of readings
MOST_TARGETS = 500

IN_BASE = ('force_x', 'force_y')
OF_STRINGS = ('force_a', 'angle_a', 'force_b', 'angle_b')
# What a sensor gives for each target, and all of its components, which come together.
TOGETHER = {
    item.name: tuple(other.name for other in sensor.components)
    for sensor in SENSORS
    if sensor.per_target
    for item in sensor.components
}
_KINDS = {item.name: item.kind for sensor in SENSORS for item in sensor.components}
# What a table may hold, and the kind of its unit; those of TOGETHER carry the index of a target.
KINDS = {
    TIME: 'time',
    **{name: kind for name, kind in _KINDS.items() if name not in TOGETHER},
    **{name: name.partition('_')[0] for name in OF_STRINGS},
    **{name: _KINDS[name] for name in TOGETHER},
}
_TARGET = re.compile(r'(.+?)(\d{1,3})')


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of numbers: its name, what it is in KINDS, its target, and SI units per unit."""

    name: str
    quantity: str
    si_per_unit: float
    target: int | None = None


def column_of(name: str) -> Column | None:
    """Return what a column is by its name, such as 'x3_mm'; None for an unknown name."""
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


def known_names() -> str:
    """Return the patterns of all known names, for a person."""
    patterns = [STAMP]
    for quantity, kind in KINDS.items():
        target = '<target>' if quantity in TOGETHER else ''
        units = '|'.join(SI_PER_UNIT[kind])
        patterns.append(f'{quantity}{target}_({units})')
    return ', '.join(patterns)


def columns_of(names: Iterable[str], where: str) -> list[Column]:
    """Return what these columns are; raises RecordingError where they make no whole.

    Unknown names, one quantity twice, a target without its other coordinate, an angle without its
    string, and end forces both resolved and by strings are refused.
    """
    columns: dict[tuple[str, int | None], Column] = {}
    for name in names:
        column = column_of(name)
        if column is None:
            raise RecordingError(
                f'{where}: the column {name!r} is not known; rename it (--rename OLD=NEW) or '
                f'leave it out (--ignore COLUMN); known are {known_names()}'
            )
        key = column.quantity, column.target
        if key in columns:
            raise RecordingError(
                f'{where}: {columns[key].name} and {name} say the same: --ignore one of them'
            )
        columns[key] = column
    _check_whole({key: column.name for key, column in columns.items()}, where)
    return list(columns.values())


def _check_whole(names: dict[tuple[str, int | None], str], where: str) -> None:
    quantities = {quantity for quantity, _ in names}
    for (quantity, target), name in names.items():
        for other in TOGETHER.get(quantity, ()):
            if (other, target) not in names:
                raise RecordingError(f'{where}: {name} is there without its {other}{target}')
        if target is not None and target >= MOST_TARGETS:
            raise RecordingError(f'{where}: {name}: at most {MOST_TARGETS} targets are read')
        if quantity.startswith('angle') and f'force{quantity[5:]}' not in quantities:
            raise RecordingError(f'{where}: {name} is there without force{quantity[5:]}')
    if quantities & set(IN_BASE) and quantities & set(OF_STRINGS):
        raise RecordingError(
            f'{where}: the end force is given both along the axes (force_x, force_y) and by '
            'strings (force_a, force_b): --ignore one of them'
        )

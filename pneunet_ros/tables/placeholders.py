"""Numbers that stand for "no reading" in tables of loggers and trackers: 0, -1, 9999."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.tables.columns import Column, TIME, TOGETHER

# Written for missing values by trackers (OpenCV, AprilTag, motion capture) and loggers: decimal
# nines, minus one, and the limits of 16 and 32 bits.
PLACEHOLDERS = (
    0.0, -1.0, 999.0, -999.0, 9999.0, -9999.0, 99999.0, -99999.0, 32767.0, -32768.0, 65535.0,
    2147483647.0, -2147483648.0, 4294967295.0,
)  # fmt: skip
NUMBERS_SHOWN = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Columns that form one reading: a target, the tip, or a single column.

    deciding: the columns whose values decide; names: all columns, which then become empty. zero:
    whether 0 can stand for "no reading"; 0 may also be a sensor at rest, or the clamp.
    """

    label: str
    deciding: tuple[str, ...]
    names: tuple[str, ...]
    zero: bool = False

    def rows(self, numbers: Mapping[str, Array], value: float) -> npt.NDArray[np.bool_]:
        """Return the rows in which this number means "no reading", (rows,)."""
        if value == 0.0 and not self.zero:
            return np.zeros(numbers[self.names[0]].size, dtype=bool)
        return np.asarray(np.all([numbers[name] == value for name in self.deciding], axis=0))


def without_placeholders(
    numbers: Mapping[str, Array], columns: Sequence[Column], missing: Collection[float]
) -> tuple[dict[str, Array], int]:
    """Replace these placeholder numbers by NaN; returns the columns and the number replaced."""
    changed = {name: np.array(values) for name, values in numbers.items()}
    count = 0
    for place in places_of(columns, numbers):
        for value in missing:
            rows = place.rows(numbers, value)
            count += int(np.count_nonzero(rows))
            for name in place.names:
                changed[name][rows] = np.nan
    return {name: freeze(values) for name, values in changed.items()}, count


def ask_for_placeholders(
    path: object, numbers: Mapping[str, Array], columns: Sequence[Column], lines: Sequence[int]
) -> None:
    """Reject a table with numbers that seem to mean "no reading", and name the option to use.

    A placeholder occurs in some rows only. In a pair of coordinates, it is unambiguous; a single
    number must be far from all others in its column.
    """
    for place in places_of(columns, numbers):
        found = [value for value in PLACEHOLDERS if _stands_for_nothing(place, numbers, value)]
        if not found:
            continue
        rows = place.rows(numbers, found[0])
        shown = ', '.join(f'{found[0]:.12g}' for _ in place.deciding)
        values = ' '.join(f'{value:.12g}' for value in found[:NUMBERS_SHOWN])
        raise RecordingError(
            f'{path}: {place.label} is ({shown}) in {np.count_nonzero(rows)} of {len(lines)} '
            f'rows, first in line {lines[int(np.argmax(rows))]}: if that means "no reading", add '
            f'--missing {values}; if it was measured, add --missing none',
            reason='placeholder',
        )


def places_of(columns: Sequence[Column], numbers: Mapping[str, Array]) -> Iterator[Place]:
    """Yield groups of columns that form one reading each.

    Target 0 may be painted at the clamp, which is (0, 0): there 0 is no placeholder.
    """
    names = {(column.quantity, column.target): column.name for column in columns}
    for target in sorted({column.target for column in columns if column.target is not None}):
        components = tuple(names[quantity, target] for quantity in TOGETHER)
        zero = target != 0 or any(_is_apart(numbers[name]) for name in components)
        yield Place(label=f'target {target}', deciding=components, names=components, zero=zero)
    tip = tuple(names[name, None] for name in ('tip_x', 'tip_y') if (name, None) in names)
    heading = tuple(names[name, None] for name in ('tip_heading',) if (name, None) in names)
    if len(tip) == 2:
        yield Place(label='the tip', deciding=tip, names=(*tip, *heading), zero=True)
    for column in columns:
        if column.target is None and column.quantity != TIME:
            yield Place(label=column.name, deciding=(column.name,), names=(column.name,))


def _stands_for_nothing(place: Place, numbers: Mapping[str, Array], value: float) -> bool:
    """Whether a number seems to mean "no reading" in these columns."""
    rows = place.rows(numbers, value)
    if not rows.any():
        return False
    known = np.all([np.isfinite(numbers[name]) for name in place.deciding], axis=0)
    other_rows = known & ~rows
    if len(place.deciding) > 1:
        return bool(other_rows.any())
    rest = numbers[place.deciding[0]][other_rows]
    if value == -1.0:  # too close to readings of zero to be detected by size
        whole = np.all(rest == np.round(rest))
        return bool(rest.size > 1 and np.min(rest) >= 0.0 and rows.sum() > 1 and not whole)
    return _is_far(rest, value)


def _is_apart(numbers: Array) -> bool:
    """Whether zeros are far from the other numbers, and not one of a few rounded values."""
    steps = np.diff(np.unique(numbers[np.isfinite(numbers) & (numbers != 0.0)]))
    return steps.size > 0 and _is_far(numbers, 0.0)


def _is_far(numbers: Array, value: float) -> bool:
    """Whether a value is far outside of the other numbers, of which there must be two."""
    rest = numbers[np.isfinite(numbers) & (numbers != value)]
    if rest.size < 2:
        return False
    low, high = float(np.min(rest)), float(np.max(rest))
    return not low - (high - low) <= value <= high + (high - low)

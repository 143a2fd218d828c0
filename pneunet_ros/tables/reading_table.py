"""Readings as a table with a row per stamp, for converting from and to recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import are_numbers, Array, frozen_array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.unit_system import SI, UnitSystem
from pneunet_ros.core.units import seconds_since, SI_PER_UNIT
from pneunet_ros.messages.readings import Component, SENSORS, TARGETS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingTable:
    """Readings by stamp: stamp_ns (rows,), increasing, and values by sensor.

    values: for every sensor of SENSORS (rows, *row_shape), SI in the base frame, NaN without a
    reading: pressure (rows, 1), end_wrench (rows, 3), targets (rows, 2, targets). A row without
    any target is not a frame. pressure_unit: unit of the pressure in the table; absolute: whether
    the name of its column says that the pressure is absolute.
    """

    stamp_ns: Stamps
    values: Mapping[str, Array]
    pressure_unit: str = 'Pa'
    absolute: bool = False

    def __post_init__(self) -> None:
        """Check the shapes and the order of the stamps."""
        targets = np.shape(self.values[TARGETS.name])[2]
        values = {
            sensor.name: frozen_array(
                self.values[sensor.name], (len(self.stamp_ns), *sensor.row_shape(targets))
            )
            for sensor in SENSORS
        }
        object.__setattr__(self, 'values', values)
        if not np.all(np.diff(self.stamp_ns) > 0):
            raise RecordingError('the stamps of a table must increase', reason='not_increasing')

    def present(self) -> dict[str, npt.NDArray[np.bool_]]:
        """Return the rows with a reading (rows,), by sensor name."""
        return {sensor.name: sensor.present(self.values[sensor.name]) for sensor in SENSORS}

    def counts(self) -> dict[str, int]:
        """Return the number of readings per sensor."""
        return {name: int(np.count_nonzero(rows)) for name, rows in self.present().items()}


def columns(table: ReadingTable, units: UnitSystem = SI) -> dict[str, npt.NDArray[np.generic]]:
    """Return the columns of a table, with units in their names; time starts at zero.

    Names with SI units are understood by `import`. Quantities that were never measured have no
    column.
    """
    start = int(table.stamp_ns[0]) if len(table.stamp_ns) else 0
    seconds = [seconds_since(start, stamp) for stamp in table.stamp_ns.tolist()]
    found: dict[str, npt.NDArray[np.generic]] = {
        'stamp_ns': table.stamp_ns,
        'time_s': np.array(seconds),
    }
    counts = table.counts()
    for sensor in SENSORS:
        values = table.values[sensor.name]
        if sensor.per_target:
            for target in range(values.shape[2]):
                for place, component in enumerate(sensor.components):
                    name, size = column_unit(component, units)
                    found[f'{component.name}{target}_{name}'] = values[:, place, target] / size
        elif counts[sensor.name]:
            for place, component in enumerate(sensor.components):
                if component.optional and not are_numbers(values[:, place]).any():
                    continue
                name, size = column_unit(component, units)
                found[f'{component.name}_{name}'] = values[:, place] / size
    return found


def column_unit(component: Component, units: UnitSystem) -> tuple[str, float]:
    """Return the suffix of a column's unit, 'n_m' or 'mg_l', and its factor to SI."""
    unit = units.of_kind(component.kind)
    if unit is not None:
        return unit.name.lower().replace(' ', '_'), unit.size
    sizes = SI_PER_UNIT[component.kind]
    return next(name for name, size in sizes.items() if size == 1.0), 1.0

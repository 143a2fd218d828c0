"""The meaning of a pressure reading: unit, reference, sign and zero."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.units import PRESSURE_UNITS, STANDARD_ATMOSPHERE

GAUGE, ABSOLUTE = 'gauge', 'absolute'


def pressure_unit(size: float) -> str:
    """Return the name of the unit of this size (Pa)."""
    return next(name for name, unit_size in PRESSURE_UNITS.items() if unit_size == size)


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureConvention:
    """Possible meaning of the numbers of a pressure sensor.

    unit: one of PRESSURE_UNITS. reference: GAUGE, or ABSOLUTE, from which `ambient` (Pa) is
    subtracted. sign: -1 if the two ports of a differential sensor are swapped. offset (Pa): added
    at the end.
    """

    unit: str = 'Pa'
    reference: str = GAUGE
    sign: int = 1
    ambient: float = STANDARD_ATMOSPHERE
    offset: float = 0.0

    @property
    def size(self) -> float:
        """The unit in Pa."""
        return PRESSURE_UNITS[self.unit]

    def gauge(self, reading: float) -> float:
        """Return the gauge pressure (Pa) of a reading (in `unit`)."""
        above = self.ambient if self.reference == ABSOLUTE else 0.0
        return self.sign * (reading * self.size - above) + self.offset

    def reading(self, gauge: float) -> float:
        """Return the sensor reading (in `unit`) at a gauge pressure (Pa)."""
        above = self.ambient if self.reference == ABSOLUTE else 0.0
        return (self.sign * (gauge - self.offset) + above) / self.size

    @property
    def words(self) -> str:
        """Describe the meaning for a user: 'absolute hPa', 'gauge Pa with the sign reversed'."""
        return f'{self.reference} {self.unit}{" with the sign reversed" * (self.sign < 0)}'

    def changes_from(self, other: PressureConvention) -> dict[str, str]:
        """Return the settings that change another convention into this one."""
        shown = {
            'pressure_unit': (self.unit, other.unit),
            'pressure_reference': (self.reference, other.reference),
            'pressure_sign': (str(self.sign), str(other.sign)),
            'pressure_offset': (f'{self.offset:.6g}', f'{other.offset:.6g}'),
        }
        if self.reference == ABSOLUTE:
            shown['ambient_pressure'] = (f'{self.ambient:.6g}', f'{other.ambient:.6g}')
        return {name: new for name, (new, old) in shown.items() if new != old}

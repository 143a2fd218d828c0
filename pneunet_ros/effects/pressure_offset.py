"""A pressure sensor with a zero error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Load, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureOffset(Effect):
    """True pressure = reading + offset, after any gain."""

    name: ClassVar[str] = 'pressure_offset'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'true pressure = reading + offset (after any gain)'
    offset: float = quantity(
        0.0,
        unit='Pa',
        meaning='true pressure when the sensor reads zero',
        bounds=(-2e5, 2e5),
        prior=(-2e3, 2e3),
        source='prior: zero drift of common gauges',
    )

    def sense(self, load: Load) -> Load:
        """Shift the pressure."""
        return replace(load, pressure=load.pressure + self.offset)

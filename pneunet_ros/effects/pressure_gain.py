"""A pressure sensor with a gain error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Load, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureGain(Effect):
    """True pressure = gain x reading."""

    name: ClassVar[str] = 'pressure_gain'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'true pressure = gain x reading'
    gain: float = quantity(
        1.0,
        unit='-',
        meaning='true pressure per reading',
        bounds=(0.1, 10.0),
        prior=(0.9, 1.1),
        source='prior: twice the class of common gauges',
    )

    def sense(self, load: Load) -> Load:
        """Scale the pressure."""
        return replace(load, pressure=self.gain * load.pressure)

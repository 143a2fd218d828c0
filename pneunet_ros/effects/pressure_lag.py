"""The line between pressure sensor and chamber fills and empties slowly."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, History, Place, PressureScale


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureLag(Effect):
    """First-order lag: time_constant z' = p - z, exact for a piecewise linear pressure.

    History: the last pressure at the sensor and the pressure z in the chamber (Pa). Starts in
    equilibrium.
    """

    name: ClassVar[str] = 'pressure_lag'
    place: ClassVar[Place] = 'actuation'
    meaning: ClassVar[str] = 'first-order line between sensor and chamber'
    # A line empties more slowly than it fills, and its time constant is smaller by up to the
    # ratio of the specific heats, 1.4, where it is too quick for the gas to take up heat.
    law_error: ClassVar[float] = 0.12
    time_constant: float = quantity(
        0.0,
        unit='s',
        meaning='time in which the line settles to 1/e',
        bounds=(0.0, 1e3),
        prior=(0.02, 2.0),
        source='prior: 0.1 to 2 m of 2 to 4 mm tubing',
    )

    def initial(self, pressure: float, scale: PressureScale) -> History:
        """Return the equilibrium."""
        return (pressure, pressure)

    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Return the exact response of the first-order lag to a linear change of pressure."""
        before, chamber = history
        if self.time_constant == 0.0:
            return (pressure, pressure), pressure
        if seconds > 0.0:
            behind = self.time_constant * (pressure - before) / seconds
            decay = math.exp(-seconds / self.time_constant)
            chamber = pressure - behind + (chamber - before + behind) * decay
        return (pressure, chamber), chamber

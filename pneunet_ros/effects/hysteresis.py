"""Hysteresis: after a reversal, the pressure must cross a dead band before the chamber follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, History, Place, PressureScale


@dataclass(frozen=True, slots=True, kw_only=True)
class Hysteresis(Effect):
    """Play operator: the chamber pressure stays constant until the pressure is half a width away.

    Exact for a piecewise linear pressure. History: the pressures at the sensor and in the chamber
    (Pa). Starts in the middle of the play.
    """

    name: ClassVar[str] = 'hysteresis'
    place: ClassVar[Place] = 'actuation'
    meaning: ClassVar[str] = 'dead band (play) of this full width between pressure and chamber'
    width: float = quantity(
        0.0,
        unit='Pa',
        meaning='full width of the dead band',
        bounds=(0.0, 1e5),
        prior=(0.0, 4e3),
        prior_scales=True,
        source='prior: a loop as wide as 6 % of the 66 kPa of Table 1',
    )

    def initial(self, pressure: float, scale: PressureScale) -> History:
        """Return the middle of the play."""
        return (pressure, pressure)

    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Change the chamber pressure when the play reaches an end."""
        half = 0.5 * self.width
        chamber = min(max(history[1], pressure - half), pressure + half)
        return (pressure, chamber), chamber

    def in_play(self, history: History) -> bool:
        """Whether the pressure is within the dead band; rounds as `actuate` does."""
        pressure, chamber = history
        half = 0.5 * self.width
        return pressure - half < chamber < pressure + half

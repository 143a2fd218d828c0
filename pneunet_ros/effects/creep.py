"""Creep: the arm keeps bending after the pressure has settled."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
import math
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, History, Place, PressureScale, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class Creep(Effect):
    """kappa0_eff = (1 - a) kappa0 + a z with time_constant z' = kappa0(p, s) - z.

    kappa0 is a mixture of the rows of its table, with weights w(p) that are linear in p between
    rows; so z is a mixture, too, whose weights follow time_constant z_r' = w_r(p) - z_r, exact for
    a piecewise linear pressure. History: the last chamber pressure (Pa) and z_r, one per row.
    Starts in equilibrium.
    """

    name: ClassVar[str] = 'creep'
    place: ClassVar[Place] = 'actuation'
    meaning: ClassVar[str] = "kappa0_eff = (1 - a) kappa0 + a z, z' = (kappa0 - z) / time_constant"
    # Silicone relaxes over decades of time, not with one time constant, and its fast relaxation
    # looks elastic. Invented; blind trials in which up to a third relaxes eight times as fast.
    law_error: ClassVar[float] = 0.15
    amplitude: float = quantity(
        0.0,
        unit='-',
        meaning='a, the part of kappa0 that is delayed',
        bounds=(0.0, 1.0),
        prior=(0.0, 0.2),
        source='prior: up to a fifth of the curvature, soft silicone',
    )
    time_constant: float = quantity(
        60.0,  # arbitrary while the amplitude is 0; with 0 s an amplitude would not be observable
        unit='s',
        meaning='time in which the delayed part settles to 1/e; arbitrary if a = 0',
        bounds=(0.0, 1e6),
        prior=(2.0, 300.0),
        source='prior: seconds to minutes, soft silicone',
        shape=True,
    )

    def initial(self, pressure: float, scale: PressureScale) -> History:
        """Return the equilibrium, in which z is the curvature of this pressure."""
        if len(scale.rows) == 1:  # kappa_p0 at a single pressure never changes
            return pressure, 1.0
        row = row_below(scale.rows, pressure)
        above = weight_above(scale.rows, row, pressure)
        weights = [0.0] * len(scale.rows)
        weights[row : row + 2] = 1.0 - above, above
        return (pressure, *weights)

    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Return the exact response of z to a linear change of pressure, row by row."""
        if self.time_constant == 0.0 or len(scale.rows) == 1:
            return self.initial(pressure, scale), pressure
        before, *weights = history
        if seconds > 0.0:
            low, high = min(before, pressure), max(before, pressure)
            # Beyond its ends the table is extrapolated linearly, without a kink at the outer rows.
            stops = [row for row in scale.rows[1:-1] if low < row < high]
            if pressure < before:
                stops.reverse()
            rate = (pressure - before) / seconds
            start = before
            for stop in stops:
                self.advance_weights(weights, start, stop, (stop - start) / rate, scale.rows)
                start = stop
            rest = seconds if start == before else (pressure - start) / rate
            self.advance_weights(weights, start, pressure, rest, scale.rows)
        return (pressure, *weights), pressure

    def advance_weights(
        self,
        weights: list[float],
        start: float,
        stop: float,
        seconds: float,
        rows: tuple[float, ...],
    ) -> None:
        """Advance the weights in place over a linear change of pressure between two rows."""
        if seconds == 0.0:
            return
        elapsed = seconds / self.time_constant
        decay, lost = math.exp(-elapsed), math.expm1(-elapsed)
        row = row_below(rows, 0.5 * (start + stop))
        first, last = weight_above(rows, row, start), weight_above(rows, row, stop)
        behind = self.time_constant * (last - first) / seconds * lost
        for index, weight in enumerate(weights):
            if index == row:
                weight = (1.0 - last) + (weight - (1.0 - first)) * decay - behind
            elif index == row + 1:
                weight = last + (weight - first) * decay + behind
            else:
                weight *= decay
            weights[index] = weight

    def history_terms(self, history: Array, scale: PressureScale) -> Terms:
        """Return the delayed part of the intrinsic curvature."""
        return Terms(row_share=self.amplitude, row_weights=history[..., 1:])


def row_below(rows: tuple[float, ...], pressure: float) -> int:
    """Return the lower row of the interval that contains a pressure; the ends extrapolate."""
    return min(max(bisect_right(rows, pressure) - 1, 0), len(rows) - 2)


def weight_above(rows: tuple[float, ...], row: int, pressure: float) -> float:
    """Return the weight of the next row at a pressure."""
    return (pressure - rows[row]) / (rows[row + 1] - rows[row])

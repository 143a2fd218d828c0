"""Mullins softening: an arm is softer below the largest pressure it has seen before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, History, Place, PressureScale, Terms

NOISE_BAND = 8.0  # sigma between the largest and the smallest of ten thousand readings at rest


@dataclass(frozen=True, slots=True, kw_only=True)
class Softening(Effect):
    """Rigidity x (1 - loss p_max / p_range) while p is below the largest pressure so far.

    p_range is the upper end of the calibrated range and limits p_max. A reading counts as below
    p_max only if the difference exceeds sensor noise, so that noise alone does not soften an arm
    that rests at p_max. History: p_max (Pa), and 1 if p is below it, else 0. Starts unconditioned
    (no prior loading).
    """

    name: ClassVar[str] = 'softening'
    place: ClassVar[Place] = 'material'
    meaning: ClassVar[str] = 'rigidity x (1 - loss p_max / p_range) below p_max (Mullins)'
    # A part of it recovers within minutes, and near p_max rubber comes back to its first curve
    # little by little, not at once. Invented, of that size.
    law_error: ClassVar[float] = 0.1
    loss: float = quantity(
        0.0,
        unit='-',
        meaning='share of rigidity lost after the full pressure range',
        bounds=(0.0, 0.9),
        prior=(0.0, 0.3),
        source='prior: little in pure silicone, up to a third in filled rubber',
    )

    def initial(self, pressure: float, scale: PressureScale) -> History:
        """Return the history of an arm whose largest pressure so far is this one."""
        return (pressure, 0.0)

    def actuate(
        self, history: History, seconds: float, pressure: float, scale: PressureScale
    ) -> tuple[History, float]:
        """Store the maximum pressure, and whether this one is below it."""
        largest = max(history[0], pressure)
        below = pressure < largest - NOISE_BAND * scale.std
        return (largest, float(below)), pressure

    def history_terms(self, history: Array, scale: PressureScale) -> Terms:
        """Return the loss of rigidity, which is constant for small changes of pressure."""
        if scale.top <= 0.0:  # an arm with negative pressures only is never inflated
            return Terms()
        share = np.minimum(np.maximum(history[..., 0] / scale.top, 0.0), 1.0)
        return Terms(rigidity_factor=1.0 - self.loss * share * history[..., 1])

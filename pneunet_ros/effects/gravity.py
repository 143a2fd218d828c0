"""The weight of the arm in the plane of bending."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class Gravity(Effect):
    """Line load in the base frame, per unstretched length."""

    name: ClassVar[str] = 'gravity'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'line load in the base frame'
    # The mass of no arm is uniform, and mass near the clamp bends it less. Invented: in blind
    # trials an arm a third heavier at the clamp than on average appears a quarter too light.
    law_error: ClassVar[float] = 0.2
    weight_x: float = quantity(
        0.0,
        unit='N/m',
        meaning='weight per length along E1',
        bounds=(-1e3, 1e3),
        prior=(-3.0, 3.0),
        prior_scales=True,
        source='prior: twice the weight of the solid arm, 0.17 N on 0.112 m',
    )
    weight_y: float = quantity(
        0.0,
        unit='N/m',
        meaning='weight per length along E2',
        bounds=(-1e3, 1e3),
        prior=(-3.0, 3.0),
        prior_scales=True,
        source='prior: twice the weight of the solid arm, 0.17 N on 0.112 m',
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the line load."""
        return Terms(line_load_x=self.weight_x, line_load_y=self.weight_y)

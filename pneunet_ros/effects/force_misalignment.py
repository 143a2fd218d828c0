"""A misaligned force sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

from pneunet_ros.core.frames import rotate
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Load, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceMisalignment(Effect):
    """True force = R(angle) reading; the end moment is unchanged."""

    name: ClassVar[str] = 'force_misalignment'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'true force = R(angle) reading'
    angle: float = quantity(
        0.0,
        unit='rad',
        meaning='counter-clockwise rotation from the reading to the true force',
        bounds=(-math.pi, math.pi),
        prior=(-0.1, 0.1),
        source='prior: 6 degrees, a sensor mounted by eye',
    )

    def sense(self, load: Load) -> Load:
        """Rotate the force."""
        force_x, force_y = rotate(self.angle, load.force_x, load.force_y)
        return replace(load, force_x=force_x, force_y=force_y)

"""A camera whose scale is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraScale(Effect):
    """Measured point = factor x true point, about the base."""

    name: ClassVar[str] = 'camera_scale'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'measured point = factor x true point, about the base'
    factor: float = quantity(
        1.0,
        unit='-',
        meaning='measured length per true length',
        bounds=(0.1, 10.0),
        prior=(0.95, 1.05),
        source='prior: the arm 50 mm before or behind the plane, 1 m from the camera',
    )

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Scale the points."""
        return self.factor * x, self.factor * y

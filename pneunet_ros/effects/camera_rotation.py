"""A camera that is rotated about its line of sight."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import rotate
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraRotation(Effect):
    """Measured point = R(angle) true point, about the base."""

    name: ClassVar[str] = 'camera_rotation'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'measured point = R(angle) true point, about the base'
    angle: float = quantity(
        0.0,
        unit='rad',
        meaning='counter-clockwise rotation from the true to the measured point',
        bounds=(-math.pi, math.pi),
        prior=(-0.1, 0.1),
        source='prior: 6 degrees, a camera mounted by eye',
    )

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Turn the points."""
        return rotate(self.angle, x, y)

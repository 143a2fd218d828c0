"""A camera whose axis is not perpendicular to the plane of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place

PRIOR = 'prior: 10 degrees, seen from a fifth of a meter'


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTilt(Effect):
    """Measured point = true point / (1 + tilt . true point), about the base.

    Perspective: the scale is correct at the base, and smaller where the plane is further away. The
    tilt is the tangent of the angle divided by the distance of the camera.
    """

    name: ClassVar[str] = 'camera_tilt'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'measured point = true point / (1 + tilt . true point): perspective'
    tilt_x: float = quantity(
        0.0,
        unit='1/m',
        meaning='decrease of the scale along E1',
        bounds=(-1e3, 1e3),
        prior=(-0.9, 0.9),
        prior_scales=True,
        source=PRIOR,
    )
    tilt_y: float = quantity(
        0.0,
        unit='1/m',
        meaning='decrease of the scale along E2',
        bounds=(-1e3, 1e3),
        prior=(-0.9, 0.9),
        prior_scales=True,
        source=PRIOR,
    )

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Scale points of the plane about the base."""
        scale = 1.0 / (1.0 + self.tilt_x * x + self.tilt_y * y)
        return scale * x, scale * y

"""A camera that does not look square to the plane of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place
from pneunet_ros.effects.lens_distortion import MIDDLE_X, MIDDLE_Y

PRIOR = 'prior: 10 degrees, seen from a fifth of a meter'


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraTilt(Effect):
    """Measured = m + (true - m) / (1 + tilt . (true - m)) + const, m the middle of the picture.

    Perspective: the scale is right in the middle, and falls towards where the plane is further
    away. The tilt is the tangent of the angle over the distance of the camera. The constant leaves
    the base where it is, as pictures are placed by the clamp that they show.
    """

    name: ClassVar[str] = 'camera_tilt'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'the camera is not square to the plane: perspective about its middle'
    tilt_x: float = quantity(
        0.0,
        unit='1/m',
        meaning='fall of scale along E1',
        bounds=(-10.0, 10.0),
        prior=(-0.9, 0.9),
        source=PRIOR,
    )
    tilt_y: float = quantity(
        0.0,
        unit='1/m',
        meaning='fall of scale along E2',
        bounds=(-10.0, 10.0),
        prior=(-0.9, 0.9),
        source=PRIOR,
    )
    middle_x: float = MIDDLE_X
    middle_y: float = MIDDLE_Y

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Bring points of the plane nearer to the middle, or further away."""
        (moved_x, moved_y), (base_x, base_y) = self.moves(x, y), self.moves(0.0, 0.0)
        return x + (moved_x - base_x), y + (moved_y - base_y)

    def moves(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return by how much (m) points move, or one."""
        away_x, away_y = x - self.middle_x, y - self.middle_y
        off = self.tilt_x * away_x + self.tilt_y * away_y
        grown = -off / (1.0 + off)
        return grown * away_x, grown * away_y

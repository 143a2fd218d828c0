"""Residual lens distortion that the camera calibration missed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class LensDistortion(Effect):
    """Measured = m + (true - m) (1 + radial r^2) + const; r: distance from the image center m.

    The constant keeps the base in place, because images are registered by the visible clamp.
    Source: the first radial term of Brown, Photogrammetric Engineering 37 (1971), in the plane of
    the arm.
    """

    name: ClassVar[str] = 'lens_distortion'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'the lens distorts the image radially about its center'
    # A real lens has further terms, which grow towards the edge. Invented, of that size.
    law_error: ClassVar[float] = 0.2
    radial: float = quantity(
        0.0,
        unit='1/m^2',
        meaning='relative increase of scale with the square of the distance; < 0: barrel',
        bounds=(-1e4, 1e4),
        prior=(-20.0, 20.0),
        prior_scales=True,
        source='prior: 6 % at 0.056 m from the center, half of the arm of Table 1',
    )
    middle_x: float = quantity(
        0.05,
        unit='m',
        meaning='center of the image, along E1',
        bounds=(1e-3, 10.0),
        prior=(0.02, 0.2),
        prior_scales=True,
        source='prior: the middle of an arm of 0.04 to 0.4 m',
        shape=True,
    )
    middle_y: float = quantity(
        0.0,
        unit='m',
        meaning='center of the image, along E2',
        bounds=(-10.0, 10.0),
        prior=(-0.05, 0.05),
        prior_scales=True,
        source='prior: half of an arm of 0.1 m',
        shape=True,
    )

    def see(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Move the points towards the image center or away from it."""
        (moved_x, moved_y), (base_x, base_y) = self.moves(x, y), self.moves(0.0, 0.0)
        return x + (moved_x - base_x), y + (moved_y - base_y)

    def moves(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return the displacement (m) of points, or of a single point."""
        away_x, away_y = x - self.middle_x, y - self.middle_y
        grown = self.radial * (away_x**2 + away_y**2)
        return grown * away_x, grown * away_y

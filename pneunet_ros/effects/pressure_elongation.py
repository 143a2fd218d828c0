"""Inflation lengthens the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureElongation(Effect):
    """Rest strain = strain_per_pascal p + strain_per_pascal_squared p^2 in the chamber."""

    name: ClassVar[str] = 'pressure_elongation'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'inflation lengthens the arm'
    strain_per_pascal: float = quantity(
        0.0,
        unit='1/Pa',
        meaning='linear part',
        bounds=(-1e-3, 1e-3),
        prior=(-1e-6, 1e-5),
        prior_scales=True,
        source='prior: 27 real actuators of docs/calibration.md, up to 7e-6, and some more',
    )
    strain_per_pascal_squared: float = quantity(
        0.0,
        unit='1/Pa^2',
        meaning='quadratic part',
        bounds=(-1e-5, 1e-5),
        prior=(-1e-10, 1e-10),
        prior_scales=True,
        source='prior: 27 real actuators of docs/calibration.md, to -7e-11, and some more',
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the strain of the unloaded arm."""
        strain = self.strain_per_pascal * pressure + self.strain_per_pascal_squared * pressure**2
        return Terms(rest_strain=strain)

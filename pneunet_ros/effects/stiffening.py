"""The arm stiffens with its deviation from the intrinsic curvature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class Stiffening(Effect):
    """M = B d (1 + c d^2) with d = kappa - kappa0."""

    name: ClassVar[str] = 'stiffening'
    place: ClassVar[Place] = 'material'
    meaning: ClassVar[str] = 'M = B d (1 + c d^2), d = kappa - kappa0'
    coefficient: float = quantity(
        0.0,
        unit='m^2',
        meaning='coefficient c',
        bounds=(0.0, 1.0),
        prior=(0.0, 1e-3),
        prior_scales=True,
        source='prior: doubles the moment at d = 30 1/m',
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the cubic term."""
        return Terms(cubic=self.coefficient)

"""The arm has mass: after a quick change it swings about its equilibrium."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class Inertia(Effect):
    """Tip mass and damping, as in the block `motion` of a model file."""

    name: ClassVar[str] = 'inertia'
    place: ClassVar[Place] = 'motion'
    meaning: ClassVar[str] = 'the arm swings: its own mass, a mass at its tip, damping'
    tip_mass: float = quantity(
        0.0,
        unit='kg',
        meaning=(
            'mass at the free end, in addition to the mass of the arm, which is its weight / g'
        ),
        bounds=(0.0, 1e3),
        prior=(0.0, 0.02),
        prior_scales=True,
        source='prior: up to the mass of the solid arm, 0.17 N / g',
    )
    damping_time: float = quantity(
        0.0,
        unit='s',
        meaning='damping over stiffness (Kelvin-Voigt)',
        bounds=(0.0, 1e3),
        prior=(0.0, 0.1),
        source='prior: damped by less than two fifths of the critical damping at 1.3 Hz',
    )

    def motion(self) -> tuple[float, float] | None:
        """Return mass at the tip and damping time."""
        return None if self.is_neutral else (self.tip_mass, self.damping_time)

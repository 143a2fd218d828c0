"""The clamp rotates under the moment it carries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class ClampCompliance(Effect):
    """theta(0) = clamp angle + compliance x M(0)."""

    name: ClassVar[str] = 'clamp_compliance'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'the clamp rotates by compliance x M(0)'
    # A compliant clamp becomes stiffer as it rotates. Invented, of that order.
    law_error: ClassVar[float] = 0.1
    compliance: float = quantity(
        0.0,
        unit='rad/(N m)',
        meaning='rotation of the clamp per moment',
        bounds=(0.0, 1e8),
        prior=(0.0, 20.0),
        prior_scales=True,
        source='prior: up to 0.1 rad at the 5 mN m of Table 1',
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the compliance of the clamp."""
        return Terms(clamp_compliance=self.compliance)

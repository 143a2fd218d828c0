"""The arm stretches under axial force, the paper's explanation of its error of F1."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class Extensibility(Effect):
    """Stretch = n.t / EA."""

    name: ClassVar[str] = 'extensibility'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'stretch = n.t / EA'
    axial_stiffness: float = quantity(
        math.inf,
        unit='N',
        meaning='EA; infinite = inextensible',
        bounds=(1e-4, math.inf),
        prior=(5.0, 500.0),
        prior_scales=True,
        source='prior: silicone of E = 0.1 to 3 MPa on 50 to 150 mm^2',
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the axial compliance 1/EA."""
        return Terms(axial_compliance=1.0 / self.axial_stiffness)

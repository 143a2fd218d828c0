"""A constant push along the normal at one place on the arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Part, Place, Terms

WIDTH = 0.02  # s / l over which the force is distributed: narrower than targets can resolve


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact(Effect):
    """A constant force along the normal (-sin theta, cos theta) of the arm at a place."""

    name: ClassVar[str] = 'contact'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'a constant push at a place of the arm, along its normal there'
    # An object that touches an arm gives way, slides, comes and goes. Invented, of that order.
    law_error: ClassVar[float] = 0.1
    force: float = quantity(
        0.0,
        unit='N',
        meaning='force along the normal',
        bounds=(-1e3, 1e3),
        prior=(-0.1, 0.1),
        prior_scales=True,
        source='prior: half of the end forces of Table 1',
    )
    arclength: float = quantity(
        0.6,
        unit='-',
        meaning='position of the force, s / l',
        bounds=(0.02, 1.0),
        prior=(0.2, 1.0),
        source='prior: nearer to the clamp a push hardly moves the arm',
        shape=True,
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the push."""
        return Terms(part=Part.around(self.arclength, WIDTH), push=self.force)

"""The end force acts at an offset from the centerline."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place, Terms


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadOffset(Effect):
    """The load acts at tip + offset x normal, normal = (-sin theta, cos theta) at the tip.

    The weight of `tip_mass` (such as a fitting to which the load is tied) acts there, too; its
    inertia acts at the tip.
    """

    name: ClassVar[str] = 'load_offset'
    place: ClassVar[Place] = 'mechanics'
    meaning: ClassVar[str] = 'the load acts at tip + offset x normal'
    offset: float = quantity(
        0.0,
        unit='m',
        meaning='distance of the point of action from the centerline',
        bounds=(-10.0, 10.0),
        prior=(-0.012, 0.012),
        prior_scales=True,
        source="prior: the paper's arm is 12 mm high",
    )

    def terms(self, pressure: Array) -> Terms:
        """Return the lever arm of the end force."""
        return Terms(load_offset=self.offset)

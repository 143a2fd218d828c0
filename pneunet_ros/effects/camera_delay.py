"""A camera whose clock is ahead of the sensor clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pneunet_ros.core.units import quantity
from pneunet_ros.effects.effect import Effect, Place


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraDelay(Effect):
    """A frame stamped t shows the arm at t - delay."""

    name: ClassVar[str] = 'camera_delay'
    place: ClassVar[Place] = 'sensing'
    meaning: ClassVar[str] = 'a frame stamped t shows the arm of t - delay'
    law_error: ClassVar[float] = 0.1  # invented: clocks drift, and only moving frames show a delay
    delay: float = quantity(
        0.0,
        unit='s',
        meaning='delay of the stamps of frames',
        bounds=(-10.0, 10.0),
        prior=(-0.2, 0.2),
        source='prior: stamped on receipt, behind exposure, transport and some buffered frames',
    )

    @property
    def frame_delay(self) -> float:
        """Return the delay."""
        return self.delay

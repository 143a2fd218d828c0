"""Effects between the truth and what sensors and camera say of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import quantity
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_effect import LabEffect, rising


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureGain(LabEffect):
    """True pressure = gain x reading; rich: the gain is more wrong at high pressure."""

    name: ClassVar[str] = 'pressure_gain'
    gain: float = quantity(1.0, unit='-', bounds=(0.1, 10.0))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Divide by the gain."""
        error = (self.gain - 1.0) * (1.0 + 0.3 * self.richness * rising(arm, pressure))
        return freeze(pressure / (1.0 + error)), force


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureOffset(LabEffect):
    """True pressure = reading + offset, after any gain; rich: it grows with pressure."""

    name: ClassVar[str] = 'pressure_offset'
    offset: float = quantity(0.0, unit='Pa', bounds=(-2e5, 2e5))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Take the offset away."""
        grown = self.offset * (1.0 + 0.3 * self.richness * rising(arm, pressure))
        return freeze(pressure - grown), force


@dataclass(frozen=True, slots=True, kw_only=True)
class LabForceMisalignment(LabEffect):
    """True force = R(angle) reading; rich: a stronger pull straightens the sensor."""

    name: ClassVar[str] = 'force_misalignment'
    angle: float = quantity(0.0, unit='rad', bounds=(-4.0, 4.0))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Turn the force back."""
        pull = np.hypot(force[:, 0], force[:, 1]) / arm.weight
        angle = self.angle * (1.0 + 0.3 * self.richness * (1.0 - pull))
        return pressure, turned(force, -angle)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCameraScale(LabEffect):
    """Measured = factor x true, about the base; rich: the plane is tilted, too."""

    name: ClassVar[str] = 'camera_scale'
    factor: float = quantity(1.0, unit='-', bounds=(0.1, 10.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Scale, more so where x is large."""
        tilt = 0.3 * self.richness * (2.0 * points[..., :1] / arm.length - 1.0)
        return freeze(points * (1.0 + (self.factor - 1.0) * (1.0 + tilt)))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCameraRotation(LabEffect):
    """Measured = R(angle) true, about the base; rich: the camera goes on turning."""

    name: ClassVar[str] = 'camera_rotation'
    angle: float = quantity(0.0, unit='rad', bounds=(-4.0, 4.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Turn, more so at the end of the recording."""
        angle = self.angle * (1.0 + 0.3 * self.richness * (2.0 * share - 1.0))
        return turned(points, angle[:, None])


def turned(vectors: Array, angle: Array) -> Array:
    """Return vectors (..., 2) turned counter-clockwise by angles that broadcast to (...)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return freeze(np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1))

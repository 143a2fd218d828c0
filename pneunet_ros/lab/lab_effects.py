"""Independent implementations of the effects for the virtual lab, and their table.

The table is in the order of application: sensing, then history, then material and mechanics.
Readings are computed in the same order: offset before gain, because true pressure = gain x reading
+ offset.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import quantity
from pneunet_ros.lab.chain import Chain, Push
from pneunet_ros.lab.history_kernels import (
    lag_pressure,
    largest_so_far,
    play_pressure,
    relax_curvature,
)
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_effect import Course, LabEffect, Past, relative_pressure, RichEffect

RECOVERY_TIME = 120.0  # s, time constant of the recovering part of a rich Mullins effect
RECOVERING = 0.05  # the recovering part; invented, real rubber recovers less at room temperature
# Share of the arm's largest pressure over which a softened arm comes back to its first curve:
# hardly any by the plain law, and more by a rich one.
REJOINING, RICH_REJOINING = 0.002, 0.02
CLAMP_YIELD = 0.1  # rad, at which a rich clamp has twice its stiffness


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureGain(RichEffect):
    """True pressure = gain x reading; rich: the gain error grows with pressure."""

    name: ClassVar[str] = 'pressure_gain'
    gain: float = quantity(1.0, unit='-', bounds=(0.1, 10.0))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Divide by the gain."""
        error = (self.gain - 1.0) * (1.0 + 0.3 * self.richness * relative_pressure(arm, pressure))
        return freeze(pressure / (1.0 + error)), force


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureOffset(RichEffect):
    """True pressure = reading + offset, after any gain; rich: it grows with pressure."""

    name: ClassVar[str] = 'pressure_offset'
    offset: float = quantity(0.0, unit='Pa', bounds=(-2e5, 2e5))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Subtract the offset."""
        grown = self.offset * (1.0 + 0.3 * self.richness * relative_pressure(arm, pressure))
        return freeze(pressure - grown), force


@dataclass(frozen=True, slots=True, kw_only=True)
class LabForceMisalignment(RichEffect):
    """True force = R(angle) reading; rich: a stronger pull aligns the sensor."""

    name: ClassVar[str] = 'force_misalignment'
    angle: float = quantity(0.0, unit='rad', bounds=(-4.0, 4.0))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Rotate the force back."""
        pull = np.hypot(force[:, 0], force[:, 1]) / arm.weight
        angle = self.angle * (1.0 + 0.3 * self.richness * (1.0 - pull))
        return pressure, turn(force, -angle)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCameraScale(RichEffect):
    """Measured = factor x true, about the base; rich: the plane is also tilted."""

    name: ClassVar[str] = 'camera_scale'
    factor: float = quantity(1.0, unit='-', bounds=(0.1, 10.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Scale the image, more strongly at large x."""
        tilt = 0.3 * self.richness * (2.0 * points[..., :1] / arm.length - 1.0)
        return freeze(points * (1.0 + (self.factor - 1.0) * (1.0 + tilt)))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCameraRotation(RichEffect):
    """Measured = R(angle) true, about the base; rich: the camera keeps rotating."""

    name: ClassVar[str] = 'camera_rotation'
    angle: float = quantity(0.0, unit='rad', bounds=(-4.0, 4.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Rotate, more strongly towards the end of the recording."""
        angle = self.angle * (1.0 + 0.3 * self.richness * (2.0 * share - 1.0))
        return turn(points, angle[:, None])


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCameraDelay(RichEffect):
    """A frame is stamped late; rich: the camera clock runs fast."""

    name: ClassVar[str] = 'camera_delay'
    delay: float = quantity(0.0, unit='s', bounds=(-10.0, 10.0))

    def frame_delay(self, share: Array) -> Array:
        """Return the delay, which increases during the recording."""
        return freeze(self.delay * (1.0 + 0.3 * self.richness * (2.0 * share - 1.0)))


def turn(vectors: Array, angle: Array) -> Array:
    """Return vectors (..., 2) rotated counter-clockwise by angles that broadcast to (...)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vectors[..., 0], vectors[..., 1]
    return freeze(np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureLag(RichEffect):
    """First-order line; rich: it empties more slowly than it fills."""

    name: ClassVar[str] = 'pressure_lag'
    time_constant: float = quantity(0.0, unit='s', bounds=(0.0, 1e3))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let the chamber follow the sensor."""
        start = float(self.resume(past, course.chamber[:1])[0])
        filling = self.time_constant * (1.0 - 0.25 * self.richness)
        emptying = self.time_constant * (1.0 + 0.25 * self.richness)
        chamber = freeze(lag_pressure(course.time, course.chamber, start, filling, emptying))
        return course.with_chamber(chamber), (float(chamber[-1]),)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabHysteresis(RichEffect):
    """Dead band of full width on the chamber pressure; rich: three, with mean width `width`."""

    name: ClassVar[str] = 'hysteresis'
    width: float = quantity(0.0, unit='Pa', bounds=(0.0, 1e6))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let the plays follow the chamber."""
        spread = np.array([-1.0, 0.0, 1.0]) * min(0.6 * self.richness, 1.0)
        half = 0.5 * self.width * (1.0 + spread)
        start = self.resume(past, freeze(np.full(half.size, course.chamber[0])))
        outputs = play_pressure(course.chamber, start, freeze(half))
        return course.with_chamber(freeze(outputs.mean(axis=1))), tuple(outputs[-1].tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCreep(RichEffect):
    """A share 1 - amplitude of kappa0 follows at once, the rest later; rich: in two stages."""

    name: ClassVar[str] = 'creep'
    amplitude: float = quantity(0.0, unit='-', bounds=(0.0, 1.0))
    time_constant: float = quantity(60.0, unit='s', bounds=(0.0, 1e6))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Delay a part of the intrinsic curvature."""
        equilibrium = course.weights
        start = self.resume(past, np.stack([equilibrium[0]] * 2))
        constants = self.time_constant, self.time_constant / 8.0
        slow, fast = (
            relax_curvature(course.time, equilibrium, freeze(start[i].copy()), constants[i])
            for i in (0, 1)
        )
        share = 0.3 * self.richness
        delayed = (1.0 - share) * slow + share * fast
        weights = freeze((1.0 - self.amplitude) * equilibrium + self.amplitude * delayed)
        past = (*slow[-1].tolist(), *fast[-1].tolist())
        return replace(course, weights=weights), past


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSoftening(RichEffect):
    """Mullins effect: softer below the largest past pressure; rich: partly recovers in minutes."""

    name: ClassVar[str] = 'softening'
    loss: float = quantity(0.0, unit='-', bounds=(0.0, 0.9))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Scale the rigidity."""
        top = course.arm.pressure_range[1]
        rest = float(course.chamber[0])
        start, decayed = self.resume(past, np.array([rest, rest])).tolist()
        largest_ever = largest_so_far(course.time, course.chamber, start, 0.0)
        largest_recent = largest_so_far(course.time, course.chamber, decayed, 1.0 / RECOVERY_TIME)
        recovering = RECOVERING * self.richness
        largest = freeze((1.0 - recovering) * largest_ever + recovering * largest_recent)
        rejoining = REJOINING + RICH_REJOINING * self.richness
        recovery = (largest - course.chamber) / (rejoining * top)
        reduction = self.loss * largest / top * (1.0 - np.exp(-recovery))
        factor = freeze(course.rigidity_factor * (1.0 - reduction))
        return replace(course, rigidity_factor=factor), (
            float(largest_ever[-1]),
            float(largest_recent[-1]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabStiffening(RichEffect):
    """M = B d (1 + c d^2); rich: with a term in d^5."""

    name: ClassVar[str] = 'stiffening'
    coefficient: float = quantity(0.0, unit='m^2', bounds=(0.0, 1.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add the stiffening to the energy of joints."""
        quintic = self.richness * self.coefficient**2
        return replace(chain, cubic=self.coefficient, quintic=quintic)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabExtensibility(RichEffect):
    """Strain = tension / EA; rich: neo-Hookean rubber, softer when stretched."""

    name: ClassVar[str] = 'extensibility'
    axial_stiffness: float = quantity(math.inf, unit='N', bounds=(0.1, math.inf))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Let the elements stretch.

        T = EA / 3 (stretch - 1 / stretch^2) is strain = T / EA + (T / EA)^2 to second order.
        """
        compliance = 1.0 / self.axial_stiffness
        return replace(chain, axial_compliance=compliance, axial_growth=self.richness)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPressureElongation(RichEffect):
    """Strain of the unloaded arm, linear and quadratic in p; rich: larger near the clamp."""

    name: ClassVar[str] = 'pressure_elongation'
    strain_per_pascal: float = quantity(0.0, unit='1/Pa', bounds=(-1e-5, 1e-5))
    strain_per_pascal_squared: float = quantity(0.0, unit='1/Pa^2', bounds=(-1e-9, 1e-9))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Lengthen the elements."""
        strain = chamber * (self.strain_per_pascal + self.strain_per_pascal_squared * chamber)
        along = 1.0 + 0.4 * self.richness * (1.0 - 2.0 * chain.middles / chain.length)
        return replace(chain, rest=chain.rest + strain[:, None] * along)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabGravity(RichEffect):
    """Mean weight per length; rich: heavier near the clamp."""

    name: ClassVar[str] = 'gravity'
    weight_x: float = quantity(0.0, unit='N/m', bounds=(-1e3, 1e3))
    weight_y: float = quantity(0.0, unit='N/m', bounds=(-1e3, 1e3))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add the weight beyond every element.

        Weight per length 1 + a (1 - 2 u) with u = s / l leaves 1 - u - a u (1 - u) beyond u.
        """
        u = chain.middles / chain.length
        beyond = chain.length * (1.0 - u) * (1.0 - 0.4 * self.richness * u)
        weight = np.array([self.weight_x, self.weight_y])
        return replace(chain, line=chain.line + beyond[:, None] * weight)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabClampCompliance(RichEffect):
    """The clamp rotates under its moment; rich: it stiffens."""

    name: ClassVar[str] = 'clamp_compliance'
    compliance: float = quantity(0.0, unit='rad/(N m)', bounds=(0.0, 1e4))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add a spring to the clamp."""
        hardening = self.richness / CLAMP_YIELD**2
        return replace(chain, clamp_compliance=self.compliance, clamp_hardening=hardening)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabLoadOffset(RichEffect):
    """The end force acts at a lateral offset from the free end; rich: also beyond it."""

    name: ClassVar[str] = 'load_offset'
    offset: float = quantity(0.0, unit='m', bounds=(-0.1, 0.1))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Move the point of action."""
        beyond = chain.end_offset_along + 0.3 * self.richness * self.offset
        return replace(chain, end_offset_across=self.offset, end_offset_along=beyond)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabContact(RichEffect):
    """A constant push at a place, along the normal there; rich: it grows with the pressure."""

    name: ClassVar[str] = 'contact'
    force: float = quantity(0.0, unit='N', bounds=(-1e3, 1e3))
    arclength: float = quantity(0.6, unit='-', meaning='s / l', bounds=(0.02, 1.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add the push."""
        grown = 1.0 + 0.3 * self.richness * relative_pressure(arm, chamber)
        force = freeze(self.force * grown)
        push = Push(place=self.arclength * arm.length, force=force)
        return replace(chain, pushes=(*chain.pushes, push))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabCameraTilt(RichEffect):
    """A camera tilted against the plane, by similar triangles about the base; rich: more tilt."""

    name: ClassVar[str] = 'camera_tilt'
    tilt_x: float = quantity(0.0, unit='1/m', bounds=(-10.0, 10.0))
    tilt_y: float = quantity(0.0, unit='1/m', bounds=(-10.0, 10.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Project onto the image: distant points appear smaller."""
        tilt_factor = 1.0 + 0.3 * self.richness * (2.0 * share - 1.0)
        depth = 1.0 + tilt_factor[:, None] * (points @ np.array([self.tilt_x, self.tilt_y]))
        return freeze(points / depth[..., None])


@dataclass(frozen=True, slots=True, kw_only=True)
class LabLensDistortion(RichEffect):
    """Radial lens distortion about the image center; rich: with a fourth-power term."""

    name: ClassVar[str] = 'lens_distortion'
    radial: float = quantity(
        0.0, unit='1/m^2', meaning='radial term; < 0: barrel', bounds=(-1e4, 1e4)
    )
    middle_x: float = quantity(0.05, unit='m', bounds=(-10.0, 10.0))
    middle_y: float = quantity(0.0, unit='m', bounds=(-10.0, 10.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Distort; the fourth-power term is relative to half the length of the arm."""
        middle = np.array([self.middle_x, self.middle_y])
        displacements = [
            self.radial * squared * (1.0 + self.richness * fourth) * radius
            for radius in (points - middle, -middle)
            for squared in [np.sum(radius**2, axis=-1, keepdims=True)]
            for fourth in [0.3 * (squared / (0.5 * arm.length) ** 2 - 1.0)]
        ]
        return freeze(points + (displacements[0] - displacements[1]))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabInertia(LabEffect):
    """The arm has mass: MuJoCo simulates it. A number of 0 leaves that of the block `motion`."""

    name: ClassVar[str] = 'inertia'
    tip_mass: float = quantity(0.0, unit='kg', bounds=(0.0, 1e2))
    damping_time: float = quantity(0.0, unit='s', bounds=(0.0, 1e2))


LAB_EFFECTS: dict[str, type[LabEffect]] = {
    effect.name: effect
    for effect in (
        LabPressureOffset,
        LabPressureGain,
        LabForceMisalignment,
        LabPressureLag,
        LabHysteresis,
        LabCreep,
        LabSoftening,
        LabStiffening,
        LabExtensibility,
        LabPressureElongation,
        LabGravity,
        LabClampCompliance,
        LabLoadOffset,
        LabContact,
        LabCameraScale,
        LabCameraRotation,
        LabCameraTilt,
        LabLensDistortion,
        LabCameraDelay,
        LabInertia,
    )
}

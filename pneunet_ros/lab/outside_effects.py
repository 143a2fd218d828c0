"""Effects of the virtual lab that the model cannot have, and their table.

A diagnosis must not confuse them with a known effect. These effects have no setting `richness`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import quantity
from pneunet_ros.lab.chain import Chain, equilibrium_shape, Peg, Push
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_effect import Course, LabEffect, Past
from pneunet_ros.lab.lab_effects import LAB_EFFECTS

MOST_TURNS = 200  # iterations of the direction of a string
TIP_RESTS = 1e-7  # of the length: largest motion of a tip that has converged


@dataclass(frozen=True, slots=True, kw_only=True)
class LabHarmlessMismatch(LabEffect):
    """A small error of the intrinsic curvature, present in every real arm.

    It is `size` times cos(2 pi s / l + phase) sin(2 pi p / top) / 2 for every arm, plus `size` / 2
    times sin(pi s / l) and the end load in units of mg, limited to 1.
    """

    name: ClassVar[str] = 'harmless_mismatch'
    size: float = quantity(0.0, unit='-', meaning='largest relative error', bounds=(0.0, 0.1))
    phase: float = quantity(0.0, unit='rad', meaning='phase along the arm', bounds=(-7.0, 7.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Change the rotation of the joints of the unloaded arm slightly."""
        positions = places(chain) / arm.length
        top = arm.pressure_range[1]
        pull = np.minimum(np.hypot(chain.force[:, 0], chain.force[:, 1]) / arm.weight, 1.0)
        free = np.sin(2.0 * math.pi * chamber / top)[:, None] * np.cos(
            2.0 * math.pi * positions + self.phase
        )
        loaded = pull[:, None] * np.sin(math.pi * positions)
        change = 0.5 * self.size * (free + loaded)
        return replace(chain, turning=freeze(chain.turning * (1.0 + change)))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabWeakChamber(LabEffect):
    """One weak chamber: softer and less bent over a short part, increasingly with the cube of p.

    rigidity_loss (share) and curvature_dip (1/m) are the values in its middle at the largest
    pressure; they fall off like a Gaussian.
    """

    name: ClassVar[str] = 'weak_chamber'
    rigidity_loss: float = quantity(0.0, unit='-', bounds=(0.0, 0.9))
    curvature_dip: float = quantity(0.0, unit='1/m', bounds=(-500.0, 500.0))
    place: float = quantity(0.5, unit='-', meaning='s / l', bounds=(0.0, 1.0))
    width: float = quantity(
        0.04, unit='-', meaning='standard deviation, s / l', bounds=(0.005, 1.0)
    )

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Reduce stiffness and rotation of the joints of the chamber."""
        profile = np.exp(-0.5 * ((places(chain) / arm.length - self.place) / self.width) ** 2)
        grown = (np.maximum(chamber, 0.0) / arm.pressure_range[1])[:, None] ** 3 * profile
        span = np.full(chain.turning.shape[1], chain.element)
        span[[0, -1]] *= 0.5
        return replace(
            chain,
            rigidity_factors=freeze(chain.rigidity_factors * (1.0 - self.rigidity_loss * grown)),
            turning=freeze(chain.turning - self.curvature_dip * grown * span),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPeriodicDisturbance(LabEffect):
    """The intrinsic curvature oscillates, unmeasured: x (1 + amplitude sin(2 pi t / period)).

    Time starts at the beginning of every recording, and with a live lab.
    """

    name: ClassVar[str] = 'periodic_disturbance'
    amplitude: float = quantity(0.0, unit='-', bounds=(0.0, 1.0))
    period: float = quantity(5.0, unit='s', bounds=(0.05, 1e4))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let the intrinsic curvature oscillate."""
        swing = 1.0 + self.amplitude * np.sin(2.0 * math.pi * course.time / self.period)
        return replace(course, weights=freeze(course.weights * swing[:, None])), past


@dataclass(frozen=True, slots=True, kw_only=True)
class LabTouchingPeg(LabEffect):
    """A stiff stop: one place of the arm cannot pass a height y (see `Peg`)."""

    name: ClassVar[str] = 'touching_peg'
    stiffness: float = quantity(0.0, unit='N/m', bounds=(0.0, 1e5))
    place: float = quantity(
        0.6, unit='-', meaning='s / l of the place that touches', bounds=(0.05, 1.0)
    )
    height: float = quantity(0.02, unit='m', meaning='y of the stop', bounds=(-10.0, 10.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Add the stop."""
        position = self.place * arm.length
        return replace(
            chain, peg=Peg(place=position, height=self.height, stiffness=self.stiffness)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPush(LabEffect):
    """An object pushes the arm at one place, along the normal there (see `Push`).

    The push acts from `begins` to `ends` (seconds from the start of the recording), with ramps of
    duration `ramp`, and repeats with the period `every`. When a push without `ramp` ends, an arm
    that has mass is plucked. In a live lab, time starts with the lab.
    """

    name: ClassVar[str] = 'push'
    force: float = quantity(
        0.0, unit='N', meaning='force along the normal (-sin theta, cos theta)', bounds=(-1e3, 1e3)
    )
    place: float = quantity(0.6, unit='-', meaning='s / l', bounds=(0.02, 1.0))
    begins: float = quantity(0.0, unit='s', meaning='start of the push', bounds=(0.0, 1e8))
    ends: float = quantity(math.inf, unit='s', meaning='end of the push', bounds=(0.0, math.inf))
    ramp: float = quantity(
        0.0, unit='s', meaning='duration of its rise and fall', bounds=(0.0, 1e5)
    )

    every: float = quantity(
        math.inf, unit='s', meaning='time from one push to the next', bounds=(1e-3, math.inf)
    )

    def force_at(self, time: Array) -> Array:
        """Return the force (n,) N at times (n,) s."""
        time = np.where(time < self.begins, time, self.begins + (time - self.begins) % self.every)
        inside = np.minimum(time - self.begins, self.ends - time)
        if self.ramp > 0.0:
            return freeze(self.force * np.clip(inside / self.ramp, 0.0, 1.0))
        return freeze(np.where(inside >= 0.0, self.force, 0.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Push."""
        push = Push(place=self.place * arm.length, force=self.force_at(chain.time))
        return replace(chain, pushes=(*chain.pushes, push))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabPulley(LabEffect):
    """The end force of the protocol is the tension of a string over a pulley.

    It pulls from the tip in equilibrium to eye_x, eye_y (base frame), but the sensor reads a force
    in the direction of the protocol.
    """

    name: ClassVar[str] = 'pulley'
    eye_x: float = quantity(
        math.inf, unit='m', meaning='x of the pulley; inf: none', bounds=(-1e3, math.inf)
    )
    eye_y: float = quantity(0.0, unit='m', bounds=(-1e3, 1e3))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Iterate on the direction of the pulley until the tip is stationary."""
        if math.isinf(self.eye_x):
            return chain
        tension = np.linalg.norm(chain.force, axis=1, keepdims=True)
        tip = np.full((len(chain.force), 2), np.nan)
        for _ in range(MOST_TURNS):
            x, y, _ = equilibrium_shape(chain).points(np.array([arm.reach]))
            found = np.column_stack([x[:, -1], y[:, -1]])
            if np.abs(found - tip).max() < TIP_RESTS * arm.length:
                return chain
            tip, direction = found, np.array([self.eye_x, self.eye_y]) - found
            force = tension * direction / np.linalg.norm(direction, axis=1, keepdims=True)
            chain = replace(chain, force=freeze(force))
        raise RequestError(
            f'the tip of the lab arm does not come to rest under its string to {self.eye_x:g}, '
            f'{self.eye_y:g} m: move the pulley further away, or reduce the pull',
            reason='no_equilibrium',
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSlippingBase(LabEffect):
    """The whole arm jumps at a fraction `moment` of the recording, and stays there."""

    name: ClassVar[str] = 'slipping_base'
    slip_x: float = quantity(0.0, unit='m', bounds=(-1.0, 1.0))
    slip_y: float = quantity(0.0, unit='m', bounds=(-1.0, 1.0))
    moment: float = quantity(0.5, unit='-', meaning='share of the recording', bounds=(0.0, 1.0))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Shift the later frames; with a given end load, a shift has no other effect."""
        slipped = (share >= self.moment)[:, None, None]
        return freeze(points + slipped * np.array([self.slip_x, self.slip_y]))


OUTSIDE_EFFECTS: dict[str, type[LabEffect]] = {
    effect.name: effect
    for effect in (
        LabHarmlessMismatch,
        LabWeakChamber,
        LabPeriodicDisturbance,
        LabTouchingPeg,
        LabPush,
        LabPulley,
        LabSlippingBase,
    )
}
ALL_EFFECTS = LAB_EFFECTS | OUTSIDE_EFFECTS  # available to scenarios, in order of application


def places(chain: Chain) -> Array:
    """Return the arclength (m) of the joints, (n + 1,)."""
    return freeze(chain.element * np.arange(chain.turning.shape[1], dtype=np.float64))

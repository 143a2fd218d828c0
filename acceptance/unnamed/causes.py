"""Hidden causes of the discovery trials, for which the library has no effect.

Their laws are not, word for word, those of the dictionary of discovery: they saturate, bend, swell
or wait where it has powers, means and plays. FIRST were there while discovery was written; LATER
were written when it was done, and nothing was tuned to them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.units import quantity
from pneunet_ros.discovery.covariates import PLAYS
from pneunet_ros.lab import outside_effects
from pneunet_ros.lab.chain import Chain, Push
from pneunet_ros.lab.lab_arm import LabArm
from pneunet_ros.lab.lab_effect import Course, LabEffect, Past
from pneunet_ros.lab.outside_effects import places


@dataclass(frozen=True, slots=True, kw_only=True)
class LabLeaningPush(LabEffect):
    """A push along the normal that comes with the pressure and saturates."""

    name: ClassVar[str] = 'leaning_push'
    force: float = quantity(0.0, unit='N', bounds=(-10.0, 10.0))
    place: float = quantity(0.6, unit='-', meaning='s / l', bounds=(0.02, 1.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Push."""
        force = self.force * np.tanh(np.maximum(chamber, 0.0) / (0.4 * arm.pressure_range[1]))
        push = Push(place=self.place * arm.length, force=freeze(force))
        return replace(chain, pushes=(*chain.pushes, push))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSwelling(LabEffect):
    """The arm gets longer, the faster the higher the pressure is: strain (e^(p / top) - 1)."""

    name: ClassVar[str] = 'swelling'
    strain: float = quantity(0.0, unit='-', bounds=(-0.2, 0.2))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Stretch."""
        grown = self.strain * np.expm1(np.maximum(chamber, 0.0) / arm.pressure_range[1])
        return replace(chain, rest=freeze(chain.rest + grown[:, None]))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabWideLens(LabEffect):
    """A lens of fourth order: measured = middle + away (1 + radial (r^2 + r^4) / 2)."""

    name: ClassVar[str] = 'wide_lens'
    radial: float = quantity(0.0, unit='-', bounds=(-0.3, 0.3))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Distort."""
        half = 0.5 * arm.length
        away = points - np.array([half, 0.0])
        squared = np.sum(away**2, axis=-1, keepdims=True) / half**2
        return freeze(points + 0.5 * self.radial * (squared + squared**2) * away)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSmoothPlay(LabEffect):
    """A hysteresis without corners: the side turns over with e^(-distance / width) (Bouc-Wen)."""

    name: ClassVar[str] = 'smooth_play'
    width: float = quantity(0.0, unit='Pa', bounds=(0.0, 1e5))

    def unfold(self, course: Course, past: Past) -> tuple[Course, Past]:
        """Let the chamber lag behind by half a width, on either side."""
        side, before = past or (0.0, float(course.chamber[0]))
        sides = np.empty(course.chamber.size)
        for place, pressure in enumerate(course.chamber.tolist()):
            change = pressure - before
            side = math.copysign(1.0, change) + (side - math.copysign(1.0, change)) * math.exp(
                -abs(change) / (0.7 * self.width + 1e-9)
            )
            sides[place], before = side, pressure
        return course.with_chamber(freeze(course.chamber - 0.5 * self.width * sides)), (
            side,
            before,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabYieldingClamp(LabEffect):
    """The clamp turns with the pressure in it, as a root does: turn (p / top)^0.7."""

    name: ClassVar[str] = 'yielding_clamp'
    turn: float = quantity(0.0, unit='rad', bounds=(-1.0, 1.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Turn the joint at the clamp."""
        share = np.maximum(chamber, 0.0) / arm.pressure_range[1]
        turning = chain.turning.copy()
        turning[:, 0] += self.turn * (share**0.7 - share)
        return replace(chain, turning=freeze(turning))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabHeavyTube(LabEffect):
    """A tube hangs on the arm, as a load along E2 all over it that comes and goes: load per m."""

    name: ClassVar[str] = 'heavy_tube'
    load: float = quantity(0.0, unit='N/m', bounds=(-100.0, 100.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Load the arm from every element to its end."""
        count = chain.turning.shape[1] - 1
        beyond = chain.length * (1.0 - (np.arange(count) + 0.5) / count)
        share = np.sin(0.5 * math.pi * np.clip(chamber / arm.pressure_range[1], 0.0, 1.0))
        line = np.zeros((len(chamber), count, 2))
        line[:, :, 1] = self.load * share[:, None] * beyond
        return replace(chain, line=freeze(chain.line + line))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabGluedPatch(LabEffect):
    """A patch is glued on: stiffer by a share over a short stretch, with soft edges."""

    name: ClassVar[str] = 'glued_patch'
    gain: float = quantity(0.0, unit='-', bounds=(-0.9, 10.0))
    place: float = quantity(0.5, unit='-', meaning='s / l', bounds=(0.0, 1.0))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Stiffen the joints there."""
        away = np.abs(places(chain) / arm.length - self.place)
        here = 1.0 / (1.0 + np.exp((away - 0.06) / 0.012))
        return replace(
            chain, rigidity_factors=freeze(chain.rigidity_factors * (1.0 + self.gain * here))
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSlantedCamera(LabEffect):
    """A camera that looks from the side: measured = true / (1 - slant x / l)."""

    name: ClassVar[str] = 'slanted_camera'
    slant: float = quantity(0.0, unit='-', bounds=(-0.3, 0.3))

    def see(self, arm: LabArm, points: Array, share: Array) -> Array:
        """Project."""
        return freeze(points / (1.0 - self.slant * points[..., :1] / arm.length))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabShyForceSensor(LabEffect):
    """A force sensor that reads too little, the more so the stronger the pull is."""

    name: ClassVar[str] = 'shy_force_sensor'
    loss: float = quantity(0.0, unit='-', bounds=(0.0, 0.5))

    def read(self, arm: LabArm, pressure: Array, force: Array) -> tuple[Array, Array]:
        """Take a part away."""
        pull = np.hypot(force[:, 0], force[:, 1])[:, None] / arm.weight
        return pressure, freeze(force * (1.0 - self.loss * np.minimum(0.5 + 0.4 * pull, 1.2)))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabSwingingPush(LabEffect):
    """A push along the normal that swings slowly: force sin(2 pi t / period)."""

    name: ClassVar[str] = 'swinging_push'
    force: float = quantity(0.0, unit='N', bounds=(-10.0, 10.0))
    place: float = quantity(0.6, unit='-', meaning='s / l', bounds=(0.02, 1.0))
    period: float = quantity(23.0, unit='s', bounds=(0.1, 1e4))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Push."""
        force = self.force * np.sin(2.0 * math.pi * chain.time / self.period)
        push = Push(place=self.place * arm.length, force=freeze(force))
        return replace(chain, pushes=(*chain.pushes, push))


@dataclass(frozen=True, slots=True, kw_only=True)
class LabVisitingLoad(LabEffect):
    """Something is hung on a place of the arm and taken off again: a load along E2, N."""

    name: ClassVar[str] = 'visiting_load'
    load: float = quantity(0.0, unit='N', bounds=(-10.0, 10.0))
    begins: float = quantity(9.0, unit='s', bounds=(0.0, 1e4))
    ends: float = quantity(21.0, unit='s', bounds=(0.0, 1e4))

    def build(self, arm: LabArm, chain: Chain, chamber: Array) -> Chain:
        """Hang it on the tip, which no sensor feels."""
        there = (chain.time >= self.begins) & (chain.time < self.ends)
        force = chain.force + self.load * there[:, None] * np.array([0.0, 1.0])
        return replace(chain, force=freeze(force))


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A cause, and what a reader would call right.

    effect: name in the lab; size: its parameter, weakest and strongest; fixed: its others;
    withheld: effects of the library that are not considered; kinds and terms: those of discovery
    that a reader maps to it; place: parameter that says where, '' for none; coefficient: of the
    term over the size, NaN where the term is not quite the law.
    """

    effect: str
    size: tuple[str, float, float]
    kinds: frozenset[str]
    terms: frozenset[str]
    withheld: tuple[str, ...] = ()
    fixed: tuple[tuple[str, float], ...] = ()
    place: str = ''
    coefficient: float = math.nan
    later: bool = False


POWERS = frozenset({'p', 'p^2'})
ALWAYS = frozenset({'1'})
FIRST = (
    Cause(
        effect='push',
        size=('force', 0.012, 0.08),
        kinds=frozenset({'push'}),
        terms=ALWAYS,
        withheld=('contact',),
        place='place',
        coefficient=1.0,
    ),
    Cause(
        effect='leaning_push',
        size=('force', 0.012, 0.08),
        kinds=frozenset({'push'}),
        terms=POWERS | ALWAYS,
        withheld=('contact',),
        place='place',
    ),
    Cause(
        effect='weak_chamber',
        size=('rigidity_loss', 0.3, 0.88),
        fixed=(('curvature_dip', 8.0), ('width', 0.04)),
        kinds=frozenset({'section_stiffness', 'bump'}),
        terms=POWERS,
        place='place',
    ),
    Cause(
        effect='periodic_disturbance',
        size=('amplitude', 0.01, 0.1),
        fixed=(('period', 4.7),),
        kinds=frozenset({'chamber_pressure', 'curvature'}),
        terms=frozenset({'period'}),
    ),
    Cause(
        effect='lens_distortion',
        size=('radial', 1.6, 12.0),  # 1/m^2: 0.004 to 0.03 half a length from the middle
        kinds=frozenset({'camera_radial'}),
        terms=ALWAYS,
        withheld=('lens_distortion',),
    ),
    Cause(
        effect='swelling',
        size=('strain', 0.002, 0.03),
        kinds=frozenset({'stretch'}),
        terms=POWERS,
        withheld=('pressure_elongation',),
    ),
    Cause(
        effect='smooth_play',
        size=('width', 200.0, 2500.0),
        kinds=frozenset({'chamber_pressure'}),
        terms=frozenset(PLAYS),
        withheld=('hysteresis',),
        coefficient=-0.5,
    ),
    Cause(
        effect='wide_lens',
        size=('radial', 0.004, 0.03),
        kinds=frozenset({'camera_radial'}),
        terms=ALWAYS,
        withheld=('lens_distortion',),
    ),
)
LATER = (
    Cause(
        effect='yielding_clamp',
        size=('turn', 0.05, 0.6),
        kinds=frozenset({'clamp_turn'}),
        terms=POWERS | {'moment at the clamp'},
        withheld=('clamp_compliance',),
        later=True,
    ),
    Cause(
        effect='heavy_tube',
        size=('load', 0.05, 0.8),
        kinds=frozenset({'line_load_y'}),
        terms=POWERS,
        withheld=('gravity',),
        later=True,
    ),
    Cause(
        effect='glued_patch',
        size=('gain', 0.3, 3.0),
        kinds=frozenset({'section_stiffness'}),
        terms=ALWAYS,
        place='place',
        later=True,
    ),
    Cause(
        effect='slanted_camera',
        size=('slant', 0.006, 0.05),
        kinds=frozenset({'camera_perspective_x'}),
        terms=ALWAYS,
        withheld=('camera_tilt', 'camera_scale'),
        coefficient=1.0,
        later=True,
    ),
    Cause(
        effect='shy_force_sensor',
        size=('loss', 0.02, 0.25),
        kinds=frozenset({'end_force_x', 'end_force_y'}),
        terms=frozenset({'F1', 'F2', '|F|'}),
        later=True,
    ),
)
BY_ITSELF = (
    Cause(
        effect='swinging_push',
        size=('force', 0.004, 0.02),
        kinds=frozenset({'push'}),
        terms=frozenset({'period'}),
        place='place',
        later=True,
    ),
    Cause(
        effect='visiting_load',
        size=('load', 0.004, 0.02),
        kinds=frozenset({'end_force_y', 'push'}),
        terms=frozenset({'period'}),
        later=True,
    ),
)
CAUSES = {item.effect: item for item in (*FIRST, *LATER, *BY_ITSELF)}
NEW = (
    LabLeaningPush,
    LabSwelling,
    LabWideLens,
    LabSmoothPlay,
    LabYieldingClamp,
    LabHeavyTube,
    LabGluedPatch,
    LabSlantedCamera,
    LabShyForceSensor,
    LabSwingingPush,
    LabVisitingLoad,
)


def add_causes() -> None:
    """Let the virtual lab of this process make them: its own table does not have them."""
    outside_effects.ALL_EFFECTS.update({effect.name: effect for effect in NEW})

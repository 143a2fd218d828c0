"""Most likely meaning of end wrench readings: unit x sign x yaw x tare.

In complex numbers f = F1 + i F2, a force sensor reading is u e^(i yaw) f + tare in the base frame.
With measured targets, which determine the true force, conventions are compared by their residuals;
without targets, by the loads of the calibration.
"""

from __future__ import annotations

import cmath
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.measurement.meaning.reading_judge import (
    JudgeSettings,
    ranked,
    RARER,
    ReadingVerdict,
)
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN

FORCE_UNITS = ('N', 'mN', 'gf', 'kgf', 'lbf')
Forces = npt.NDArray[np.complex128]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchJudgeSettings(JudgeSettings):
    """Priors for the convention of a force sensor, and the required odds."""

    model_error: float = tuning(
        0.15,
        'error of the force estimated from targets',
        unit='of the largest force',
        source='convention: in new conditions, targets alone do not determine the force better',
    )


JUDGE = WrenchJudgeSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchConvention:
    """Possible meaning of the numbers of a force sensor.

    unit: one of FORCE_UNITS. sign: -1 if the reaction is reported. yaw (rad) of its axes in the
    base frame, counter-clockwise. offset_x, offset_y (N, base frame): added at the end. frame: the
    frame id of its messages, '' for the base frame.
    """

    unit: str = 'N'
    sign: int = 1
    yaw: float = 0.0
    offset_x: float = 0.0
    offset_y: float = 0.0
    frame: str = ''

    @property
    def size(self) -> float:
        """The unit in N."""
        return SI_PER_UNIT['force'][self.unit.lower()]

    @property
    def factor(self) -> complex:
        """The factor for complex readings."""
        return self.sign * self.size * cmath.exp(1j * self.yaw)

    @property
    def offset(self) -> complex:
        """The offset added to readings (N)."""
        return complex(self.offset_x, self.offset_y)

    def force(self, reading: Forces) -> Forces:
        """Return the end force F1 + i F2 (N) that corresponds to complex readings."""
        return self.factor * reading + self.offset

    def reading(self, force: Forces) -> Forces:
        """Return the sensor reading at complex end forces (N)."""
        return (force - self.offset) / self.factor

    @property
    def words(self) -> str:
        """Describe the meaning: 'in gf, as the reaction, with its axes turned by 90 degrees'."""
        parts = [f'in {self.unit}']
        parts += ['as the reaction'] * (self.sign < 0)
        parts += [f'with its axes turned by {math.degrees(self.yaw):.0f} degrees'] * bool(self.yaw)
        if self.offset:
            parts.append(f'with ({-self.offset_x:.3g}, {-self.offset_y:.3g}) N at no load')
        return ', '.join(parts)

    def changes_from(self, other: WrenchConvention) -> dict[str, str]:
        """Return the settings that change another convention into this one."""
        shown = {
            'wrench_frame': (self.frame, other.frame),
            'wrench_unit': (self.unit, other.unit),
            'wrench_sign': (str(self.sign), str(other.sign)),
            'wrench_yaw': (f'{self.yaw:.4g}', f'{other.yaw:.4g}'),
            'force_offset_x': (f'{self.offset_x:.4g}', f'{other.offset_x:.4g}'),
            'force_offset_y': (f'{self.offset_y:.4g}', f'{other.offset_y:.4g}'),
        }
        return {name: new for name, (new, old) in shown.items() if new != old}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShownForces:
    """End forces (frames,) N estimated from targets, their std (frames,) N, and the readings.

    scale (N): the largest force of the calibration, to which errors of the model are relative.
    """

    force: Forces
    std: Array
    reading: Forces
    scale: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExpectedLoad:
    """The loads for which a model was calibrated.

    largest (N); beyond: distance by which complex forces (N), one per pressure, exceed the
    calibrated ones, relative to the size of these.
    """

    largest: float
    beyond: Callable[[Forces], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrenchVerdict(ReadingVerdict[WrenchConvention]):
    """The most likely convention of a force sensor's readings.

    largest: the largest reading, in the sensor's unit; frame: the frame of the messages if it was
    not declared.
    """

    largest: float
    frame: str = ''

    @property
    def contradicted(self) -> bool:
        """Whether the declared convention is almost certainly wrong."""
        return bool(self.frame) or self.log_odds > self.limit

    @property
    def finding(self) -> str:
        """Describe the likely meaning of the readings in one sentence without a remedy."""
        if self.frame and self.log_odds <= self.limit:
            return f'in frame {self.frame!r}, presumably with the axes of the arm'
        one, other = (self.largest * meaning.size for meaning in (self.other, self.declared))
        where = f'in frame {self.frame!r}, and ' if self.frame else ''
        return (
            f'{where}most likely {self.other.words}: {self.largest:.3g} means {one:.3g} N; read '
            f'{self.declared.words}, it would be {other:.3g} N, which does not fit the arm'
        )


def judge_wrench(
    readings: Forces,
    declared: WrenchConvention,
    expected: ExpectedLoad | None,
    shown: ShownForces | None,
) -> WrenchVerdict | None:
    """Weigh all meanings of the readings of a force sensor against the declared one.

    Args:
        readings: complex (readings,), in the unit and the axes of the sensor, as many as the
            pressures of `expected`.
        declared: the declared meaning of the readings.
        expected: the loads that the model predicts; None: unknown.
        shown: the forces estimated from measured targets; None: no targets.

    Returns:
        The verdict; None if all readings are zero, or there is nothing to compare with.
    """
    largest = float(np.max(np.abs(readings), initial=0.0))
    if largest == 0.0 or (expected is None and shown is None):
        return None
    weights = {
        meaning: log_prior(meaning, declared)
        + log_range(readings, meaning, expected)
        + log_shown(shown, meaning)
        for meaning in meanings(declared, shown)
    }
    other = ranked(weights, declared)[0]
    return WrenchVerdict(
        declared=declared,
        other=other,
        log_odds=weights[other] - weights[declared],
        largest=largest,
        limit=JUDGE.log_odds,
    )


def expected_load(arm: Arm, pressure: Array) -> ExpectedLoad | None:
    """Return the calibrated loads of a model at pressures (n,) Pa, one per compared force."""
    if arm.load_hull is None or arm.domain is None:
        return None
    hull, noise = arm.load_hull, arm.sensors
    at = np.clip(pressure, *arm.pressure_range).tolist()
    resolution = [DOMAIN.significant * std for std in (noise.force_std, noise.force_std, 0.0, 0.0)]

    def beyond(forces: Forces) -> float:
        loads = ([one.real, one.imag, 0.0, p] for one, p in zip(forces.tolist(), at, strict=True))
        return max(hull.share(hull.distance(load, resolution)) for load in loads)

    return ExpectedLoad(largest=arm.domain.largest_force, beyond=beyond)


def load_hint(arm: Arm, declared: WrenchConvention, force: complex, pressure: float) -> str:
    """Suggest the likely meaning of a load (N) outside the domain; empty if no meaning fits."""
    reading = declared.reading(np.array([force]))
    expected = expected_load(arm, np.array([pressure]))
    verdict = judge_wrench(reading, declared, expected, None)
    if verdict is None or verdict.log_odds < 0.0:
        return ''
    return f'; the end wrench is {verdict.finding}: set {verdict.parameters} if so'


def meanings(declared: WrenchConvention, shown: ShownForces | None) -> Iterator[WrenchConvention]:
    """Yield the declared meaning and all others; with targets, also the fitted yaw and tare."""
    right = 0.5 * math.pi
    turns = (0.0, right, -right) if shown is None else (0.0, right, -right, best_yaw(shown))
    for unit, sign, turn in product(FORCE_UNITS, (1, -1), turns):
        yaw = math.remainder(declared.yaw + turn, 2.0 * math.pi)
        meaning = replace(declared, unit=unit, sign=sign, yaw=yaw if turn else declared.yaw)
        yield meaning
        if shown is not None:
            weight = 1.0 / shown.std**2
            mean_residual = np.sum(weight * (shown.force - meaning.force(shown.reading))) / np.sum(
                weight
            )
            yield replace(
                meaning,
                offset_x=meaning.offset_x + float(mean_residual.real),
                offset_y=meaning.offset_y + float(mean_residual.imag),
            )


def best_yaw(shown: ShownForces) -> float:
    """Return the rotation (rad) of the readings that fits the forces best, in any unit."""
    weight = 1.0 / shown.std**2
    product_ = np.sum(weight * shown.force * np.conj(shown.reading))
    angle = math.remainder(cmath.phase(complex(product_)), math.pi)  # regardless of the sign
    return round(angle, 2)


def log_prior(meaning: WrenchConvention, declared: WrenchConvention) -> float:
    """Return the log prior of a convention, given the declared one."""
    weight = 0.0
    if meaning.unit != declared.unit:
        weight += math.log(JUDGE.other_unit)
    if meaning.sign != declared.sign:
        weight += math.log(JUDGE.uncommon)
    turn = math.remainder(meaning.yaw - declared.yaw, 2.0 * math.pi)
    if turn:
        right = abs(abs(turn) - 0.5 * math.pi) < 1e-9
        weight += math.log(JUDGE.other_unit / (1.0 if right else RARER))
    if meaning.offset != declared.offset:
        weight += math.log(JUDGE.other_unit)
    return weight


def log_range(readings: Forces, meaning: WrenchConvention, expected: ExpectedLoad | None) -> float:
    """Return the log likelihood of the size and the direction of the loads."""
    if expected is None or expected.largest <= 0.0:
        return 0.0
    force = meaning.force(readings)
    used = min(float(np.max(np.abs(force))) / expected.largest, 1.0)
    beyond = expected.beyond(force)
    # Student's t with three degrees of freedom: loads of another experiment are possible.
    squared_deviation = (beyond / JUDGE.beyond) ** 2
    inside = 1.0 if beyond == 0.0 else JUDGE.uncommon / (1.0 + squared_deviation) ** 2
    return math.log(2.0 * used**2 + JUDGE.rare) + math.log(inside)


def log_shown(shown: ShownForces | None, meaning: WrenchConvention) -> float:
    """Return the log likelihood of the forces estimated from targets."""
    if shown is None:
        return 0.0
    largest = max(float(np.max(np.abs(shown.force))), shown.scale)
    noise = shown.std**2 + (JUDGE.model_error * largest) ** 2
    square = np.abs(shown.force - meaning.force(shown.reading)) ** 2 / noise
    return -0.5 * len(square) * math.log(1.0 + float(np.mean(square)))

"""Most likely meaning of pressure readings: unit x reference x sign x zero.

Each meaning is a hypothesis with a prior. Its likelihood is that of three features of the
readings: the reading at rest, the reading furthest from rest, and the noise. The first two are
compared on a logarithmic scale, so that a unit alone is not evidence. If targets were measured,
the fit of the model to them counts as well. Live nodes and offline verbs use the same function.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
import math

from pneunet_ros.core.settings import tuning
from pneunet_ros.core.units import kilopascals, PRESSURE_UNITS
from pneunet_ros.effects.pressure_offset import PressureOffset
from pneunet_ros.measurement.meaning.pressure_convention import ABSOLUTE, GAUGE, PressureConvention
from pneunet_ros.measurement.meaning.reading_judge import (
    JudgeSettings,
    ranked,
    RARER,
    ReadingVerdict,
)
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureJudgeSettings(JudgeSettings):
    """Priors of pressure conventions, and the odds required to decide."""

    zero_span: float = tuning(
        0.2,
        'one sigma of a zero that was never set',
        unit='of the range',
        source='convention: beyond it, a sensor counts as broken',
    )
    unusual: float = tuning(
        0.1,
        'share of recordings in which the arm is always vented, or never, or is another one than '
        'the shipped one although no model is given',
        source='convention: one of ten',
    )
    decades: float = tuning(
        6.0,
        'range over which the logarithm of a zero error is uniform',
        unit='decades',
        source='convention: from the last digit of a 20 bit converter to the full scale',
    )
    another_arm: float = tuning(
        1e-4,
        'share of recordings of an arm with a very different range from that of the model',
        source='convention: so small that the range counts',
    )
    noise_spread: float = tuning(
        5.0,
        'one sigma of the ratio of the noise to that of the model',
        source=(
            'convention: converters of the same kind differ by less, those of different kinds '
            'by more'
        ),
    )
    model_error: float = tuning(
        0.02,
        'error of a correct model',
        unit='of the length',
        source='convention: models of soft arms are rarely better in new conditions',
    )


JUDGE = PressureJudgeSettings()
# Largest zero error of a usual gauge (Pa), of either sign.
ZERO_ERROR = float(PressureOffset.__dataclass_fields__['offset'].metadata['prior'][1])
USUAL_UNITS = ('Pa', 'hPa', 'kPa', 'bar', 'psi')
RARE_UNITS = ('MPa', 'mmHg')  # all others are close to one of these, or are stated by users
# Atmospheric pressure (Pa) below 500 m, where 0.75 of all people live (Cohen and Small, PNAS 95,
# 1998), and below 2700 m, each with its share (ISO 2533, weather).
AIR = ((95e3, 105e3), 0.75), ((72e3, 105e3), 0.25)
WHITE_SPAN = 8.0  # sigma: range of 10 000 normal values
LEAST = 1e-300  # smallest number with a finite logarithm
FULL_VACUUM = 1.0e5  # Pa below the atmosphere: no lower pressure is possible
IMPOSSIBLE = -1e6  # log likelihood of an impossible reading


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureRecord:
    """Statistics of the readings of a pressure sensor, in its unit.

    low, high: extremes of running medians of three readings, so that single glitches do not count;
    first: the first reading; last: the last two. steps: sum of squared differences; curved,
    log_curved: number of nonzero second differences, and the sum of the logarithms of their size.
    """

    count: int = 0
    first_ns: int = 0
    last_ns: int = 0
    low: float = math.inf
    high: float = -math.inf
    first: float = 0.0
    last: tuple[float, ...] = ()
    steps: float = 0.0
    curved: int = 0
    log_curved: float = 0.0

    def after(self, stamp_ns: int, reading: float) -> PressureRecord:
        """Return the record with one more reading, which is finite."""
        recent = (*self.last, reading)
        median = sorted(recent)[len(recent) // 2]
        started = self.count > 1  # the median of two readings is one of them
        step = reading - self.last[-1] if self.last else 0.0
        second = recent[2] - 2.0 * recent[1] + recent[0] if len(recent) == 3 else 0.0
        curved = second != 0.0
        return PressureRecord(
            count=self.count + 1,
            first_ns=self.first_ns if self.count else stamp_ns,
            last_ns=stamp_ns,
            low=min(self.low, median) if started else min(recent),
            high=max(self.high, median) if started else max(recent),
            first=self.first if self.count else reading,
            last=recent[-2:],
            steps=self.steps + step * step,
            curved=self.curved + curved,
            log_curved=self.log_curved + (math.log(abs(second)) if curved else 0.0),
        )

    @property
    def seconds(self) -> float:
        """Time (s) from the first reading to the last."""
        return (self.last_ns - self.first_ns) * 1e-9

    @property
    def noise(self) -> float:
        """White noise (one sigma) from second differences; 0 if most of them are zero."""
        if 2 * self.curved <= self.count - 2 or not self.curved:
            return 0.0
        # E log |x| of a normal x is log sigma - (euler gamma + log 2) / 2; sigma is sqrt(6) of it.
        return math.exp(self.log_curved / self.curved + 0.6352) / math.sqrt(6.0)

    @property
    def returned(self) -> bool:
        """Whether the last reading is nearer to an end of the range than to its middle.

        A pressure that is still rising does not show how far it will go.
        """
        if not self.last:
            return False
        fraction = (self.last[-1] - self.low) / (self.high - self.low or 1.0)
        return fraction < 0.25 if abs(self.high) > abs(self.low) else fraction > 0.75

    @property
    def whiteness(self) -> float:
        """Range divided by the noise estimated from successive differences."""
        step = math.sqrt(self.steps / max(self.count - 1, 1) / 2.0)
        return (self.high - self.low) / step if 0.0 < step < math.inf else 0.0


def record_of(stamp_ns: Iterable[int], readings: Iterable[float]) -> PressureRecord:
    """Return the record of these readings, in the unit of the sensor."""
    record = PressureRecord()
    for stamp, reading in zip(stamp_ns, readings, strict=True):
        record = record.after(stamp, reading)
    return record


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedPressure:
    """Calibrated gauge pressures (Pa) of an arm.

    std (Pa): noise of its sensor, 0 if unknown; share: prior probability of this arm; vented:
    whether its recordings begin or end at rest.
    """

    low: float
    high: float
    std: float = 0.0
    name: str = 'a soft actuator'
    share: float = 1.0
    vented: bool = False

    @property
    def reach(self) -> float:
        """Largest absolute pressure (Pa)."""
        return max(abs(self.low), abs(self.high))


def expected_of(arm: Arm) -> ExpectedPressure:
    """Return the readings expected from a calibrated arm."""
    low, high = arm.pressure_range
    return ExpectedPressure(low=low, high=high, std=arm.sensors.pressure_std, name=arm.name)


# Without a model: 3 kPa to the 700 kPa of a shop line, and vacuum; the shares are a convention.
# Only a vented arm distinguishes pressure and vacuum from a zero that was never set.
ANY_ACTUATOR = tuple(
    ExpectedPressure(low=low, high=high, share=share, vented=low < 0.0 < high)
    for low, high, share in (
        (0.0, 3e3, 0.05),
        (0.0, 1e4, 0.2),
        (0.0, 3e4, 0.25),
        (0.0, 1e5, 0.25),
        (0.0, 3e5, 0.1),
        (0.0, 7e5, 0.05),
        (-3e4, 0.0, 0.05),
        (-9e4, 0.0, 0.05),
        (-9e4, 1e5, 0.005),  # rarer than a zero that is off by 5 kPa
    )
)


def expected_without_model(shipped: Arm) -> tuple[ExpectedPressure, ...]:
    """Return the readings expected without a model: of the shipped arm, or of any other arm."""
    other_actuators = (replace(one, share=JUDGE.unusual * one.share) for one in ANY_ACTUATOR)
    return (expected_of(shipped), *other_actuators)


Fit = Callable[[PressureConvention], tuple[float, int]]
"""Mean squared error of the predicted targets over the length squared; number of levels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureVerdict(ReadingVerdict[PressureConvention]):
    """Most likely meaning of the readings of a pressure sensor.

    alternatives: further meanings that are nearly as likely as the other one. low, high: range of
    the readings, in the unit of the sensor; name: of the actuator used for comparison;
    is_other_actuator: whether the declaration is right but the readings are almost certainly from
    another kind of actuator.
    """

    alternatives: tuple[PressureConvention, ...]
    low: float
    high: float
    name: str
    is_other_actuator: bool = False

    def range_of(self, meaning: PressureConvention) -> str:
        """Return the range of the readings under a meaning, in kPa gauge."""
        low, high = sorted(kilopascals(meaning.gauge(end)) for end in (self.low, self.high))
        return f'{format_number(low)} to {format_number(high)} kPa gauge'

    @property
    def finding(self) -> str:
        """Describe the likely meaning of the readings in one sentence without a remedy."""
        alternatives = list(dict.fromkeys(one.words for one in self.alternatives))[:2]
        or_else = f' (or {" or ".join(alternatives)})' if alternatives else ''
        return (
            f'most likely {self.other.words}: {self.low:.4g} to {self.high:.4g} is '
            f'{self.range_of(self.other)}{or_else}; read as {self.declared.words}, it would be '
            f'{self.range_of(self.declared)}, which does not look like readings of {self.name}'
        )

    @property
    def model_mismatch(self) -> str:
        """Describe readings that need another model; empty if this model fits."""
        if self.contradicted or not self.is_other_actuator:
            return ''
        below = self.declared.gauge(self.low) + self.declared.gauge(self.high) < 0.0
        return (
            f'the pressure, {self.range_of(self.declared)}, does not match the default model, '
            f'{self.name}: give --model '
            f'FILE{"; if the ports of the sensor are swapped, --pressure-sign -1" * below}'
        )


def format_number(value: float) -> str:
    """Return a number with three digits; 0 below 0.005."""
    return f'{0.0 if abs(value) < 5e-3 else value:.3g}'


def judge_pressure(
    record: PressureRecord,
    declared: PressureConvention,
    expected: Sequence[ExpectedPressure],
    *,
    fit: Fit | None = None,
    moves: bool = False,
    running: bool = False,
) -> PressureVerdict | None:
    """Weigh all meanings of readings against the declared one.

    Args:
        record: the statistics of the readings, in the unit of the sensor.
        declared: their declared meaning.
        expected: the expected pressures, of one arm or of several with their shares.
        fit: returns the fit of a model to measured targets under a meaning; None: no targets.
        moves: whether the arm is known to bend, so that its pressure changes.
        running: whether more readings will follow, possibly larger ones.

    Returns:
        The verdict; None if there is no reading, or all are the same number, zero.
    """
    if not record.count or (record.low == record.high == 0.0):
        return None
    features = features_of(record, moves, not running or record.returned)

    def by_actuator(meaning: PressureConvention) -> list[float]:
        return [
            math.log(one.share)
            + log_prior(meaning, declared, one)
            + log_likelihood(features, meaning, declared, one)
            for one in expected
        ]

    weights = {
        meaning: log_sum(by_actuator(meaning)) for meaning in meanings(record, declared, expected)
    }
    if fit is not None:
        for meaning in weights:
            square, levels = fit(meaning)
            weights[meaning] -= 0.5 * levels * math.log(square + JUDGE.model_error**2)
    if len(weights) < 2:
        return None
    other, *rest = ranked(weights, declared)
    first, *other_actuators = by_actuator(declared)
    alternatives = [one for one in rest if weights[other] - weights[one] < JUDGE.log_odds]
    return PressureVerdict(
        declared=declared,
        other=other,
        alternatives=tuple(one for one in alternatives if one.words != other.words),
        log_odds=weights[other] - weights[declared],
        low=record.low,
        high=record.high,
        name=expected[0].name,
        limit=JUDGE.log_odds,
        is_other_actuator=bool(other_actuators)
        and log_sum(other_actuators) - first > JUDGE.log_odds,
    )


def log_sum(logs: Sequence[float]) -> float:
    """Return log(sum(exp(values)))."""
    top = max(logs)
    return top + math.log(sum(math.exp(value - top) for value in logs))


def normal(deviation: float) -> float:
    """Return the normal density at this many sigma, relative to its peak."""
    return math.exp(-0.5 * deviation * deviation)


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """Features of a record that do not depend on the convention.

    low, high, noise: as in the record; ends: its first and last readings; constant: probability
    that the readings are of a constant pressure; moves: whether the arm is known to move;
    complete: whether no readings will follow.
    """

    low: float
    high: float
    ends: tuple[float, float]
    noise: float
    constant: float
    moves: bool
    complete: bool


def features_of(record: PressureRecord, moves: bool, complete: bool) -> Features:
    """Return the features of a record."""
    drift = math.log(max(record.whiteness / WHITE_SPAN, 1.0))
    return Features(
        low=record.low,
        high=record.high,
        ends=(record.first, record.last[-1]),
        noise=record.noise,
        constant=normal(drift),
        moves=moves,
        complete=complete,
    )


def meanings(
    record: PressureRecord, declared: PressureConvention, expected: Sequence[ExpectedPressure]
) -> Iterator[PressureConvention]:
    """Yield the declared and all other meanings; ambient pressure and zero follow from rest.

    An arm is at rest at the lowest reading, or at the highest if it is driven by vacuum.
    """
    yield declared
    rests = {(one.high < -one.low) for one in expected}
    own_size = PRESSURE_UNITS[declared.unit]
    other_units = [one for one in (*USUAL_UNITS, *RARE_UNITS) if PRESSURE_UNITS[one] != own_size]
    for unit, sign in product((declared.unit, *other_units), (1, -1)):
        gauge = replace(declared, unit=unit, reference=GAUGE, sign=sign, offset=0.0)
        is_declared = unit == declared.unit and sign == declared.sign
        if not is_declared or declared.reference == ABSOLUTE:
            yield gauge
        absolute = replace(gauge, reference=ABSOLUTE)
        if sign > 0 and (not is_declared or declared.reference == GAUGE):
            yield absolute
        for vacuum in rests:
            rest = record.high if vacuum == (sign > 0) else record.low
            if (
                is_declared
                and declared.reference == GAUGE
                and gauge.gauge(rest) != -declared.offset
            ):
                yield replace(gauge, offset=-gauge.gauge(rest))
            if sign > 0:  # no absolute sensor has a second port
                yield replace(absolute, ambient=rest * absolute.size)


def log_prior(
    meaning: PressureConvention, declared: PressureConvention, expected: ExpectedPressure
) -> float:
    """Return the log prior of a pressure convention, given the declared one."""
    weight = 0.0
    if meaning.unit != declared.unit:
        rare = meaning.unit in RARE_UNITS
        weight += math.log(JUDGE.other_unit / (RARER if rare else 1.0))
    if meaning.reference != declared.reference:
        weight += math.log(JUDGE.uncommon)
    if meaning.sign != declared.sign:
        weight += math.log(JUDGE.uncommon)
    if meaning.offset not in (0.0, declared.offset):
        smallest_offset = min(ZERO_ERROR, DOMAIN.pressure_margin * expected.reach)
        if abs(meaning.offset - declared.offset) < smallest_offset:
            return IMPOSSIBLE  # a zero error, not another meaning
        spread = math.hypot(JUDGE.zero_span * expected.reach, ZERO_ERROR)
        deviation = meaning.offset / spread
        weight += math.log(JUDGE.other_unit) - 0.5 * deviation * deviation
    return weight


def log_likelihood(
    features: Features,
    meaning: PressureConvention,
    declared: PressureConvention,
    expected: ExpectedPressure,
) -> float:
    """Return the log likelihood of the features of readings under one meaning."""
    low, high = sorted((meaning.gauge(features.low), meaning.gauge(features.high)))
    log_uniform = 1.0 / (JUDGE.decades * math.log(10.0))
    rest = max(low, -high, 0.0)
    held = JUDGE.unusual * min(rest / expected.reach, 1.0)
    if expected.vented:
        rest, held = min(abs(meaning.gauge(end)) for end in features.ends), 0.0
    at_zero = normal(rest / ZERO_ERROR)
    absolute = meaning.reference == ABSOLUTE
    air = air_density(meaning.ambient) if absolute else 0.0
    vented = (1.0 - JUDGE.unusual) * at_zero * (air if absolute else log_uniform)
    if absolute and meaning.ambient != declared.ambient:
        held = 0.0  # the lowest reading is the ambient pressure
    above = high if expected.high > ZERO_ERROR else 0.0
    below = -low if expected.low < -ZERO_ERROR else 0.0
    used = min(max(above, below, 0.0) / expected.reach, 1.0)
    # The largest pressure of a complete recording tends to be near the limit: Beta(2, 1).
    active = (1.0 - JUDGE.unusual) * (2.0 * used**2 if features.complete else used)
    constant = features.constant
    near_zero = normal(max(-low, high) / ZERO_ERROR) * constant
    resting = 0.0 if features.moves else JUDGE.unusual * log_uniform * near_zero
    least = ZERO_ERROR  # a calibration contains its zero error
    wrong_side = max(
        -low if expected.low > -least else 0.0, high if expected.high < least else 0.0
    )
    vacuum = JUDGE.rare + normal(wrong_side / ZERO_ERROR)
    margin = DOMAIN.pressure_margin
    span = max(expected.high, 0.0) - min(expected.low, 0.0)
    excess = max(high - max(expected.high, 0.0), min(expected.low, 0.0) - low, 0.0) / span
    leaves = JUDGE.uncommon * normal(excess / JUDGE.beyond)
    inside = 1.0 if excess <= margin else leaves + JUDGE.another_arm
    if (absolute and air == 0.0) or low < -FULL_VACUUM:
        return IMPOSSIBLE
    # Without any change of pressure the most distant reading is the one at rest, at any value.
    furthest = active + resting
    extremes = vented * furthest + held * (constant + (1.0 - constant) * furthest)
    return (
        math.log(max(extremes, LEAST))
        + math.log(vacuum)
        + math.log(inside)
        + log_noise(features.noise, meaning, expected)
    )


def air_density(ambient: float) -> float:
    """Return the prior density of the logarithm of the atmospheric pressure (Pa)."""
    density = 0.0
    for (low, high), share in AIR:
        if low <= ambient <= high:
            density += share / math.log(high / low)
    return density


def log_noise(noise: float, meaning: PressureConvention, expected: ExpectedPressure) -> float:
    """Return the log likelihood of the noise of readings; 0 if unknown or not expected."""
    if noise <= 0.0 or expected.std <= 0.0:
        return 0.0
    decades = abs(math.log10(noise * meaning.size / expected.std))
    return math.log(normal(decades / math.log10(JUDGE.noise_spread)) + JUDGE.rare)

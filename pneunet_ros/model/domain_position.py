"""Position of a load relative to the domain of a model: inside, slightly outside or far outside.

Estimator, replay, verbs and reports all use this rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

from pneunet_ros.core.units import kilopascals
from pneunet_ros.effects.effect import Load
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN, MOMENT, PRESSURE

OUT_OF_RANGE, LOAD_OUT_OF_DOMAIN = 'out_of_range', 'load_out_of_domain'
PRESSURE_BEYOND = 'pressure beyond the calibrated range: extrapolated'
LOAD_BEYOND = 'end load beyond the calibrated loads: extrapolated'
LOADS_UNKNOWN = 'the model has no domain, so the calibrated end loads are unknown'


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DomainPosition:
    """Position of a load relative to the domain of a model.

    pressure_beyond, load_beyond: distance outside, relative to the range and to the size of the
    load hull; 0 inside, load_beyond NaN if the model has no domain. error: one sigma of the model
    error outside, as independent errors of F1, F2 (N), M (N m) and p (Pa), 0 inside. reason and
    sentence: why an estimate is rejected, as a key and in words; empty if it is allowed. notes:
    limits of an estimate, in words without numbers.
    """

    pressure_beyond: float
    load_beyond: float
    error: tuple[float, float, float, float]
    reason: str
    sentence: str
    notes: tuple[str, ...]

    @property
    def extrapolated(self) -> bool:
        """Whether pressure or load is outside the calibrated domain."""
        return self.pressure_beyond > 0.0 or self.load_beyond > 0.0

    @property
    def words(self) -> str:
        """Description of the position, with numbers; empty inside."""
        if self.sentence:
            return self.sentence
        shares = (self.pressure_beyond, 'pressures'), (self.load_beyond, 'end loads')
        words = [
            f'extrapolated {100.0 * share:.1f} % beyond the calibrated {what}'
            for share, what in shares
            if share > 0.0
        ]
        return ', '.join([*words, *([LOADS_UNKNOWN] if LOADS_UNKNOWN in self.notes else [])])


def locate_load(
    arm: Arm, load: Load, chamber: float, std: tuple[float, float, float, float] | None = None
) -> DomainPosition:
    """Return the position of a true load at a chamber pressure (Pa) relative to the domain.

    std: one sigma of the readings of F1, F2 (N), M (N m) and pressure (Pa); None: as in the model.
    """
    sensors = arm.sensors
    std = std or (sensors.force_std, sensors.force_std, sensors.moment_std, sensors.pressure_std)
    noise = [DOMAIN.significant * sigma for sigma in std]
    low, high = arm.pressure_range
    inside = min(max(chamber, low), high)
    at = (load.force_x, load.force_y, load.moment, inside)
    pressure_beyond = arm.beyond_range(chamber)
    load_beyond, distance = distance_from_domain(arm, at, noise)
    reason, sentence = '', ''
    if pressure_beyond > DOMAIN.pressure_margin:
        reason, sentence = OUT_OF_RANGE, out_of_range(arm, chamber)
    elif load_beyond > DOMAIN.load_margin:
        reason, sentence = LOAD_OUT_OF_DOMAIN, out_of_domain(arm, at, load_beyond)
    notes = (
        (pressure_beyond > 0.0, PRESSURE_BEYOND),
        (load_beyond > 0.0, LOAD_BEYOND),
        (math.isnan(load_beyond), LOADS_UNKNOWN),
    )
    force = DOMAIN.load_error * distance
    excess = chamber - inside if pressure_beyond > 0.0 else 0.0
    error = (force, force, 0.0, DOMAIN.pressure_error * excess)
    return DomainPosition(
        pressure_beyond=pressure_beyond,
        load_beyond=load_beyond,
        error=error,
        reason=reason,
        sentence=sentence,
        notes=tuple(text for holds, text in notes if holds),
    )


def distance_from_domain(
    arm: Arm, at: Sequence[float], noise: Sequence[float]
) -> tuple[float, float]:
    """Return the distance of a load (4,) from the domain, relative to its size, and in N.

    NaN if the load exceeds its noise (4,) but the arm has no domain.
    """
    acting = at[:PRESSURE]
    if not any(acting):
        return 0.0, 0.0
    if arm.load_hull is None:
        exceeds_noise = any(abs(part) > noise[index] for index, part in enumerate(acting))
        return (math.nan if exceeds_noise else 0.0), 0.0
    distance = arm.load_hull.distance(at, noise)
    return arm.load_hull.share(distance), distance


def out_of_range(arm: Arm, pressure: float) -> str:
    """Return the message for a pressure (Pa) outside the model."""
    low, high = (kilopascals(value) for value in arm.pressure_range)
    return (
        f'pressure {kilopascals(pressure):.4g} kPa is outside the calibrated range '
        f'{low:.4g} to {high:.4g} kPa by more than {100.0 * DOMAIN.pressure_margin:.0f} % of it'
    )


def out_of_domain(arm: Arm, at: Sequence[float], beyond: float) -> str:
    """Return the message for a load (4,) SI outside the model."""
    load = (
        f'the end load {at[0]:.4g} N, {at[1]:.4g} N, {at[MOMENT]:.3g} N m at '
        f'{kilopascals(at[PRESSURE]):.4g} kPa'
    )
    assert arm.domain is not None and arm.load_hull is not None
    if arm.load_hull.size == 0.0:
        return f'{load} is outside the calibration, which had no loads'
    return (
        f'{load} is outside the calibrated loads (forces up to {arm.domain.largest_force:.3g} N) '
        f'by {beyond:.2g} times their size; only up to {DOMAIN.load_margin:g} times is '
        'extrapolated'
    )

"""Readings and frames, buffered until the matching ones arrive."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, replace
import math
from typing import TypeVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import TargetSightings, WrenchReading
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_since
from pneunet_ros.effects.effect import History, Load
from pneunet_ros.measurement.between_readings import error_between, rate_of
from pneunet_ros.measurement.blocks.timing import Timing
from pneunet_ros.measurement.swinging_arm import EquilibriumBetween

NEAR = 3  # readings on either side for the course of the pressure between two


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureInstant:
    """Chamber pressure (Pa, one sigma of its noise) and effects' history at a pressure reading.

    memory: internal pressures (Pa) of lags and of a play; step (Pa): smallest change between
    successive readings so far, see `rounding_error`; missed (Pa): interpolation error between two
    readings, included in std. gravity: along x and y, in g; None: as in the model. turn_rate
    (rad/s) of the base; NaN: unknown. rate (Pa/s): change of the pressure in time, known for a
    frame only.
    """

    stamp_ns: int
    gauge: float
    chamber: float
    std: float
    history: tuple[History, ...]
    memory: tuple[float, ...]
    step: float = math.inf
    missed: float = 0.0
    gravity: tuple[float, float] | None = None
    turn_rate: float = math.nan
    rate: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenFrame:
    """The first frame with these target positions (targets,) m, and its chamber pressure (Pa).

    chamber: NaN if the pressure was not read.
    """

    x: Array
    y: Array
    chamber: float

    def is_same(self, sightings: TargetSightings) -> bool:
        """Whether a frame is bit-identical to this one, which measurement noise rules out."""
        pairs = ((self.x, sightings.x), (self.y, sightings.y))
        return all(one.tobytes() == other.tobytes() for one, other in pairs)


@dataclass(frozen=True, slots=True, kw_only=True)
class NearWrench:
    """The end wrench (base frame) nearest to a stamp, and its age (s) there.

    std (N): one sigma of the noise of each component.
    """

    reading: WrenchReading
    age: float
    std: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadFrame:
    """A frame with the readings at the time that it shows.

    alone: whether no pressure is known at that time; pressure_still: whether the last pressure
    readings are bit-identical and this frame is due for a test; wrench: None if none is near.
    before, pulls: readings of pressure and force around the frame; delay_ns: how much later than
    its stamp it shows the arm, beyond the delay of the model: part of stamp_ns.
    """

    stamp_ns: int
    sightings: TargetSightings
    instant: PressureInstant
    alone: bool
    pressure_still: bool
    wrench: NearWrench | None
    before: tuple[PressureInstant, ...] = ()
    pulls: tuple[WrenchReading, ...] = ()
    delay_ns: int = 0

    def without_wrench(self) -> ReadFrame:
        """Return the frame without the force reading."""
        return replace(self, wrench=None, pulls=())

    def with_pressure_std(self, std: float) -> ReadFrame:
        """Return the frame with this pressure noise (Pa)."""
        return replace(self, instant=replace(self.instant, std=std))

    def mirrored(self) -> ReadFrame:
        """Return the frame with its targets on the other side of the clamp's tangent."""
        return replace(self, sightings=replace(self.sightings, y=-self.sightings.y))

    def delayed(self, delay_ns: int, within: float) -> ReadFrame:
        """Return the frame with the readings at another delay, and the rate of its pressure.

        within (s): one sigma of the delay; 0: no rate is needed.
        """
        if delay_ns == self.delay_ns and not within:
            return self
        stamp_ns = self.stamp_ns + delay_ns - self.delay_ns
        instant, wrench = replace(self.instant, stamp_ns=stamp_ns), self.wrench
        if not self.alone and self.before:
            read = pressure_at(self.before, stamp_ns)
            rate = rate_around(self.before, stamp_ns, max(within, Timing.WINDOW))
            ahead = seconds_since(self.before[-1].stamp_ns, stamp_ns)
            missed = abs(rate) * max(ahead, 0.0)  # not read yet: it may change as before
            instant = replace(
                read,
                std=math.hypot(read.std, missed),
                gravity=instant.gravity,
                turn_rate=instant.turn_rate,
                rate=rate,
            )
        if wrench is not None and self.pulls:
            reading = nearest_to(self.pulls, stamp_ns)
            wrench = replace(
                wrench, reading=reading, age=seconds_since(reading.stamp_ns, stamp_ns)
            )
        return replace(self, stamp_ns=stamp_ns, instant=instant, wrench=wrench, delay_ns=delay_ns)

    def without_pressure(self, instant: PressureInstant) -> ReadFrame:
        """Return the frame without the pressure reading; instant: replaces it."""
        return replace(self, instant=instant, alone=True)


Stamped = TypeVar('Stamped', bound=PressureInstant | WrenchReading)


def stamp_of(reading: Stamped) -> int:
    """Return the stamp (ns) of a reading."""
    return reading.stamp_ns


def followed_by(known: tuple[Stamped, ...], reading: Stamped, most: int) -> tuple[Stamped, ...]:
    """Return readings in order of their stamps with a new one, after which there is none."""
    earlier = bisect_left(known, reading.stamp_ns, key=stamp_of)
    return (*known[max(earlier + 1 - most, 0) : earlier], reading)


def pressure_at(known: tuple[PressureInstant, ...], stamp_ns: int) -> PressureInstant:
    """Return the pressure at a stamp, interpolated or from the nearest of some readings."""
    after = bisect_left(known, stamp_ns, key=stamp_of)
    if after in (0, len(known)):
        return replace(known[min(after, len(known) - 1)], stamp_ns=stamp_ns)
    first, second = known[after - 1], known[after]
    share = (stamp_ns - first.stamp_ns) / (second.stamp_ns - first.stamp_ns)
    nearest = first if share < 0.5 else second
    around = known[max(after - NEAR, 0) : after + NEAR]
    missed = error_between(
        stamp_ns,
        np.array([one.stamp_ns for one in around]),
        np.array([one.chamber for one in around]),
        nearest.std,
    )
    return replace(
        nearest,
        stamp_ns=stamp_ns,
        gauge=first.gauge + share * (second.gauge - first.gauge),
        chamber=first.chamber + share * (second.chamber - first.chamber),
        std=math.hypot(nearest.std, missed),
        missed=missed,
        turn_rate=first.turn_rate + share * (second.turn_rate - first.turn_rate),
    )


def rate_around(known: tuple[PressureInstant, ...], stamp_ns: int, within: float) -> float:
    """Return the mean rate (Pa/s) of the pressure within some s of a stamp, see `rate_of`."""
    within_ns = round(within * NANOSECONDS_PER_SECOND)
    first = bisect_left(known, stamp_ns - within_ns, key=stamp_of)
    last = bisect_left(known, stamp_ns + within_ns, key=stamp_of)
    near = known[max(first - 1, 0) : last + 1]
    times = np.array([seconds_since(stamp_ns, one.stamp_ns) for one in near])
    chambers = np.array([one.chamber for one in near])
    return rate_of(times, chambers, near[-1].std) if near else 0.0


def path_of(
    known: tuple[PressureInstant, ...],
    pulls: tuple[WrenchReading, ...],
    since_ns: int,
    chamber: float,
    instant: PressureInstant,
) -> list[EquilibriumBetween]:
    """Return the course of pressure and force between two stamps.

    known, pulls: readings of pressure and force; since_ns, chamber (Pa): start; instant: end.
    Empty if the pressure is unchanged and the force is not read.
    """
    between = [one for one in known if since_ns < one.stamp_ns < instant.stamp_ns]
    if not between:
        return []
    stamps = [one.stamp_ns for one in between]
    way = instant.chamber - chamber
    shares = [(one.chamber - chamber) / way for one in between] if abs(way) > 0.0 else []
    if not shares or not all(0.0 <= share <= 1.0 for share in shares):
        duration_ns = instant.stamp_ns - since_ns
        shares = [(stamp_ns - since_ns) / duration_ns for stamp_ns in stamps]
    deviations = [0.0] * len(between)
    if math.isfinite(way):
        lines = (chamber + share * way for share in shares)
        deviations = [one.chamber - line for one, line in zip(between, lines, strict=True)]
    beyond: list[Array | None] = [None] * len(between)
    if pulls:
        first, *force, last = forces_at(pulls, [since_ns, *stamps, instant.stamp_ns])
        beyond = [
            pulled - first - share * (last - first)
            for share, pulled in zip(shares, force, strict=True)
        ]
    elif not abs(way) > 0.0 and not any(deviations):
        return []
    turn_rates = [one.turn_rate for one in between]
    return list(map(EquilibriumBetween, stamps, shares, beyond, deviations, turn_rates))


def forces_at(pulls: tuple[WrenchReading, ...], stamps: list[int]) -> Array:
    """Return the tip force (stamps, 2) N at stamps, interpolated linearly."""
    at = [one.stamp_ns - stamps[0] for one in pulls]
    times = [stamp_ns - stamps[0] for stamp_ns in stamps]
    force_x = np.interp(times, at, [one.force_x for one in pulls])
    return np.stack([force_x, np.interp(times, at, [one.force_y for one in pulls])], axis=1)


def nearest_to(known: tuple[Stamped, ...], stamp_ns: int) -> Stamped:
    """Return the reading nearest to a stamp; of two equally near, the earlier one."""
    after = bisect_left(known, stamp_ns, key=stamp_of)
    neighbors = known[max(after - 1, 0) : after + 1]
    return min(neighbors, key=lambda one: abs(one.stamp_ns - stamp_ns))


def load_read(wrench: WrenchReading, gauge: float) -> Load:
    """Return what the sensors read under a load: an end wrench and a pressure (Pa)."""
    return Load(
        pressure=gauge, force_x=wrench.force_x, force_y=wrench.force_y, moment=wrench.moment
    )

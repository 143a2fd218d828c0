"""Protocols of the lab, with exact durations.

Steps are ramps of finite duration. If the force is exactly zero, nothing is attached to the arm.
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
import math
from typing import Any, ClassVar

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import check_quantities, list_fields, quantity
from pneunet_ros.lab.timeline import Leg, share_of_time, Timeline, timeline

SHORTEST = 0.2  # s
Row = tuple[float, ...]


def seconds(default: float, meaning: str) -> Any:
    """Declare a time of a protocol."""
    return quantity(default, unit='s', meaning=meaning, bounds=(0.0, 1e5))


def pascals(default: float, meaning: str) -> Any:
    """Declare a pressure of a protocol."""
    return quantity(default, unit='Pa', meaning=meaning, bounds=(0.0, 1e7))


def newtons(default: float, meaning: str) -> Any:
    """Declare a force of a protocol."""
    return quantity(default, unit='N', meaning=meaning, bounds=(-1e3, 1e3))


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol(abc.ABC):
    """A protocol: `kind` as in the scenario file; fields without a unit are lists."""

    kind: ClassVar[str]
    duration: float = seconds(40.0, 'duration of the protocol')

    def __post_init__(self) -> None:
        """Check times, pressures and forces."""
        check_quantities(self, 'protocol', RequestError)
        for name in list_fields(self):
            values = getattr(self, name)
            if not values or not all(math.isfinite(value) for value in values):
                raise RequestError(
                    f'protocol.{name} must be a list of numbers', reason='not_a_table'
                )
            object.__setattr__(self, name, tuple(float(value) for value in values))

    @abc.abstractmethod
    def timeline(self) -> Timeline:
        """Return the course of pressure and load; RequestError if it exceeds `duration`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FromRest(Protocol):
    """A protocol that begins at rest."""

    rest: float = seconds(1.6, 'initial rest, at pressure 0 without a load')


@dataclass(frozen=True, slots=True, kw_only=True)
class Stepped(FromRest):
    """A protocol of ramps between holds."""

    ramp: float = seconds(0.6, 'ramp from one hold to the next')

    def holds(self, count: int, ramps: int) -> float:
        """Return the duration (s) of each of this many holds, after deducting ramps and rest."""
        remaining = self.duration - self.rest - ramps * self.ramp
        return share_of_time(remaining, count, SHORTEST, 'holds')


@dataclass(frozen=True, slots=True, kw_only=True)
class SlowRamp(FromRest):
    """Unloaded: a slow rise, a short hold, a slow fall, and a rest."""

    kind: ClassVar[str] = 'slow_ramp'
    top: float = pascals(55e3, 'largest pressure')
    hold: float = seconds(1.6, 'hold at the top')

    def timeline(self) -> Timeline:
        """Return the ramp."""
        remaining = self.duration - 2.0 * self.rest - self.hold
        slope = share_of_time(remaining, 2, SHORTEST, 'ramps')
        legs = [
            Leg(self.rest, 0.0),
            Leg(slope, self.top),
            Leg(self.hold, self.top),
            Leg(slope, 0.0),
            Leg(self.rest, 0.0),
        ]
        return timeline(legs, loaded=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Staircase(Stepped):
    """Unloaded: up and down in steps, with a hold on each."""

    kind: ClassVar[str] = 'staircase'
    pressures: Row = (11e3, 22e3, 33e3, 44e3, 55e3)  # holds on the way up, Pa

    def timeline(self) -> Timeline:
        """Return the staircase."""
        levels = [*self.pressures, *self.pressures[-2::-1], 0.0]
        hold = self.holds(len(levels), len(levels))
        legs = [Leg(self.rest, 0.0)]
        for level in levels:
            legs += [Leg(self.ramp, level), Leg(hold, level)]
        return timeline(legs, loaded=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeadWeights(Stepped):
    """Weights are attached one after the other; with each, the pressures are stepped through.

    The string pulls at `angle` from E1. Every second weight uses the pressures in reverse order.
    """

    kind: ClassVar[str] = 'dead_weights'
    pressures: Row = (5e3, 20e3, 35e3, 50e3)  # holds with every weight, Pa
    weights: Row = (0.1, 0.2, 0.3)  # pull of the string, N
    angle: float = quantity(
        0.6, unit='rad', meaning=('direction of the pull, from E1'), bounds=(-7.0, 7.0)
    )

    def timeline(self) -> Timeline:
        """Return the steps."""
        count = len(self.weights) * len(self.pressures)
        hold = self.holds(count, count + 1)
        legs = [Leg(self.rest, 0.0), Leg(self.ramp, self.pressures[0])]
        for index, weight in enumerate(self.weights):
            force = weight * math.cos(self.angle), weight * math.sin(self.angle)
            for level in self.pressures[:: -1 if index % 2 else 1]:
                legs += [Leg(self.ramp, level, force), Leg(hold, level, force)]
        return timeline(legs, loaded=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceSweeps(Stepped):
    """At each pressure and for each direction, the pull slowly rises and falls again."""

    kind: ClassVar[str] = 'force_sweeps'
    pressures: Row = (20e3, 45e3)  # at which the force is swept, Pa
    angles: Row = (0.2, 0.9)  # of the pull, from E1, rad
    smallest: float = newtons(0.04, 'pull at the beginning and the end of a sweep')
    largest: float = newtons(0.3, 'pull at its turning point')

    def timeline(self) -> Timeline:
        """Return the sweeps."""
        count = len(self.pressures) * len(self.angles)
        remaining = self.duration - self.rest - (count + 1) * self.ramp
        half = share_of_time(remaining, 2 * count, SHORTEST, 'sweeps')
        legs = [Leg(self.rest, 0.0), Leg(self.ramp, self.pressures[0])]
        for level in self.pressures:
            for angle in self.angles:
                low, high = (
                    (pull * math.cos(angle), pull * math.sin(angle))
                    for pull in (self.smallest, self.largest)
                )
                legs += [Leg(self.ramp, level, low), Leg(half, level, high), Leg(half, level, low)]
        return timeline(legs, loaded=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Strings(Protocol):
    """Two strings at the free end, with new tensions at every pressure, starting with the first.

    Their angles from E1 give the force in the base frame: with 0 and pi/2, the tensions are the
    F_A and F_B of Table 1.
    """

    kind: ClassVar[str] = 'strings'
    ramp: float = seconds(0.6, 'ramp from one hold to the next')
    pressures: Row = (0.0, 31e3)  # Pa
    pull_a: Row = (0.25, 0.175)  # of the one string at each pressure, N
    pull_b: Row = (0.0, 0.07)  # of the other string at each pressure, N
    angle_a: float = quantity(
        0.0, unit='rad', meaning='direction of string a, from E1', bounds=(-7.0, 7.0)
    )
    angle_b: float = quantity(
        0.5 * math.pi, unit='rad', meaning='direction of string b, from E1', bounds=(-7.0, 7.0)
    )

    def timeline(self) -> Timeline:
        """Return the holds."""
        rows = len(self.pressures)
        if not rows == len(self.pull_a) == len(self.pull_b):
            raise RequestError(
                'protocol: pressures, pull_a and pull_b must be of equal length',
                reason='wrong_shape',
            )
        hold = share_of_time(self.duration - (rows - 1) * self.ramp, rows, SHORTEST, 'holds')
        forces = [
            (
                a * math.cos(self.angle_a) + b * math.cos(self.angle_b),
                a * math.sin(self.angle_a) + b * math.sin(self.angle_b),
            )
            for a, b in zip(self.pull_a, self.pull_b, strict=True)
        ]
        legs: list[Leg] = []
        for level, force in zip(self.pressures, forces, strict=True):
            if legs:
                legs.append(Leg(self.ramp, level, force))
            legs.append(Leg(hold, level, force))
        return timeline(legs, loaded=True, start=Leg(0.0, self.pressures[0], forces[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomMix(Stepped):
    """Ramps of random length to random pressures and forces, with holds after about half of them.

    If both largest forces are 0, the arm is unloaded. `seed` affects only the protocol.
    """

    kind: ClassVar[str] = 'random_mix'
    seed: float = quantity(1.0, unit='-', meaning='seed of the course', bounds=(0.0, 2.0**31))
    lowest: float = pascals(2e3, 'smallest pressure')
    top: float = pascals(60e3, 'largest pressure')
    force_x: Row = (0.1, 0.28)  # smallest and largest, N
    force_y: Row = (0.0, 0.22)  # smallest and largest, N

    def __post_init__(self) -> None:
        """Check the limits and the seed."""
        Stepped.__post_init__(self)
        if not float(self.seed).is_integer():
            raise RequestError(
                f'protocol.seed = {self.seed} is not a whole number', reason='not_a_number'
            )
        for name in ('force_x', 'force_y'):
            if len(getattr(self, name)) != 2:
                raise RequestError(
                    f'protocol.{name} must be two numbers, the smallest and the largest',
                    reason='wrong_shape',
                )

    def timeline(self) -> Timeline:
        """Return the course."""
        random = np.random.default_rng([int(self.seed), 5])
        loaded = any(self.force_x) or any(self.force_y)
        legs = [Leg(self.rest, 0.0)]
        remaining = self.duration - self.rest
        while remaining > 0.0:
            level, a, b, slope, hold = random.uniform(size=5)
            force = (
                self.force_x[0] + a * (self.force_x[-1] - self.force_x[0]),
                self.force_y[0] + b * (self.force_y[-1] - self.force_y[0]),
            )
            level = self.lowest + level * (self.top - self.lowest)
            slope = self.ramp * (1.0 + 4.0 * slope**2)
            if slope > remaining:  # no time for a ramp: a last hold
                legs.append(legs[-1]._replace(seconds=remaining))
                break
            hold = min(3.0 * max(hold - 0.4, 0.0), remaining - slope)
            for part in (slope, hold):
                if part > 0.0:
                    legs.append(Leg(part, level, force))
            remaining -= slope + hold
        return timeline(legs, loaded=loaded)


@dataclass(frozen=True, slots=True, kw_only=True)
class Corners(Protocol):
    """Any piecewise linear course of pressure and force, at given fractions of the time."""

    kind: ClassVar[str] = 'corners'
    share: Row = (0.0, 0.1, 0.3, 0.6, 1.0)  # of `duration`, rising from 0 to 1
    pressure: Row = (0.0, 0.0, 0.0, 55e3, 0.0)  # at each of them, Pa
    force_x: Row = (0.0, 0.0, 0.2, 0.2, 0.0)  # at each of them, N
    force_y: Row = (0.0, 0.0, 0.0, 0.0, 0.0)  # at each of them, N

    def timeline(self) -> Timeline:
        """Return the course."""
        if len({len(getattr(self, name)) for name in list_fields(self)}) > 1:
            raise RequestError(
                'protocol: share, pressure and forces must be of equal length',
                reason='wrong_shape',
            )
        ends = self.share[0] == 0.0 and self.share[-1] == 1.0
        if not ends or np.any(np.diff(self.share) <= 0.0):
            raise RequestError('protocol.share must rise from 0 to 1', reason='not_increasing')
        force = np.column_stack([self.force_x, self.force_y])
        return Timeline(
            time=self.duration * np.array(self.share),
            pressure=np.array(self.pressure),
            force=force,
            loaded=bool(force.any()),
        )


PROTOCOLS: dict[str, type[Protocol]] = {
    protocol.kind: protocol
    for protocol in (SlowRamp, Staircase, DeadWeights, ForceSweeps, Strings, RandomMix, Corners)
}

"""Experiment designs of the trials: six training recordings and two held-out ones.

Protocols are the same in all trials of a design, so that what was simulated for a design serves
them all; arms, effects and noise differ. Recordings follow each other after a pause; the arm is
unconditioned in the first and remembers from then on.

Beside `full` and `free` there is a design of every kind of motion at every rate of readings, such
as `steps_10`: what a memory does is told by how pressure moves, and by how often it is read.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from pneunet_ros.core.units import quantity
from pneunet_ros.lab.protocols import (
    DeadWeights,
    ForceSweeps,
    FromRest,
    Protocol,
    RandomMix,
    SlowRamp,
    Staircase,
    Stepped,
    Strings,
)
from pneunet_ros.lab.sensors import LabNoise, Rates
from pneunet_ros.lab.timeline import Leg, Timeline, timeline
from scipy.signal import lfilter

DURATION = 32.0  # s, of a recording
PAUSE = 20.0  # s, between two
# The camera is triggered with every eighth pressure reading: 128 frames a recording. With other
# rates the nearest reading is some milliseconds older than the frame, which is a lag of its own.
RATES = Rates(pressure=32.0, wrench=32.0, frames=4.0)
NOISE = LabNoise()
CORNERS = 0.1  # s, between the corners of a course that never rests
READING_RATES = 5, 10, 25, 50  # Hz
STEP = 0.1  # s, in which a fast regulator steps: less than a reading at 5 Hz
FREE_LOAD = {'force_x': (0.0, 0.0), 'force_y': (0.0, 0.0)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """Protocols in the order of time: to learn from, and held out."""

    training: tuple[Protocol, ...]
    held_out: tuple[Protocol, ...]
    rates: Rates = RATES


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomSteps(Stepped):
    """Steps to random pressures and forces, each with a hold of random length; `ramp` is short."""

    kind: ClassVar[str] = 'random_steps'
    seed: float = quantity(1.0, unit='-', meaning='of the course', bounds=(0.0, 2.0**31))
    force_x: tuple[float, ...] = (0.1, 0.28)  # smallest and largest, N
    force_y: tuple[float, ...] = (0.0, 0.22)  # smallest and largest, N

    def timeline(self) -> Timeline:
        """Return the steps."""
        random = np.random.default_rng([int(self.seed), 7])
        legs, left = [Leg(self.rest, 0.0)], self.duration - self.rest
        while left > self.ramp:
            a, b = random.uniform(size=2)
            force = between(self.force_x, a), between(self.force_y, b)
            level, hold = random.uniform(2e3, 60e3), random.uniform(0.6, 3.0)
            hold = min(hold, left - self.ramp)
            legs += [Leg(self.ramp, level, force), Leg(hold, level, force)]
            left -= self.ramp + hold
        if left > 0.0:
            legs.append(legs[-1]._replace(seconds=left))
        return timeline(legs, loaded=any(self.force_x) or any(self.force_y))


@dataclass(frozen=True, slots=True, kw_only=True)
class FilteredNoise(FromRest):
    """Pressure and force that never rest: noise behind a second-order low-pass."""

    kind: ClassVar[str] = 'filtered_noise'
    seed: float = quantity(1.0, unit='-', meaning='of the course', bounds=(0.0, 2.0**31))
    settling: float = quantity(
        1.0, unit='s', meaning='time constant of both low-passes', bounds=(0.05, 1e3)
    )
    force_x: tuple[float, ...] = (0.1, 0.28)  # smallest and largest, N
    force_y: tuple[float, ...] = (0.0, 0.22)  # smallest and largest, N

    def timeline(self) -> Timeline:
        """Return the course, with corners every tenth of a second."""
        random = np.random.default_rng([int(self.seed), 9])
        count = round((self.duration - self.rest) / CORNERS)
        decay = float(np.exp(-CORNERS / self.settling))
        noise = random.standard_normal((3, count + 200))
        for _ in range(2):
            noise = lfilter([1.0 - decay], [1.0, -decay], noise, axis=1)
        noise = noise[:, 200:]
        share = 0.5 + 0.5 * np.tanh(0.9 * noise / noise.std(axis=1, keepdims=True))
        legs = [Leg(self.rest, 0.0)]
        for place, (level, a, b) in enumerate(share.T.tolist()):
            force = between(self.force_x, a), between(self.force_y, b)
            seconds = CORNERS if place else 0.0  # so that it lasts as long as it should
            legs.append(Leg(max(seconds, 1e-3), 2e3 + 58e3 * level, force))
        left = self.duration - sum(leg.seconds for leg in legs)
        legs.append(legs[-1]._replace(seconds=left))
        return timeline(legs, loaded=any(self.force_x) or any(self.force_y))


def between(limits: tuple[float, ...], share: float) -> float:
    """Return the value at a share of the way from the first to the last."""
    return limits[0] + share * (limits[-1] - limits[0])


def unloaded(seed: float, ramp: float) -> RandomMix:
    """Return random ramps and holds with nothing on the arm."""
    return RandomMix(
        seed=seed, ramp=ramp, force_x=(0.0, 0.0), force_y=(0.0, 0.0), duration=DURATION
    )


# Shows every effect: the first-ever ramp is under load (softening); force sweeps at two pressures
# (stiffening); fast and slow ramps and holds of one to four seconds (lag, hysteresis, creep).
FULL = Design(
    training=(
        DeadWeights(
            pressures=(8e3, 24e3, 42e3, 60e3),
            weights=(0.12, 0.2, 0.28),
            angle=0.6,
            ramp=0.8,
            duration=DURATION,
        ),
        SlowRamp(top=62e3, hold=2.0, duration=DURATION),
        Staircase(pressures=(12e3, 24e3, 36e3, 48e3, 60e3), ramp=0.5, duration=DURATION),
        ForceSweeps(pressures=(20e3, 50e3), angles=(0.2, 0.9), duration=DURATION),
        Strings(
            pressures=(0.0, 17.2e3, 31e3, 44.9e3, 53.8e3, 61.3e3, 30e3),
            pull_a=(0.25, 0.2, 0.175, 0.15, 0.15, 0.15, 0.175),
            pull_b=(0.0, 0.025, 0.07, 0.125, 0.2, 0.25, 0.07),
            ramp=1.6,
            duration=DURATION,
        ),
        RandomMix(seed=3.0, ramp=0.5, duration=DURATION),
    ),
    held_out=(
        RandomMix(seed=11.0, ramp=0.6, duration=DURATION),
        DeadWeights(
            pressures=(30e3, 55e3, 15e3, 40e3),
            weights=(0.24, 0.14),
            angle=1.0,
            rest=1.7,  # so that no frame shows the arm under a load of which most is noise
            ramp=1.2,
            duration=DURATION,
        ),
    ),
)
# In free space only.
FREE = Design(
    training=(
        SlowRamp(top=62e3, hold=2.0, duration=DURATION),
        Staircase(pressures=(12e3, 24e3, 36e3, 48e3, 60e3), ramp=0.5, duration=DURATION),
        unloaded(3.0, 0.5),
        unloaded(4.0, 1.0),
        SlowRamp(top=45e3, hold=6.0, duration=DURATION),
        unloaded(5.0, 0.8),
    ),
    held_out=(unloaded(11.0, 0.6), Staircase(pressures=(20e3, 55e3), ramp=1.2, duration=DURATION)),
)


def steps(rates: Rates) -> Design:
    """Return steps and holds alone: pressure hardly ever moves while it is read."""
    levels = (12e3, 48e3, 24e3, 60e3, 36e3)
    return Design(
        rates=rates,
        training=(
            weights_hung_on(STEP),
            Staircase(pressures=levels, ramp=STEP, duration=DURATION),
            RandomSteps(seed=3.0, ramp=STEP, duration=DURATION, **FREE_LOAD),
            Staircase(pressures=(8e3, 24e3, 42e3, 62e3), ramp=STEP, duration=DURATION),
            RandomSteps(seed=4.0, ramp=STEP, duration=DURATION),
            RandomSteps(seed=5.0, ramp=STEP, duration=DURATION),
        ),
        held_out=(
            RandomSteps(seed=11.0, ramp=STEP, duration=DURATION),
            RandomSteps(seed=12.0, ramp=STEP, duration=DURATION, **FREE_LOAD),
        ),
    )


def ramps(rates: Rates) -> Design:
    """Return slow and fast ramps."""
    return Design(
        rates=rates,
        training=(
            weights_hung_on(1.0),
            SlowRamp(top=62e3, hold=2.0, duration=DURATION),
            SlowRamp(top=45e3, hold=18.0, duration=DURATION),
            ForceSweeps(pressures=(20e3, 50e3), angles=(0.2, 0.9), duration=DURATION),
            RandomMix(seed=3.0, ramp=1.0, duration=DURATION),
            Staircase(pressures=(16e3, 32e3, 48e3, 62e3), ramp=1.5, duration=DURATION),
        ),
        held_out=(
            RandomMix(seed=11.0, ramp=1.2, duration=DURATION),
            SlowRamp(top=55e3, hold=10.0, duration=DURATION),
        ),
    )


def random_motion(rates: Rates) -> Design:
    """Return pressure that is never still."""
    return Design(
        rates=rates,
        training=(
            weights_hung_on(0.8),
            FilteredNoise(seed=1.0, duration=DURATION, **FREE_LOAD),
            FilteredNoise(seed=2.0, settling=0.4, duration=DURATION, **FREE_LOAD),
            FilteredNoise(seed=3.0, settling=2.0, duration=DURATION),
            FilteredNoise(seed=4.0, settling=0.7, duration=DURATION),
            RandomMix(seed=3.0, ramp=0.5, duration=DURATION),
        ),
        held_out=(
            FilteredNoise(seed=11.0, duration=DURATION),
            FilteredNoise(seed=12.0, settling=0.6, duration=DURATION, **FREE_LOAD),
        ),
    )


def weights_hung_on(ramp: float) -> DeadWeights:
    """Return the first recording of all: the first ramp ever is under a load."""
    return DeadWeights(
        pressures=(8e3, 24e3, 42e3, 60e3),
        weights=(0.12, 0.2, 0.28),
        angle=0.6,
        ramp=ramp,
        duration=DURATION,
    )


def rates_of(readings: float) -> Rates:
    """Return rates of readings, and of a camera that is triggered by every fourth or eighth."""
    every = 4.0 if readings < 20.0 else 8.0
    return Rates(pressure=readings, wrench=readings, frames=readings / every)


MOTIONS = {'steps': steps, 'ramps': ramps, 'random': random_motion}
RATED = {
    f'{motion}_{rate}': design(rates_of(float(rate)))
    for motion, design in MOTIONS.items()
    for rate in READING_RATES
}
# Readings rarer than frames of a camera that nobody triggers.
RARE = {
    f'{name}_2_{frames}': replace(
        design, rates=Rates(pressure=2.0, wrench=2.0, frames=float(frames))
    )
    for frames in (4, 10)
    for name, design in {
        'full': FULL,
        **{key: make(RATES) for key, make in MOTIONS.items()},
    }.items()
}
DESIGNS = {'full': FULL, 'free': FREE} | RATED | RARE

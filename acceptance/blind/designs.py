"""What is done to the arm in the trials: designs of six recordings to learn from and two held out.

Protocols are the same in all trials of a design, so that what was simulated for a design serves
them all; arms, effects and noise differ. Recordings follow each other after a pause; the arm is
unconditioned in the first and remembers from then on.
"""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.lab.protocols import (
    DeadWeights,
    ForceSweeps,
    Protocol,
    RandomMix,
    SlowRamp,
    Staircase,
    Strings,
)
from pneunet_ros.lab.sensors import LabNoise, Rates

DURATION = 32.0  # s, of a recording
PAUSE = 20.0  # s, between two
# The camera is triggered with every eighth pressure reading: 128 frames a recording. With other
# rates the nearest reading is some milliseconds older than the frame, which is a lag of its own.
RATES = Rates(pressure=32.0, wrench=32.0, frames=4.0)
NOISE = LabNoise()


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """Protocols in the order of time: to learn from, and held out."""

    training: tuple[Protocol, ...]
    held_out: tuple[Protocol, ...]


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
    held_out=(
        unloaded(11.0, 0.6),
        Staircase(pressures=(20e3, 55e3), ramp=1.2, duration=DURATION),
    ),
)
DESIGNS = {'full': FULL, 'free': FREE}

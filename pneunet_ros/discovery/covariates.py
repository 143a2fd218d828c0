"""Covariates of an amplitude, frame by frame, in SI and scaled to about one.

Some are known wherever a model runs (pressure and its past, the end load), so an effect can depend
on them. The time since the start of a recording is only known here: a law in it describes the
recordings, but predicts nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.discovery.settings import CovariateSettings, DISCOVERY
from pneunet_ros.measurement.dataset import RecordingData

LEAST_SPREAD = 1e-6  # of the largest value: below it a covariate is constant but for rounding

Group = Literal['constant', 'pressure', 'past', 'load', 'time']
CONSTANT, ELAPSED, PLAY, RATE = '1', 't', 'side of the play', 'dp/dt'
# Widths of plays, in units of the usual one: sums of them come near to any hysteresis
# (Prandtl-Ishlinskii).
PLAYS = {'side of a narrow play': 0.5, PLAY: 1.0, 'side of a wide play': 2.0}
RATE_TIME = 0.3  # s, over which the rate of a pressure is taken: noise of readings averages out


@dataclass(frozen=True, slots=True, kw_only=True)
class Meaning:
    """Description of a covariate: its group, words and unit."""

    group: Group
    words: str
    unit: str


MEANINGS: dict[str, Meaning] = {
    CONSTANT: Meaning(group='constant', words='is constant', unit='-'),
    'p': Meaning(group='pressure', words='depends on the pressure', unit='Pa'),
    'p^2': Meaning(group='pressure', words='depends on the square of the pressure', unit='Pa^2'),
    RATE: Meaning(group='past', words='depends on the rate of the pressure', unit='Pa/s'),
    'side of a narrow play': Meaning(
        group='past',
        words='differs between rising and falling pressure, as after a narrow dead band (play)',
        unit='-',
    ),
    PLAY: Meaning(
        group='past',
        words='differs between rising and falling pressure, as after a dead band (play)',
        unit='-',
    ),
    'side of a wide play': Meaning(
        group='past',
        words='differs between rising and falling pressure, as after a wide dead band (play)',
        unit='-',
    ),
    'past 3 s': Meaning(
        group='past', words='depends on the pressure minus its mean over the last 3 s', unit='Pa'
    ),
    'past 10 s': Meaning(
        group='past', words='depends on the pressure minus its mean over the last 10 s', unit='Pa'
    ),
    'past 30 s': Meaning(
        group='past', words='depends on the pressure minus its mean over the last 30 s', unit='Pa'
    ),
    'F1': Meaning(group='load', words='depends on the end force F1', unit='N'),
    'F2': Meaning(group='load', words='depends on the end force F2', unit='N'),
    '|F|': Meaning(group='load', words='depends on the size of the end force', unit='N'),
    'p F1': Meaning(group='load', words='depends on pressure times end force F1', unit='Pa N'),
    'p F2': Meaning(group='load', words='depends on pressure times end force F2', unit='Pa N'),
    ELAPSED: Meaning(
        group='time', words='depends on the time since the start of a recording', unit='s'
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariate:
    """A covariate in the runs of a linearization: values (frames,) in SI, one array per run.

    scale: its largest absolute value.
    """

    name: str
    values: tuple[Array, ...]
    scale: float

    @property
    def meaning(self) -> Meaning:
        """Its description."""
        return MEANINGS[self.name]

    def scaled(self, which: int) -> Array:
        """Values of a run relative to the largest, (frames,)."""
        return self.values[which] / self.scale


def covariates_of(
    linearization: Linearization, settings: CovariateSettings = DISCOVERY.covariates
) -> tuple[Covariate, ...]:
    """Return all covariates that vary in the runs of a linearization, the constant first."""
    tables = [
        covariate_table(linearization, which, settings) for which in range(len(linearization.runs))
    ]
    found = []
    for name in MEANINGS:
        values = tuple(table[name] for table in tables)
        joined = np.concatenate(values)
        scale = float(np.abs(joined).max())
        if name == CONSTANT or np.ptp(joined) > LEAST_SPREAD * scale:
            found.append(Covariate(name=name, values=values, scale=scale))
    return tuple(found)


def covariate_table(
    linearization: Linearization, which: int, settings: CovariateSettings
) -> dict[str, Array]:
    """Return all covariates of a run, (frames,) in SI, of readings without noise."""
    block = linearization.blocks[which]
    run, inputs = linearization.known_inputs.filtered[which].run, block.inputs
    pressure, (f1, f2) = inputs.pressure, inputs.loads[:, :2].T
    low, high = linearization.point.arm.table_range
    return {
        CONSTANT: np.ones_like(pressure),
        'p': pressure,
        'p^2': pressure**2,
        RATE: ahead_of_past(run, RATE_TIME) / RATE_TIME,
        **{
            name: side_of_play(run, factor * settings.play * (high - low))
            for name, factor in PLAYS.items()
        },
        'past 3 s': ahead_of_past(run, 3.0),
        'past 10 s': ahead_of_past(run, 10.0),
        'past 30 s': ahead_of_past(run, 30.0),
        'F1': f1,
        'F2': f2,
        '|F|': np.hypot(f1, f2),
        'p F1': pressure * f1,
        'p F2': pressure * f2,
        ELAPSED: elapsed(run),
    }


def ahead_of_past(run: RecordingData, time_constant: float) -> Array:
    """Return pressure (Pa) minus its first-order mean over a time (s), at the frames.

    This is exact for piecewise linear readings, starting at rest. Static frames have no past.
    """
    if run.static:
        return np.zeros(len(run.stamp_ns))
    seconds = np.diff(run.reading_stamp_ns) / NANOSECONDS_PER_SECOND
    decay = np.exp(-seconds / time_constant)
    # A rate over a step leaves as much behind: the same as `proposed_effect.FOLLOW`.
    steps = np.diff(run.pressure) * -np.expm1(-seconds / time_constant)
    steps *= time_constant / np.maximum(seconds, 1e-9)
    ahead = np.zeros(len(run.pressure))
    for place, (kept, step) in enumerate(zip(decay.tolist(), steps.tolist(), strict=True)):
        ahead[place + 1] = kept * ahead[place] + step
    at_frames: Array = ahead[run.reading]
    return at_frames


def side_of_play(run: RecordingData, width: float) -> Array:
    """Return the position in a play of this full width (Pa), -1 to 1, at the frames.

    It starts in the middle; static frames have no past and stay there.
    """
    if run.static:
        return np.zeros(len(run.stamp_ns))
    half, middle = 0.5 * width, float(run.pressure[0])
    side = np.empty(len(run.pressure))
    for place, pressure in enumerate(run.pressure.tolist()):
        middle = min(max(middle, pressure - half), pressure + half)
        side[place] = (pressure - middle) / half
    at_frames: Array = side[run.reading]
    return at_frames


def elapsed(run: RecordingData) -> Array:
    """Return seconds since the first reading at the frames; static frames have no time."""
    if run.static:
        return np.zeros(len(run.stamp_ns))
    seconds: Array = (run.stamp_ns - run.reading_stamp_ns[0]) / NANOSECONDS_PER_SECOND
    return seconds

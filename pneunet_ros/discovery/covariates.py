"""Covariates of an amplitude, frame by frame, in SI and scaled to about one.

Some covariates are known wherever a model runs (pressure and its past, the end load), so that an
effect can depend on them. The time since the start of a recording is known only here: a law in
this time describes the recordings but predicts nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.diagnosis.fit.generic_field import high_pass
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.measurement.dataset import RecordingData

LEAST_SPREAD = 1e-6  # of the largest value: below it a covariate is constant up to rounding

Group = Literal['constant', 'pressure', 'past', 'load', 'time']
CONSTANT, ELAPSED, PLAY, RATE = '1', 't', 'side of the play', 'dp/dt'
# Widths of plays, in units of the usual one: sums of them come near to any hysteresis
# (Prandtl-Ishlinskii).
PLAYS = {'side of a narrow play': 0.5, PLAY: 1.0, 'side of a wide play': 2.0}
MEANS = {'past 3 s': 3.0, 'past 10 s': 10.0, 'past 30 s': 30.0}  # s, averaging times
RATE_TIME = 0.3  # s, averaging time of the rate of a pressure, because of the noise of readings


@dataclass(frozen=True, slots=True)
class Meaning:
    """Description of a covariate: group, unit, words, and the parameter of an effect with it.

    parameter: empty if an effect cannot follow it.
    """

    group: Group
    unit: str
    parameter: str
    words: str


TURNS = 'differs between rising and falling pressure, as after a'
LEFT = 'depends on the pressure minus its mean over the last'
MEANINGS: dict[str, Meaning] = {
    CONSTANT: Meaning('constant', '-', 'constant', 'is constant'),
    'p': Meaning('pressure', 'Pa', 'per_pressure', 'depends on the pressure'),
    'p^2': Meaning(
        'pressure', 'Pa^2', 'per_squared_pressure', 'depends on the square of the pressure'
    ),
    RATE: Meaning('past', 'Pa/s', 'per_pressure_rate', 'depends on the rate of the pressure'),
    'side of a narrow play': Meaning(
        'past', '-', 'per_side_of_narrow_play', f'{TURNS} narrow dead band (play)'
    ),
    PLAY: Meaning('past', '-', 'per_side_of_play', f'{TURNS} dead band (play)'),
    'side of a wide play': Meaning(
        'past', '-', 'per_side_of_wide_play', f'{TURNS} wide dead band (play)'
    ),
    'past 3 s': Meaning('past', 'Pa', 'per_pressure_of_three_seconds', f'{LEFT} 3 s'),
    'past 10 s': Meaning('past', 'Pa', 'per_pressure_of_ten_seconds', f'{LEFT} 10 s'),
    'past 30 s': Meaning('past', 'Pa', 'per_pressure_of_half_a_minute', f'{LEFT} 30 s'),
    'F1': Meaning('load', 'N', 'per_force_x', 'depends on the end force F1'),
    'F2': Meaning('load', 'N', 'per_force_y', 'depends on the end force F2'),
    '|F|': Meaning('load', 'N', 'per_force', 'depends on the size of the end force'),
    'p F1': Meaning(
        'load', 'Pa N', 'per_pressure_and_force_x', 'depends on pressure times end force F1'
    ),
    'p F2': Meaning(
        'load', 'Pa N', 'per_pressure_and_force_y', 'depends on pressure times end force F2'
    ),
    ELAPSED: Meaning('time', 's', '', 'depends on the time since the start of a recording'),
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


def covariates_of(linearization: Linearization) -> tuple[Covariate, ...]:
    """Return all covariates that vary in the runs of a linearization, the constant first."""
    tables = [covariate_table(linearization, which) for which in range(len(linearization.runs))]
    found = []
    for name in MEANINGS:
        values = tuple(table[name] for table in tables)
        joined = np.concatenate(values)
        scale = float(np.abs(joined).max())
        if name == CONSTANT or np.ptp(joined) > LEAST_SPREAD * scale:
            found.append(Covariate(name=name, values=values, scale=scale))
    return tuple(found)


def covariate_table(linearization: Linearization, which: int) -> dict[str, Array]:
    """Return all covariates of a run, (frames,) in SI, of filtered readings."""
    block = linearization.blocks[which]
    run, inputs = linearization.known_inputs.filtered[which].run, block.inputs
    pressure, (f1, f2) = inputs.pressure, inputs.loads[:, :2].T
    low, high = linearization.point.arm.table_range
    return {
        CONSTANT: np.ones_like(pressure),
        'p': pressure,
        'p^2': pressure**2,
        RATE: high_pass(run, RATE_TIME) / RATE_TIME,
        **{
            name: side_of_play(run, factor * LINEARIZATION.unloading * (high - low))
            for name, factor in PLAYS.items()
        },
        **{name: high_pass(run, time) for name, time in MEANS.items()},
        'F1': f1,
        'F2': f2,
        '|F|': np.hypot(f1, f2),
        'p F1': pressure * f1,
        'p F2': pressure * f2,
        ELAPSED: elapsed(run),
    }


def side_of_play(run: RecordingData, width: float) -> Array:
    """Return the position in a play operator of this full width (Pa), -1 to 1, at the frames.

    The play starts in the middle; static frames have no past and stay there.
    """
    if run.static:
        return np.zeros(len(run.stamp_ns))
    half, middle = 0.5 * width, float(run.pressure[0])
    side = np.empty(len(run.pressure))
    for index, pressure in enumerate(run.pressure.tolist()):
        middle = min(max(middle, pressure - half), pressure + half)
        side[index] = (pressure - middle) / half
    at_frames: Array = side[run.reading]
    return at_frames


def elapsed(run: RecordingData) -> Array:
    """Return seconds since the first frame; static frames have no time."""
    if run.static:
        return np.zeros(len(run.stamp_ns))
    seconds: Array = (run.stamp_ns - run.stamp_ns[0]) / NANOSECONDS_PER_SECOND
    return seconds

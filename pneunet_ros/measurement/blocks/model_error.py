"""Model error: errors of the law that calibration has not found.

Soft arms have memory. The error of a model without creep or hysteresis depends on the history of
the pressure: a part of the intrinsic curvature follows the chamber with a delay, and a part
follows the pressure behind a play (dead band). The sizes of these parts are constant, so frames
determine them even without a force sensor, and the force is corrected accordingly.

All other model error consists of slow errors of the pressure (`pressure_error`), of the intrinsic
curvature and of the stiffness, which change with time and with the pressure. Their size, relative
to the effect of the whole pressure range, is also unknown and is estimated
(`inference/variance_component`). Intervals thus become wide if an effect is missing, and stay
narrow if none is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import FrameInputs, Move, Passage, SizedBlock
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.inference.variance_component import SizeGrid
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import STIFFNESS


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelDiscrepancy(SizedBlock):
    """Model errors: curvature and stiffness, delayed curvature (creep), and hysteresis.

    curvature, stiffness: changes of the model file by a size of 1, by dotted path.
    """

    curvature: Mapping[str, float]
    stiffness: Mapping[str, float]
    sizes: tuple[float, ...] = tuning(
        (0.001, 0.002, 0.004, 0.008, 0.016, 0.03, 0.06, 0.12),
        'possible sizes of the model error: std of the pressure bias, and of the curvature',
        unit='of the range',
        source='sweep',
    )
    size_fall: float = tuning(
        1.5, 'exponent of the prior over sizes: larger errors are less likely', source='sweep'
    )
    lag_times: tuple[float, ...] = tuning(
        (4.0, 40.0),
        'time constants of the delayed part of the curvature',
        unit='s',
        source='sweep',
    )
    play: float = tuning(
        0.06,
        'width of a play (dead band) that is missing in the model',
        unit='of the range',
        source='sweep',
    )
    late_share: float = tuning(
        0.1, 'std of the delayed part of the curvature, for each time constant', source='sweep'
    )
    play_share: float = tuning(0.5, 'std of the share of that play', source='sweep')
    memory_time: float = tuning(
        200.0,
        'correlation time of the delayed part and of the play; forgetting time of frames in the '
        'estimate of the size',
        unit='s',
        source='sweep',
    )

    grid: SizeGrid = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Set up the grid of sizes."""
        grid = SizeGrid(sizes=self.sizes, fall=self.size_fall, time=self.memory_time)
        object.__setattr__(self, 'grid', grid)

    @property
    def law_errors(self) -> tuple[Mapping[str, float], ...]:
        """An error of the intrinsic curvature, then one of the stiffness."""
        return self.curvature, self.stiffness

    @property
    def sized(self) -> tuple[int, ...]:
        """The two errors of the law; the delayed error has its own size."""
        return 0, 1

    @property
    def std(self) -> Array:
        """Errors of the law for a size of 1, then the parts with memory."""
        late = [self.late_share] * len(self.lag_times)
        return np.array([1.0, 1.0, *late, self.play_share])

    @property
    def times(self) -> Array:
        """Correlation times: errors of the law change, parts with memory are slow."""
        memory = [self.memory_time] * (len(self.lag_times) + 1)
        return np.array([self.correlation_time, self.correlation_time, *memory])

    def move(self, passage: Passage, by_times: Move) -> Move:
        """Change errors of the law with time and pressure, all others with time."""
        noise, grown = by_times.noise.copy(), self.growth(passage.seconds, passage.pressure_change)
        noise[:2] = [passage.size * one for one in grown]
        return Move(decay=by_times.decay, noise=noise)

    def on_rod_as_read(self, causes: Array, columns: slice, inputs: FrameInputs) -> None:
        """Convert the delayed part to a curvature, and the play to a pressure."""
        causes[columns.start, 2:-1] = inputs.lag_offsets[:-1] / self.range
        causes[PRESSURE, -1] = inputs.lag_offsets[-1]

    def as_pressure(self, inputs: FrameInputs) -> Array:
        """Return the pressure equivalent to a curvature."""
        return np.concatenate([[self.range, 0.0], inputs.lag_offsets])

    def remember(
        self, memory: tuple[float, ...], chamber: float, seconds: float
    ) -> tuple[float, ...]:
        """Return the pressures (Pa) lagging behind the chamber, and the pressure behind the play.

        memory: these pressures at the last reading, `seconds` ago, empty before the first; chamber
        (Pa): now. This is exact if the chamber pressure jumps at each reading and is constant in
        between.
        """
        if not memory:
            return (chamber,) * (len(self.lag_times) + 1)
        *lagging, played = memory
        late = [
            chamber + (one - chamber) * math.exp(-seconds / time)
            for one, time in zip(lagging, self.lag_times, strict=True)
        ]
        half = 0.5 * self.play * self.range
        return (*late, min(max(played, chamber - half), chamber + half))


def pressure_span(arm: Arm) -> tuple[float, float]:
    """Return a nonzero range of pressure (Pa), also for a calibration at one pressure."""
    low, high = arm.pressure_range
    return (low, high) if low < high else arm.table_range


def curvature_off(arm: Arm) -> dict[str, float]:
    """Return curvature errors as large as the effect of the pressure range, by dotted path.

    The moment law is unchanged.
    """
    table = arm.intrinsic_curvature
    low, high = (table.at(pressure, table.arclength) for pressure in pressure_span(arm))
    field = table.curvature[0] if len(table.pressure) == 1 else high - low
    return {
        f'intrinsic_curvature.curvature.{row}.{knot}': float(value)
        for row in range(len(table.pressure))
        for knot, value in enumerate(field)
    }


def stiffness_off(arm: Arm, share: float) -> dict[str, float]:
    """Return the change of the model by a uniform relative stiffness error, by dotted path."""
    law = arm.moment_law
    return {
        '.'.join(('moment_law', name, *map(str, index))): share * float(value)
        for name in STIFFNESS
        if hasattr(law, name)
        for index, value in np.ndenumerate(np.asarray(getattr(law, name)))
    }

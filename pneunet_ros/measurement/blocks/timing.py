"""Time between camera and pressure sensor: late stamps, another clock, lost frames, or a lag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block, FrameInputs
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing(Block):
    """Time (s) by which a frame shows the arm later than its stamp says, by the pressure.

    Observable while the pressure changes. The fusion reads the pressure of a frame at the delay
    believed so far, so the unknown is what remains of it. It drifts, as in a film that has lost
    frames. delay_std, time (s): one sigma and correlation time. swings: whether the arm swings;
    then its delay is kept, because such an arm does not show the pressure of an instant.
    """

    WINDOW: ClassVar = 1.0 / 30.0  # s, at least, for the rate of the pressure: a frame
    delay_std: float
    time: float
    swings: bool

    @property
    def std(self) -> Array:
        """One sigma of the delay."""
        return np.array([0.0 if self.swings else self.delay_std])

    @property
    def times(self) -> Array:
        """One correlation time."""
        return np.array([self.time])

    def on_rod_as_read(self, causes: Array, columns: slice, inputs: FrameInputs) -> None:
        """Take the pressure at another time."""
        causes[PRESSURE] = inputs.pressure_rate

"""A slow pressure error: the effect of creep, hysteresis and sensor drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import FrameInputs, Move, Passage, SizedBlock
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE

# Halved or doubled, it moves no figure of acceptance/sweep.py.
UNREAD = 0.5  # of the range: std of a pressure that is no longer measured


@dataclass(frozen=True, slots=True, kw_only=True)
class PressureError(SizedBlock):
    """Error (Pa) of the chamber pressure relative to its reading."""

    @property
    def std(self) -> Array:
        """The pressure range times the size of the model error."""
        return np.array([self.range])

    @property
    def times(self) -> Array:
        """One correlation time."""
        return np.array([self.correlation_time])

    @property
    def sized(self) -> tuple[int, ...]:
        """Scales with the model error."""
        return (0,)

    def move(self, passage: Passage, by_times: Move) -> Move:
        """Return process noise that grows with time and with the change of pressure."""
        (grown,) = self.growth(passage.seconds, passage.pressure_change)
        return Move(decay=by_times.decay, noise=np.array([passage.size * grown * self.range]))

    def on_rod(self, causes: Array, columns: slice) -> None:
        """Add the error to the pressure."""
        causes[PRESSURE] = 1.0

    def as_pressure(self, inputs: FrameInputs) -> Array:
        """Return 1: the unknown is a pressure."""
        return np.ones(1)

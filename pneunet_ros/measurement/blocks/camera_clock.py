"""Delay of the camera's stamps: a late driver, another clock, or a film that has lost frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.blocks.block import Block, FrameInputs
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraClock(Block):
    """Time (s) by which frames were taken later than their stamps and the model's delay say.

    It is observable while the pressure changes. The fusion reads the pressure of a frame at the
    delay believed so far, so that the unknown is what remains of it.
    """

    FRAME: ClassVar = 1.0 / 30.0  # s, of most cameras: a shorter delay is never a wrong clock
    stamped_std: float = tuning(
        1e-3,
        'std of the stamps of a camera whose driver stamps its frames',
        unit='s',
        source='convention: a millisecond',
    )
    any_delay: float = tuning(
        0.3,
        'std of the delay of a camera whose stamps are wrong',
        unit='s',
        source='convention: ten frames at 30 Hz',
    )
    walk: float = tuning(
        0.1,
        'random walk of that delay',
        unit='s/sqrt(s)',
        source='tried on three films that lose 3 % of their frames: with 0.03 the force is '
        'withheld in 0.12 more of the readings',
    )

    @property
    def std(self) -> Array:
        """Prior of a camera whose stamps are right."""
        return np.array([self.stamped_std])

    def on_rod_as_read(self, causes: Array, columns: slice, inputs: FrameInputs) -> None:
        """Take the pressure at another time."""
        causes[PRESSURE] = inputs.pressure_rate

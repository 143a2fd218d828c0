"""The white noise of the readings of moment and pressure at a stamp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.solver.columns import END_LOAD_MOMENT


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingNoise(Block):
    """Noise of the moment (N m) and of the pressure (Pa), new in every reading."""

    white: ClassVar[bool] = True

    @property
    def std(self) -> Array:
        """Zero before a reading."""
        return np.zeros(2)

    def on_rod(self, causes: Array, columns: slice) -> None:
        """Add the noise to the readings."""
        causes[END_LOAD_MOMENT, 0] = causes[PRESSURE, 1] = 1.0

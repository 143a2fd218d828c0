"""Common offset and spacing error of the row of dots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block, Prior
from pneunet_ros.measurement.blocks.model_columns import ModelColumns
from pneunet_ros.measurement.disturbances import row_shifts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetRow(Block):
    """Relative error of the spacing, and offset from the neutral line over the row's length.

    arclength (dots,) m; spacing_std, offset_std: prior of an uncalibrated row. The calibrated row
    is part of `Placement`; this block is used for other dots.
    """

    arclength: Array
    spacing_std: float
    offset_std: float

    @property
    def std(self) -> Array:
        """Prior of an uncalibrated row."""
        return np.array([self.spacing_std, self.offset_std])

    @property
    def prior(self) -> Prior:
        """Zero: the row is where the model file states."""
        zero = np.zeros(2)
        return Prior(mean=zero, std=zero, shared=(ModelColumns, np.zeros((2, 0))))

    def on_dots(self, unknowns: Array) -> Array:
        """Scale the positions of all dots along the arm, and shift them equally across it."""
        shifts = row_shifts(self.arclength).reshape(2, -1, 2)
        return np.tensordot(shifts, unknowns, axes=1)

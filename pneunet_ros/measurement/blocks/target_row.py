"""Common offset and spacing error of the row of dots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block, Prior
from pneunet_ros.measurement.disturbances import row_shifts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetRow(Block):
    """Relative error of the spacing, and offset from the neutral line over the row's length.

    arclength (dots,) m; spacing_std, offset_std: of other dots than the calibrated ones. The row
    of the model file is part of `Placement`: its prior here is zero, until the dots are others.
    """

    arclength: Array
    spacing_std: float
    offset_std: float

    @property
    def std(self) -> Array:
        """One sigma of a row that was painted again."""
        return np.array([self.spacing_std, self.offset_std])

    @property
    def prior(self) -> Prior:
        """Zero: the row is where the model file states."""
        return Prior(mean=np.zeros(2), std=np.zeros(2))

    def on_dots(self, unknowns: Array) -> Array:
        """Scale the positions of all dots along the arm, and shift them equally across it."""
        shifts = row_shifts(self.arclength).reshape(2, -1, 2)
        return np.tensordot(shifts, unknowns, axes=1)

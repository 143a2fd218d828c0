"""Swing about the equilibrium, and errors of mass and damping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion(Block):
    """Coordinates and momenta of the shapes, and relative errors of mass and damping.

    place_std, momentum_std (shapes,): one sigma before any frame, in units of
    `measurement.swinging_arm`; relative (2,): one sigma of mass and damping.
    """

    place_std: Array
    momentum_std: Array
    relative: Array
    SHAPES: ClassVar[int] = 2
    PLACE: ClassVar[slice] = slice(0, 2)
    MOMENTUM: ClassVar[slice] = slice(2, 4)
    SWING: ClassVar[slice] = slice(0, 4)
    RELATIVE: ClassVar[slice] = slice(4, 6)

    @property
    def std(self) -> Array:
        """Standard deviations of coordinates, momenta and relative errors."""
        return np.concatenate([self.place_std, self.momentum_std, self.relative])

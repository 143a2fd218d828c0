"""Placement of the dots relative to the model file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block, Prior
from pneunet_ros.measurement.blocks.model_columns import ModelColumns
from pneunet_ros.model.uncertainty import PlacementKnown


@dataclass(frozen=True, slots=True, kw_only=True)
class Placement(Block):
    """Displacement of each dot (m), tangential then normal to the arm.

    one_std (m): prior of an uncalibrated dot; known: posterior of the calibration, None without
    one.
    """

    dots: int
    one_std: float
    known: PlacementKnown | None = None

    @property
    def std(self) -> Array:
        """Prior of uncalibrated dots."""
        return np.full(2 * self.dots, self.one_std)

    @property
    def prior(self) -> Prior:
        """Use the placement of the calibration, which is correlated with the model.

        The same images must not count twice.
        """
        if self.known is None:
            return Prior(mean=np.zeros(2 * self.dots), std=self.std)
        known = self.known
        return Prior(mean=known.mean, std=known.std, shared=(ModelColumns, known.factor))

    def of_dots(self, which: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
        """Return the unknowns of some dots, along and across the arm."""
        return np.concatenate([which, self.dots + which])

    def on_dots(self, unknowns: Array) -> Array:
        """Displace each dot."""
        return unknowns.reshape(2, self.dots, *unknowns.shape[1:])

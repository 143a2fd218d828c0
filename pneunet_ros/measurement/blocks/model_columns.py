"""The model error as stated by the calibration: the columns of its covariance."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.blocks.block import Block, FrameInputs, WrenchSeen
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE

# Correlation time (s) of errors that a calibration has only guessed: they depend on pressure and
# load, and so last as long as a constant force. Halved or doubled, it moves no figure of
# acceptance/sweep.py.
GUESS_TIME = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelColumns(Block):
    """Columns of the model's covariance, in sigma; must be the first block with columns.

    known: the number of columns; guessed: how many of them, at the end, the calibration only
    guessed.
    """

    known: int
    guessed: int

    @property
    def std(self) -> Array:
        """Standard deviations: the columns are scaled to one sigma."""
        return np.ones(self.known)

    @property
    def times(self) -> Array:
        """Constant, except for guessed errors."""
        constant = np.full(self.known - self.guessed, math.inf)
        return np.concatenate([constant, np.full(self.guessed, GUESS_TIME)])

    @property
    def law_columns(self) -> int:
        """All unknowns of the block: each is a column of the law."""
        return self.known

    def on_rod_as_read(self, causes: Array, columns: slice, inputs: FrameInputs) -> None:
        """Change the true pressure, through sensing effects."""
        causes[PRESSURE] = inputs.by_column[: self.known]

    def on_wrench(self, seen: WrenchSeen) -> Array:
        """Change the true force, through sensing effects."""
        return -seen.by_column[: self.known].T

"""What makes the residuals of a frame white, with the errors of its readings integrated out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array


class Whitening:
    """Makes residuals of frames white: noise of targets and errors of that frame's readings.

    With covariance sigma^2 1 + P P^T, P = U S V^T: subtracts along U what the readings explain.
    """

    def __init__(self, sigma: float, sensed: Array, mask: npt.NDArray[np.bool_]) -> None:
        self.sigma, self.mask = sigma, mask
        masked = np.where(mask[:, :, None], sensed, 0.0)
        self.directions, sizes, _ = np.linalg.svd(masked / sigma, full_matrices=False)
        self.shrink = 1.0 - 1.0 / np.sqrt(1.0 + sizes**2)

    def __call__(self, columns: Array) -> Array:
        """Whiten columns (frames, coordinates, n); zero where nothing was seen."""
        columns = np.where(self.mask[:, :, None], columns, 0.0)
        along = np.matmul(self.directions.transpose(0, 2, 1), columns)
        along *= self.shrink[:, :, None]
        white: Array = (columns - np.matmul(self.directions, along)) / self.sigma
        return white

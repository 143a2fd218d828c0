"""Covariances C = D + P P^T: white noise D plus errors common to all coordinates.

The columns of P are the displacements by one sigma of each common error (reading, model, camera).
Treating the coordinates as independent gives the right variances but causes false alarms in tests.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array


class Whitening:
    """An inverse root W of covariances: W^T W = C^-1, so that W times a residual is white.

    With D = diag(std^2) and P = diag(std) U S V^T, the root is W = (1 - U (1 - (1 + S^2)^-1/2)
    U^T) / std: the component explained by the common errors is subtracted along U. Leading axes,
    such as the frames of a recording, are a batch; coordinates that are not `seen` are ignored,
    even NaN. log_volume: log of sqrt(det C / det D), summed over the batch.
    """

    __slots__ = ('directions', 'log_volume', 'seen', 'shrink', 'std')

    def __init__(
        self, std: float | Array, columns: Array, seen: npt.NDArray[np.bool_] | None = None
    ) -> None:
        """Take std (coordinates,) or one for all, columns P (..., coordinates, errors).

        seen (..., coordinates): None if all were.
        """
        self.std = np.broadcast_to(np.asarray(std, np.float64), columns.shape[-2:-1])[:, None]
        self.seen = None if seen is None else seen[..., None]
        self.directions, sizes, _ = np.linalg.svd(
            self._masked(columns) / self.std, full_matrices=False
        )
        self.shrink = (1.0 - 1.0 / np.sqrt(1.0 + sizes**2))[..., None]
        self.log_volume = 0.5 * float(np.sum(np.log1p(sizes**2)))

    def __call__(self, values: Array) -> Array:
        """Return W values (..., coordinates, n); zero for unseen coordinates."""
        scaled = self._masked(values) / self.std
        along = self.shrink * np.matmul(np.swapaxes(self.directions, -1, -2), scaled)
        white: Array = scaled - np.matmul(self.directions, along)
        return white

    def _masked(self, values: Array) -> Array:
        return values if self.seen is None else np.where(self.seen, values, 0.0)


def probable_errors(residual: Array, columns: Array) -> tuple[Array, Array]:
    """Return P^T r and the most probable common errors (1 + P^T P)^-1 P^T r, (..., errors) sigma.

    residual (..., coordinates) and columns P (..., coordinates, errors), both over the std of the
    white noise.
    """
    transposed = np.swapaxes(columns, -1, -2)
    along = np.matmul(transposed, residual[..., None])
    small = np.eye(columns.shape[-1]) + np.matmul(transposed, columns)
    return along[..., 0], np.linalg.solve(small, along)[..., 0]

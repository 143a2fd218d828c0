"""How errors stand to the covariance that is said of them."""

from __future__ import annotations

import numpy as np


def squares(error, covariance) -> np.ndarray:
    """Return e^T P^-1 e (n,) of errors (n, k) and their covariances (n, k, k)."""
    solved = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    return np.asarray(np.sum(error * solved, axis=1))

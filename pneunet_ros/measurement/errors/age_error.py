"""Error of an end load reading that is older than the pressure reading, as an error source."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.solver.columns import LOADS


def with_age_error(noise: Array, change: Array, share: float) -> Array:
    """Add the change of a load since its reading to the noise input matrix (sources, causes).

    change (3,): of F1, F2, M between the last two readings; share: age of the last reading,
    relative to the time between both. The load may have continued to change at this rate since the
    last reading; the noise of both readings explains a part of the change. If noise explains all
    of it, the matrix is returned unchanged.
    """
    explained = 2.0 * np.sum(noise[:LOADS, :LOADS] ** 2, axis=0)
    spread = np.sign(change) * np.sqrt(np.maximum(change**2 - explained, 0.0))
    if not share > 0.0 or not spread.any():
        return noise
    source = np.zeros((1, noise.shape[1]))
    source[0, :LOADS] = min(share, 1.0) * spread
    return np.concatenate([noise, source])

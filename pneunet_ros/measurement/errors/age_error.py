"""Error of an end load that was read before the pressure, as a further error source."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.solver.columns import LOADS


def with_age_error(noise: Array, change: Array, share: float) -> Array:
    """Return the noise input matrix (sources, causes) with the change of a load since its reading.

    change (3,): of F1, F2, M from the reading before to the last one; share: age of the last one
    over the time between both. The load may have changed on at this rate, for this time at most;
    noise of both readings explains a part of the change. The given matrix is returned if it
    explains all of it.
    """
    explained = 2.0 * np.sum(noise[:LOADS, :LOADS] ** 2, axis=0)
    spread = np.sign(change) * np.sqrt(np.maximum(change**2 - explained, 0.0))
    if not share > 0.0 or not spread.any():
        return noise
    source = np.zeros((1, noise.shape[1]))
    source[0, :LOADS] = min(share, 1.0) * spread
    return np.concatenate([noise, source])

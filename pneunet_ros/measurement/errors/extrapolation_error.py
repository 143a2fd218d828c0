"""Model error outside the calibrated domain, as further independent error sources."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.domain_position import DomainPosition


def with_extrapolation_error(noise: Array, position: DomainPosition) -> Array:
    """Return the noise input matrix (sources, causes) with the model error outside the domain.

    position: that of the load in the domain. The errors of F1, F2, M and chamber pressure are one
    source each, after those of `noise_jacobian`. Inside the domain, the given matrix is returned.
    """
    if not any(position.error):
        return noise
    sources, causes = noise.shape
    more = np.zeros((sources + len(position.error), causes))
    more[:sources] = noise
    for cause, error in enumerate(position.error):
        more[sources + cause, cause] = error
    return more

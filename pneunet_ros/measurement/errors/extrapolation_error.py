"""Model error outside the calibrated domain, as further independent error sources."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.model.domain_position import DomainPosition


def with_extrapolation_error(noise: Array, position: DomainPosition) -> Array:
    """Add the model error outside the domain to the noise input matrix (sources, causes).

    position: of the load relative to the domain. The errors of F1, F2, M and chamber pressure are
    one source each, appended to the sources of `noise_jacobian`. Inside the domain, the matrix is
    returned unchanged.
    """
    if not any(position.error):
        return noise
    sources, causes = noise.shape
    more = np.zeros((sources + len(position.error), causes))
    more[:sources] = noise
    for cause, error in enumerate(position.error):
        more[sources + cause, cause] = error
    return more

"""Second-order effects of errors, where the linearization alone is overconfident.

The tip of a nearly straight arm moves along the arm only by the square of an error, so that its
covariance to first order is singular there. One direction is enough: the direction in which errors
of readings and model together move the tip most. With r(+-) the shapes at one sigma to either
side, let delta = (r(+) + r(-) - 2 r(0)) / 2. An error of xi sigma moves the arm by xi J d + xi^2
delta. For normal xi, the second moment of the last term about the published shape is 3 delta
delta^T, of which 2 are its covariance and 1 the square of its mean. The term is uncorrelated with
the first-order error and is therefore one more independent source.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.kernels.jit import inner
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.solver.columns import CURVATURE
from pneunet_ros.solver.sides import NOT_DEFINED, second_difference, SideNodes, STABLE, UNSTABLE

SECOND_MOMENT = 3.0  # E[xi^4] of a normal xi
# Sigma along the leading error: halved until both sides have an equilibrium of the same kind.
STEPS = (1.0, 0.5, 0.25, 0.125)
KINDS = {None: NOT_DEFINED, True: STABLE, False: UNSTABLE}  # of a rod, by whether it is stable


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SecondOrder:
    """The solved rod on both sides of an estimate, `step` sigma along its leading error.

    sensitivity: that of the estimate.
    """

    sensitivity: Sensitivity
    sides: SideNodes
    step: float

    def stations(self, arclength: Array) -> Array:
        """Return an additional independent error of x, y (m), theta (rad), (3, n), at places."""
        error = np.empty((CURVATURE, arclength.size))
        factor = second_order_factor(self.step)
        response = self.sensitivity.for_kernels()
        second_difference(response, self.sides, frozen_array(arclength), factor, error)
        return error


@inner
def second_order_factor(step: float) -> float:
    """Return the std of the square of a normal error, relative to the second difference."""
    return 0.5 * math.sqrt(SECOND_MOMENT) / step**2


@inner
def leading_error(tip: Array, noise: Array) -> Array:
    """Return the causes (causes,) of the one-sigma error that moves the tip furthest.

    tip (causes, 3): sensitivity of x, y, theta; noise (sources, causes): the noise input matrix.
    The rod is solved to both sides along it. Source: second-order filters by central differences,
    Norgaard, Poulsen, Ravn, Automatica 36 (2000).
    """
    sources, causes = noise.shape
    tip_change, direction = np.zeros((sources, 2)), np.zeros(causes)
    variance_x, covariance_xy, variance_y = 0.0, 0.0, 0.0
    for source in range(sources):
        for cause in range(causes):
            for i in range(2):
                tip_change[source, i] += noise[source, cause] * tip[cause, i]
        variance_x += tip_change[source, 0] * tip_change[source, 0]
        covariance_xy += tip_change[source, 0] * tip_change[source, 1]
        variance_y += tip_change[source, 1] * tip_change[source, 1]
    angle = 0.5 * math.atan2(2.0 * covariance_xy, variance_x - variance_y)
    x, y = math.cos(angle), math.sin(angle)
    size = math.sqrt(x * x * variance_x + 2.0 * x * y * covariance_xy + y * y * variance_y)
    if not size > 0.0:
        return direction
    for source in range(sources):
        weight = (tip_change[source, 0] * x + tip_change[source, 1] * y) / size
        for cause in range(causes):
            direction[cause] += weight * noise[source, cause]
    return direction

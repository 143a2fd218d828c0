"""What all errors together move: the covariance of the tip, the deviations along the arm."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.measurement.noise_jacobian import propagate_covariance
from pneunet_ros.measurement.second_order import second_order, SecondOrder
from pneunet_ros.model.equilibrium import Sensitivity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PropagatedErrors:
    """Covariance (3, 3) of x, y (m), theta (rad) of the tip, and standard deviations.

    std (3, stations): of x, y (m) and curvature (1/m) along the arm. second_order: what errors
    move beyond the linearization; it is in both. None where there is none and the shape was seen.
    """

    tip_covariance: Array
    std: Array
    second_order: SecondOrder | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeenShape:
    """Where along an arm (places,) m its shape was measured, and its std (2, places) m."""

    arclength: Array
    std: Array

    def allowed(self, curved: SecondOrder) -> float:
        """Return the share of an error to second order that would not have been seen.

        Errors whose linear parts cancel at the places seen, and whose second order does not, are
        no errors of one sigma any more: the measurements bound them where the second order is as
        large as their noise.
        """
        moved = curved.stations(self.arclength)[:2] / self.std
        size = math.sqrt(float(np.sum(moved**2)))
        return 1.0 / max(1.0, size)


def propagate_errors(
    sensitivity: Sensitivity, noise: Array, arclength: Array, seen: SeenShape | None = None
) -> PropagatedErrors | None:
    """Carry errors through a solved rod, to second order.

    noise (sources, causes): the noise input matrix; arclength (stations,) m; seen: where the shape
    was measured, if it was. None where the shape has no bounded answer to its errors.
    """
    covariance, std = np.empty((3, 3)), np.empty((3, arclength.size))
    curved = second_order(sensitivity, noise)
    if curved is None:
        if seen is None:
            return None
        further = np.zeros((3, arclength.size))
    else:
        further = curved.stations(arclength)
        if seen is not None:
            further *= seen.allowed(curved)
    stations = sensitivity.stations(arclength)
    if not propagate_covariance(noise, sensitivity.tip, stations, further, covariance, std):
        return None
    return PropagatedErrors(
        tip_covariance=freeze(covariance), std=freeze(std), second_order=curved
    )

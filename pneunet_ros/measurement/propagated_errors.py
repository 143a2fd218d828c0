"""What all errors together move: the covariance of the tip, the deviations along the arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.measurement.noise_jacobian import propagate_covariance
from pneunet_ros.measurement.second_order import second_order, SecondOrder
from pneunet_ros.model.equilibrium import Sensitivity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PropagatedErrors:
    """Covariance (3, 3) of x, y (m), theta (rad) of the tip, and standard deviations.

    std (3, stations): of x, y (m) and curvature (1/m) along the arm. second_order: what errors
    move beyond the linearization; it is in both.
    """

    tip_covariance: Array
    std: Array
    second_order: SecondOrder


def propagate_errors(
    sensitivity: Sensitivity, noise: Array, arclength: Array
) -> PropagatedErrors | None:
    """Carry errors through a solved rod, to second order.

    noise (sources, causes): the noise input matrix; arclength (stations,) m. None where the shape
    has no bounded answer to its errors.
    """
    covariance, std = np.empty((3, 3)), np.empty((3, arclength.size))
    curved = second_order(sensitivity, noise)
    if curved is None or not propagate_covariance(
        noise, sensitivity.tip, sensitivity.stations(arclength), covariance, std
    ):
        return None
    further = curved.stations(arclength)
    covariance += np.outer(further[:, -1], further[:, -1])
    std[:2] = np.hypot(std[:2], further[:2])
    return PropagatedErrors(
        tip_covariance=freeze(covariance), std=freeze(std), second_order=curved
    )

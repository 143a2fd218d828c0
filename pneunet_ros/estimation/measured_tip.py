"""Uncertainty of the force found from a measured tip.

The estimated force brings the model's tip to the measured position. Errors of tip, pressure and
model change the force by d F = (d tip / d F)^-1 (d tip_measured - d tip_model), and the shape
moves by the sum of both, but hardly near the measured tip. First order is sufficient, because the
second-order motion of the tip along the arm does not occur here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.measurement.errors.extrapolation_error import with_extrapolation_error
from pneunet_ros.measurement.errors.noise_jacobian import propagate_covariance
from pneunet_ros.solver.columns import FORCE_Y, LOADS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredTip:
    """The estimate at a measured tip, and the covariance (2, 2) N^2 of the estimated force."""

    estimate: ShapeEstimate
    force_covariance: Array


def with_measured_tip(
    estimator: Estimator, estimate: ShapeEstimate, tip_std: float
) -> MeasuredTip | None:
    """Return an estimate with errors for a measured tip.

    estimate: at the estimated force, with the tip at its measured position; the moment is exact.
    tip_std: one sigma (m) of x and of y of that position. None if there is no covariance.
    """
    if estimate.noise is None or estimate.curved is None or estimate.position is None:
        return None
    sensitivity = estimate.curved.sensitivity
    known = estimate.noise[LOADS:].copy()  # pressure and model: no wrench was measured
    known[:, :LOADS] = 0.0
    causes = with_extrapolation_error(known, estimate.position)
    forces = slice(0, FORCE_Y + 1)
    response = sensitivity.tip[forces, :2]  # (F1 or F2, x or y) m/N
    force_errors = np.linalg.solve(
        response.T, np.hstack([-(causes @ sensitivity.tip[:, :2]).T, tip_std * np.eye(2)])
    ).T
    noise = np.vstack([causes, np.zeros((2, causes.shape[1]))])
    noise[:, forces] += force_errors
    covariance, std = np.empty((3, 3)), np.empty((3, estimator.arclength.size))
    stations = sensitivity.stations(estimator.arclength)
    added = np.zeros_like(std)
    if not propagate_covariance(noise, sensitivity.tip, stations, added, covariance, std):
        return None
    std_x, std_y, std_curvature = freeze(std)
    return MeasuredTip(
        estimate=replace(
            estimate,
            tip_covariance=freeze(covariance),
            std_x=std_x,
            std_y=std_y,
            std_curvature=std_curvature,
            noise=noise,
            curved=None,
        ),
        force_covariance=freeze(force_errors.T @ force_errors),
    )

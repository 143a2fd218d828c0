"""Uneven bending between targets, added to the covariance of a fit.

A constant curvature between clamp and tip, or a curve through a few numbers, is only an
approximation. The departure from such a curve is not fitted but considered: a departure d with a
known prior S changes the fit by C I d, where C is the covariance of the fit and I the information
of the data, so that the error is E d with E = C I - 1, and the total covariance C + E S E^T
(Schmidt's consider covariance: S. F. Schmidt, Advances in Control Systems 3, 1966). Quantities
determined by the targets keep their accuracy. An error E d of the fit implies an error G E d of
the painted target positions, which are estimated from the same images, with G the gain of their
posterior.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.polynomial import legendre
from pneunet_ros.calibration.low_rank import COVARIANCE_FRAMES, shape_jacobian
from pneunet_ros.calibration.parameters import correlation, Parameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import CONSISTENCY, RESOLUTION
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters
from pneunet_ros.measurement.tip_frame import TIP_FRAME

# Correlation length of both departures (arm lengths): about that of the paper's arm. No figure of
# acceptance/sweep.py moves when it is halved or doubled.
SCALE = 0.3
ROUNDING = 1e-12  # relative increase of a variance, so that it can be inverted
STATIONS, MODES = 41, 4  # for the linear part of a smooth departure along the arm


def consider_nonuniformity(fit: Fit, shown: int) -> Fit:
    """Return the fit with the covariance of nonuniform curvature between targets.

    shown: the number of values along the arm that the targets resolve; if the curve has fewer
    values, the targets show how evenly the arm bends. If the residuals are much larger than noise,
    the uncertainty of the fit is scaled by the same factor (as by the Particle Data Group),
    because few targets cannot locate the error.
    """
    parameters = fit.parameters
    if parameters.shapes is None:
        return fit
    information = fit.all_information
    prior = departure_prior(parameters, fit.values)
    if parameters.shapes < shown:
        gradient = fit.information_vector - fit.information @ (fit.values - parameters.mean)
        prior = known_departure(prior, information, fit.covariance, gradient)
    errors = fit.covariance @ information[:, : parameters.cells]
    errors[: parameters.cells] -= np.eye(parameters.cells)
    size = fit.values.size
    regression = np.linalg.solve(fit.covariance, fit.shared_covariance[:size, size:]).T
    errors = np.concatenate([errors, regression @ errors])
    missed = fit.chi_squared / max(fit.dof, 1)
    scale = missed if missed > CONSISTENCY.misfit else 1.0
    shared = scale * fit.shared_covariance + errors @ prior @ errors.T
    return replace(
        fit, covariance=frozen_array(shared[:size, :size]), shared_covariance=frozen_array(shared)
    )


def known_departure(prior: Array, information: Array, covariance: Array, missed: Array) -> Array:
    """Return posterior over prior mean square of departures from the curve, (cells, cells).

    information (n, n) of the data, covariance (n, n) of the fit: the fit absorbs a part of a
    departure, so the remaining information is I - I C I. missed (n,): remaining linear term of the
    data after the fit. The departure is an error of the fit, not one of its parameters.
    """
    cells = len(prior)
    conditional = (information - information @ covariance @ information)[:cells, :cells]
    root = np.linalg.cholesky(prior + ROUNDING * float(np.trace(prior)) * np.eye(cells))
    known = root @ np.linalg.solve(np.eye(cells) + root.T @ conditional @ root, root.T)
    shown = known @ missed[:cells]
    return np.asarray(known + np.outer(shown, shown))


def shape_std(fit: Fit) -> tuple[float, float]:
    """Return the largest standard error (m) of a centerline position, and its s / l."""
    places = fit.arm.length * fit.parameters.arclength
    jacobian = shape_jacobian(fit, COVARIANCE_FRAMES, places)
    variance = np.einsum('ij,jk,ik->i', jacobian, fit.covariance, jacobian)
    total = variance.reshape(-1, 2, places.size).sum(axis=1)
    worst = int(np.argmax(total.max(axis=0)))
    return float(np.sqrt(total.max())), float(fit.parameters.arclength[worst])


def describe_nonuniformity(fit: Fit) -> list[Note]:
    """Return a note on the accuracy of the shape where few targets show it."""
    if fit.parameters.shapes is None:
        return []
    std, share = shape_std(fit)
    return [
        Note(
            f'between targets the shape is uncertain by up to {millimeters(std):.2g} mm (one '
            f'sigma, at s / l = {share:.2g}), because an arm may bend unevenly by '
            f'{TIP_FRAME.nonuniformity:g} of its curvature; the covariance includes this',
            reason='uncertain_between',
        )
    ]


def departure_prior(parameters: Parameters, values: Array) -> Array:
    """Return the covariance (cells, cells) of departures from the curve, 1/m^2.

    A departure has one shape for all pressures, in proportion to the mean curvature, and another
    for the arm at rest.
    """
    mean = values[: parameters.cells].reshape(parameters.pressure.size, -1).mean(axis=1)
    rest = RESOLUTION.nonuniform_rest / parameters.frame.length
    amplitude = TIP_FRAME.nonuniformity**2 * np.outer(mean, mean) + rest**2
    return np.asarray(np.kron(amplitude, correlation(parameters.arclength, SCALE)))


def linear_departure() -> float:
    """Return one sigma of the linear departure at the tip, relative to the mean curvature."""
    arclength = np.linspace(0.0, 1.0, STATIONS)
    linear = np.linalg.pinv(legendre.legvander(2.0 * arclength - 1.0, MODES - 1))[1]
    variance = linear @ correlation(arclength, SCALE) @ linear
    return TIP_FRAME.nonuniformity * float(np.sqrt(variance))

"""Model selection: smoothness of kappa_p0, numbers along the arm, and elongation.

Selected by the evidence of a first, linearized fit with all terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
import itertools

import numpy as np
from pneunet_ros.calibration.checks.nonuniformity import departure_prior
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import HYPERPARAMETERS
from pneunet_ros.core.arrays import Array

AMPLITUDES = (0.4, 0.8, 1.6)  # of the largest kappa_p0; idle in acceptance/sweep.py


def most_likely_parameters(
    first: Fit, tried: Iterable[Parameters], length_scales: Sequence[float]
) -> Parameters:
    """Return the candidate parameters with the largest evidence.

    The data enter through the information matrix and vector of the fit, so that no equilibrium is
    solved again. With few targets, uneven bending resembles an elongation and is therefore a
    competing hypothesis (`nonuniformity`). length_scales: candidates for the smoothness along the
    arm, relative to its length.
    """
    parameters = first.parameters
    known, cells = parameters.before_law, parameters.cells
    information, vector = first.information[:known, :known], first.information_vector[:known]

    def evidence(trial: Parameters, added: Array | float = 0.0) -> float:
        return log_evidence(trial.prior[:known, :known] + added, information, vector)

    smooth = [max(smoothnesses(first, one, length_scales), key=evidence) for one in tried]
    if len(smooth) == 1:
        return smooth[0]
    uneven = np.zeros((known, known))
    uneven[:cells, :cells] = departure_prior(parameters, first.values)
    return max(smooth, key=lambda trial: evidence(trial, uneven))


def smoothnesses(
    first: Fit, parameters: Parameters, length_scales: Sequence[float]
) -> Iterator[Parameters]:
    """Yield parameters for every smoothness; the amplitude of kappa_p0 is that of a fit."""
    largest = float(np.max(np.abs(first.values[: parameters.cells])))
    for length_scale, std, size in itertools.product(
        length_scales, HYPERPARAMETERS.stds, AMPLITUDES
    ):
        amplitude = size * largest
        yield replace(
            parameters,
            hyperparameters=Hyperparameters(
                amplitude=amplitude, std=std * amplitude, length_scale=length_scale
            ),
        )


def structures(most: Parameters) -> Iterator[Parameters]:
    """Yield parameters with ever fewer numbers along the arm, with and without elongation.

    If targets resolve the whole arm, kappa_p0 keeps its knots, whose prior is smooth.
    """
    shapes = most.shapes
    while shapes is None or shapes:
        for elongates in (None,) if most.elongates is None else (False, True):
            yield replace(most, shapes=shapes, elongates=elongates)
        if shapes is None:
            return
        shapes //= 2


def log_evidence(prior: Array, information: Array, information_vector: Array) -> float:
    """Return the log evidence of linear Gaussian data, up to a constant."""
    root = np.linalg.cholesky(prior)
    normal = root.T @ information @ root + np.eye(len(prior))
    along = root.T @ information_vector
    _, log_size = np.linalg.slogdet(normal)
    return 0.5 * float(along @ np.linalg.solve(normal, along)) - 0.5 * float(log_size)

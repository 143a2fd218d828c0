"""Model selection: smoothness of kappa_p0, numbers along the arm, and elongation.

One evidence chooses all of it: that of a first, linearized fit with all terms.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
import itertools

import numpy as np
from pneunet_ros.calibration.checks.nonuniformity import departure_prior
from pneunet_ros.calibration.parameters import Hyperparameters, Parameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import (
    CALIBRATION,
    CalibrationSettings,
    HyperparameterSettings,
)
from pneunet_ros.core.arrays import Array


def most_likely_parameters(
    first: Fit,
    tried: Iterable[Parameters],
    settings: CalibrationSettings = CALIBRATION,
) -> Parameters:
    """Return the tried parameters with the largest evidence, as smooth ones.

    The data enter through the fit's information and its vector, so nothing is solved again. An arm
    of which few targets show the shape may bend unevenly, which looks much like an elongation:
    that competes (`nonuniformity`).
    """
    parameters = first.parameters
    known, cells = parameters.before_law, parameters.cells
    information, vector = first.information[:known, :known], first.information_vector[:known]

    def evidence(trial: Parameters, further: Array | float = 0.0) -> float:
        return log_evidence(trial.prior[:known, :known] + further, information, vector)

    smooth = [
        max(smoothnesses(first, one, settings.hyperparameters), key=evidence) for one in tried
    ]
    if len(smooth) == 1:
        return smooth[0]
    uneven = np.zeros((known, known))
    uneven[:cells, :cells] = departure_prior(parameters, first.values, settings.resolution)
    return max(smooth, key=lambda trial: evidence(trial, uneven))


def smoothnesses(
    first: Fit, parameters: Parameters, choices: HyperparameterSettings
) -> Iterator[Parameters]:
    """Yield parameters for every smoothness; the amplitude of kappa_p0 comes from a fit."""
    largest = float(np.max(np.abs(first.values[: parameters.cells])))
    for length_scale, std, size in itertools.product(
        choices.length_scales, choices.stds, choices.amplitudes
    ):
        amplitude = size * largest
        yield replace(
            parameters,
            hyperparameters=Hyperparameters(
                amplitude=amplitude, std=std * amplitude, length_scale=length_scale
            ),
        )


def structures(most: Parameters) -> Iterator[Parameters]:
    """Yield parameters with fewer numbers along the arm, halved each time, lengthening or not.

    Where targets show all of the arm, kappa_p0 keeps its knots: their prior is smooth.
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

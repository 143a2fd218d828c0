"""How smooth kappa_p0 is, chosen by the evidence of a first, linearized fit."""

from __future__ import annotations

from dataclasses import replace
import itertools

import numpy as np
from pneunet_ros.calibration.parameters import Hyperparameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import HYPERPARAMETERS, HyperparameterSettings
from pneunet_ros.core.arrays import Array


def most_likely_hyperparameters(
    first: Fit, choices: HyperparameterSettings = HYPERPARAMETERS
) -> tuple[Hyperparameters, float]:
    """Return the smoothness under which the data of a fit are most probable, and its log evidence.

    The data enter through the fit's information and its vector, so nothing is solved again; the
    size of kappa_p0 is taken from the fit.
    """
    parameters, cells = first.parameters, first.parameters.cells
    largest = float(np.max(np.abs(first.values[:cells])))
    information, vector = first.information[:cells, :cells], first.information_vector[:cells]
    trials = []
    for length_scale, std, size in itertools.product(
        choices.length_scales, choices.stds, choices.amplitudes
    ):
        amplitude = size * largest
        trial = Hyperparameters(
            amplitude=amplitude, std=std * amplitude, length_scale=length_scale
        )
        prior = replace(parameters, hyperparameters=trial).prior[:cells, :cells]
        trials.append((trial, log_evidence(prior, information, vector)))
    return max(trials, key=lambda item: item[1])


def log_evidence(prior: Array, information: Array, information_vector: Array) -> float:
    """Return log of the evidence of linear Gaussian data, up to what the prior does not change."""
    root = np.linalg.cholesky(prior)
    normal = root.T @ information @ root + np.eye(len(prior))
    along = root.T @ information_vector
    _, log_size = np.linalg.slogdet(normal)
    return 0.5 * float(along @ np.linalg.solve(normal, along)) - 0.5 * float(log_size)

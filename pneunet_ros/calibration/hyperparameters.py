"""How smooth kappa_p0 is, chosen by the evidence of a first, linearized fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import itertools

import numpy as np
from pneunet_ros.calibration.parameters import Hyperparameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array

REACHES: Sequence[float] = (0.12, 0.18, 0.25, 0.35, 0.45, 0.55, 0.7, 0.9)  # of the length
DEVIATIONS = (0.003, 0.01, 0.03, 0.1, 0.3)  # of the amplitude
AMPLITUDES = (0.4, 0.8, 1.6)  # of the largest kappa_p0


def most_likely_hyperparameters(
    first: Fit, reaches: Sequence[float] = REACHES
) -> tuple[Hyperparameters, float]:
    """Return the smoothness under which the data of a fit are most probable, and its log evidence.

    The data enter through the fit's information and pull, so nothing is solved again; the size of
    kappa_p0 is taken from the fit. reaches: those to choose from, of the length.
    """
    parameters, cells = first.parameters, first.parameters.cells
    table = first.values[:cells].reshape(parameters.pressure.size, -1)
    largest = float(np.max(np.abs(table)))
    best: tuple[float, Hyperparameters] | None = None
    for reach, share, size in itertools.product(reaches, DEVIATIONS, AMPLITUDES):
        amplitude = size * largest
        trial = Hyperparameters(amplitude=amplitude, deviation=share * amplitude, reach=reach)
        prior = replace(parameters, hyperparameters=trial).prior[:cells, :cells]
        evidence = log_evidence(
            prior, first.information[:cells, :cells], first.information_vector[:cells]
        )
        if best is None or evidence > best[0]:
            best = evidence, trial
    assert best is not None
    return best[1], best[0]


def log_evidence(prior: Array, information: Array, information_vector: Array) -> float:
    """Return log of the evidence of linear Gaussian data, up to what the prior does not change."""
    root = np.linalg.cholesky(prior)
    normal = root.T @ information @ root + np.eye(len(prior))
    along = root.T @ information_vector
    _, log_size = np.linalg.slogdet(normal)
    return 0.5 * float(along @ np.linalg.solve(normal, along)) - 0.5 * float(log_size)

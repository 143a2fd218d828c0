"""The covariance of a fitted model in few columns: those that move the shape most."""

from __future__ import annotations

import numpy as np
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import EXPERIMENTS, ExperimentSettings
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.linearization import FittedRun, parameter_jacobian
from pneunet_ros.model.uncertainty import ModelCovariance, MOST_COLUMNS

DIGITS = 6


def low_rank(
    fit: Fit, most: int = MOST_COLUMNS, settings: ExperimentSettings = EXPERIMENTS
) -> tuple[ModelCovariance, float]:
    """Return the covariance of the model's numbers, and its share of the shape's variance.

    Of the factor Q of the full covariance those directions are kept in which the targets of the
    fitted frames move most, `most` of them, enlarged so that the variance in total is that of all.
    """
    factor = np.linalg.cholesky(fit.covariance + 1e-12 * np.diag(np.diag(fit.covariance)))
    jacobians = [run_jacobian(fit, run, settings.covariance_frames) for run in fit.runs]
    moved = np.concatenate(jacobians) @ factor
    _, sizes, turned = np.linalg.svd(moved, full_matrices=False)
    share = float(np.sum(sizes[:most] ** 2) / np.sum(sizes**2))
    columns = factor @ turned[:most].T / np.sqrt(share)
    names, change = fit.parameters.quantities()
    rounded = np.array(
        [[float(f'{value:.{DIGITS}g}') for value in row] for row in change @ columns]
    )
    return ModelCovariance(quantities=names, factor=rounded), share


def run_jacobian(fit: Fit, fitted: FittedRun, count: int) -> Array:
    """Return how targets in so many frames of a run move per parameter, (points, parameters)."""
    arm = fit.arm
    frames = np.unique(np.linspace(0, len(fitted.solved) - 1, count).astype(int))
    inputs = fitted.inputs.subset(frames[fitted.solved[frames]])
    model = ForwardModel(arm.target_arclength)
    model.solve(arm, inputs)
    by_input = model.point_jacobian(arm, inputs, fit.parameters.columns)
    jacobian = parameter_jacobian(fit.parameters, fit.values, by_input, inputs)
    return jacobian.reshape(-1, fit.values.size)

"""Low-rank covariance of a fitted model: the directions that move the shape most."""

from __future__ import annotations

import numpy as np
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.linearization import FittedRun, parameter_jacobian
from pneunet_ros.model.uncertainty import ModelCovariance, MOST_COLUMNS, PlacementKnown

DIGITS = 6
ROUNDING = 1e-12  # of a correlation
COVARIANCE_FRAMES = 24  # per run: more of them move no figure of acceptance/sweep.py


def low_rank(
    fit: Fit,
    most: int = MOST_COLUMNS,
    painted: int | None = None,
    guessed: Array | None = None,
    base_turn_std: float = 0.0,
) -> tuple[ModelCovariance, float]:
    """Return a low-rank covariance of the parameters, and the share of shape variance it captures.

    most: largest number of columns. painted: include the placement of only the first `painted`
    targets; None: all targets. guessed (parameters, errors): assumed errors, one extra column
    each. base_turn_std (rad): of the base frame of the recordings, a column of its own.

    Keeps the directions of the full covariance that move the targets of the fitted frames most,
    and scales them to preserve the total variance. If the targets resolve less than the table of
    kappa_p0, the shape at the knots and pressures of the table is included.
    """
    if guessed is None:
        guessed = np.zeros((fit.values.size, 0))
    turned = int(base_turn_std > 0.0)
    most -= turned + guessed.shape[1]
    factor = covariance_root(fit.covariance)
    shape_changes = shape_jacobian(fit, COVARIANCE_FRAMES) @ factor
    _, sizes, directions = np.linalg.svd(shape_changes, full_matrices=False)
    share = float(np.sum(sizes[:most] ** 2) / np.sum(sizes**2))
    columns = factor @ directions[:most].T / np.sqrt(share)
    names, change = fit.parameters.quantities()
    low_factor = np.pad(change @ np.hstack([columns, guessed]), ((0, turned), (turned, 0)))
    if turned:
        names, low_factor[-1, 0] = (*names, 'arm.clamp_angle'), base_turn_std
    low = ModelCovariance(
        quantities=names,
        factor=round_numbers(low_factor),
        placement=placement_posterior(
            fit, factor, directions[:most], painted, (turned, guessed.shape[1])
        ),
        guessed=guessed.shape[1],
    )
    return low, share


def covariance_root(covariance: Array) -> Array:
    """Return a square root (n, n) of a covariance that rounding may have made indefinite.

    Exactly known quantities get a variance of rounding size.
    """
    std = np.sqrt(np.diag(covariance))
    size, axes = np.linalg.eigh(covariance / std / std[:, None])
    return np.asarray(std[:, None] * axes * np.sqrt(np.maximum(size, ROUNDING)))


def placement_posterior(
    fit: Fit, factor: Array, directions: Array, painted: int | None, further: tuple[int, int]
) -> PlacementKnown:
    """Return the posterior of the placement, and its correlation with columns of the covariance.

    factor (n, n): root of the covariance of the parameters; directions (columns, n): the columns,
    in sigma of that root; further: number of columns before and after them, uncorrelated with the
    placement.
    """
    targets, size = fit.placement.shape[1], fit.values.size
    kept = np.arange(2 * targets).reshape(2, targets)[:, :painted].ravel()
    shared = fit.shared_covariance
    cross = np.linalg.solve(factor, shared[:size, size + kept])
    factor_of_placement = (directions @ cross).T
    remaining_variance = np.diagonal(shared)[size + kept] - np.sum(factor_of_placement**2, axis=1)
    return PlacementKnown(
        mean=round_numbers(fit.placement.ravel()[kept]),
        std=round_numbers(np.sqrt(np.maximum(remaining_variance, 0.0))),
        factor=round_numbers(np.pad(factor_of_placement, ((0, 0), further))),
        origin=round_numbers(fit.origin),
    )


def round_numbers(values: Array) -> Array:
    """Round values to the digits of a model file."""
    flat = [float(f'{value:.{DIGITS}g}') for value in values.ravel().tolist()]
    return np.reshape(flat, values.shape)


def shape_jacobian(fit: Fit, count: int, places: Array | None = None) -> Array:
    """Return the derivative of the shape in some frames of every run, (points, parameters).

    The points are the targets (m); with few targets, also the knots, and the unloaded shapes at
    the pressures of the table. Points are x, then y of all places, frame by frame.
    """
    arm, parameters = fit.arm, fit.parameters
    inputs = [run_inputs(run, count) for run in fit.runs]
    if parameters.shapes is not None:
        rows = parameters.pressure
        inputs.append(Inputs(pressure=rows, loads=np.zeros((rows.size, 3))))
    if places is None:
        places = arm.target_arclength
        if parameters.shapes is not None:
            places = np.union1d(places, arm.length * parameters.arclength)
    return np.concatenate([jacobian_at(fit, item, places) for item in inputs])


def run_inputs(fitted: FittedRun, count: int) -> Inputs:
    """Return the inputs of a run thinned to this many frames."""
    frames = np.unique(np.linspace(0, len(fitted.solved) - 1, count).astype(int))
    return fitted.inputs.subset(frames[fitted.solved[frames]])


def jacobian_at(fit: Fit, inputs: Inputs, places: Array) -> Array:
    """Return the Jacobian of points (m) of the arm, (points, parameters)."""
    arm, model = fit.arm, ForwardModel(places)
    solved = model.solve(arm, inputs).copy()
    by_input = model.point_jacobian(arm, inputs, fit.parameters.columns)
    jacobian = parameter_jacobian(fit.parameters, fit.values, by_input, inputs)
    return jacobian[solved].reshape(-1, fit.values.size)

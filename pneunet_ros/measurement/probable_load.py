"""The most probable load in a frame, given its targets, at which the frame is linearized.

Force noise may move the tip of a compliant arm by millimeters, beyond the linear range of the
model. The model is therefore linearized at the most probable load, given reading and targets.

Near a load at which the arm snaps, force noise even decides between two equilibria. Loads around
the reading are then searched for the observed equilibrium.
"""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.covariance import probable_errors
from pneunet_ros.measurement.errors.noise_model import attached_std
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN
from pneunet_ros.model.uncertainty import SensorNoise

ROUNDS = 2  # Gauss-Newton steps; after them the model is linear within the remaining error
DIRECTIONS = 8  # directions of the force in which another equilibrium is searched for
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
SNAPPED = 0.02  # lengths, rms of the targets: a frame may show another equilibrium
SEARCH_RADIUS = 2.0  # sigma, around the reading
CONFIRMED = 0.3  # of the distance, by which another equilibrium is confirmed


def probable_load_errors(
    model: ForwardModel,
    arm: Arm,
    run: RecordingData,
    inputs: Inputs,
    disturbance: Array,
    noise: SensorNoise,
) -> Array:
    """Return the difference between load and reading, (frames, 3) N, N m.

    Zero if no load was read, if the noise of the reading cannot explain the difference, and in
    frames without a shape. A known load is not corrected, because its error is the same in all
    frames.

    inputs: those with the load as read; disturbance (frames, 2, targets) m: contribution of
    placement and camera; model: start of the search for the equilibria.
    """
    shift = np.zeros_like(inputs.loads)
    std = attached_std(noise, run)
    if run.load_known or not std.any():
        return shift
    measured, snap_distance = run.points - disturbance, SNAPPED * arm.length
    solved_as_read = model.solve(arm, inputs).copy()
    shift = shift_of_snapped_frames(model, arm, inputs, measured, std)
    for _ in range(ROUNDS):
        shifted_inputs = inputs.with_loads(inputs.loads + shift)
        errors = linear_errors(model, arm, run, shifted_inputs, shift, disturbance, noise)
        # Beyond what noise explains, the correction falls to zero: the model is not fitted yet.
        weight = np.clip(2.0 - np.abs(errors).max(axis=1) / DOMAIN.significant, 0.0, 1.0)
        previous_shift, distance = shift, distance_to_targets(model, measured)
        previous_solutions = model.subset(np.arange(len(shift)))
        shift = std * errors * weight[:, None]
        solved = model.solve(arm, inputs.with_loads(inputs.loads + shift))
        shift[solved_as_read & ~solved] = 0.0
        new_distance = distance_to_targets(model, measured)
        overshot = np.flatnonzero(
            (new_distance > snap_distance) & (CONFIRMED * new_distance > distance)
        )
        if overshot.size:  # the step crossed the load at which the arm snaps
            shift[overshot] = previous_shift[overshot]
            model.start_from(previous_solutions.subset(overshot), overshot)
            model.solve(arm, inputs.with_loads(inputs.loads + shift))
    return shift


def shift_of_snapped_frames(
    model: ForwardModel, arm: Arm, inputs: Inputs, measured: Array, std: Array
) -> Array:
    """Return load shifts (frames, 3) that bring snapped frames to the observed shape.

    measured (frames, 2, targets) m; std (frames, 3) N, N m, of the reading; model: solved at the
    reading, and on return at the shifted loads.
    """
    shift = np.zeros_like(inputs.loads)
    distance = distance_to_targets(model, measured)
    snapped = np.flatnonzero(distance > SNAPPED * arm.length)
    if not snapped.size or model.measured is None:
        return shift
    limit = CONFIRMED * distance[snapped]
    snapped_inputs = inputs.subset(snapped)
    for angle in np.arange(DIRECTIONS) * (2.0 * np.pi / DIRECTIONS):
        offset = SEARCH_RADIUS * std[snapped] * [np.cos(angle), np.sin(angle), 0.0]
        stepped = model.subset(snapped)
        stepped.known[:] = False  # start at the measured shape
        stepped.solve(arm, snapped_inputs.with_loads(snapped_inputs.loads + offset))
        new_distance = distance_to_targets(stepped, measured[snapped])
        better = new_distance < limit
        limit = np.where(better, new_distance, limit)
        shift[snapped[better]] = offset[better]
        model.start_from(stepped.subset(np.flatnonzero(better)), snapped[better])
    model.solve(arm, inputs.with_loads(inputs.loads + shift))
    return shift


def distance_to_targets(model: ForwardModel, measured: Array) -> Array:
    """Return the rms distance (frames,) m of targets from the model; inf where unsolved."""
    squares = (measured - model.points) ** 2
    seen = np.isfinite(squares)
    mean = np.sum(np.where(seen, squares, 0.0), axis=(1, 2)) / np.maximum(seen.sum((1, 2)), 1)
    return np.where(model.solved, np.sqrt(mean), np.inf)


def linear_errors(
    model: ForwardModel,
    arm: Arm,
    run: RecordingData,
    inputs: Inputs,
    shift: Array,
    disturbance: Array,
    noise: SensorNoise,
) -> Array:
    """Return the most probable errors of the load, (frames, 3) sigma, linearized at a shift.

    Pressure noise is neglected, since the result only serves as the next linearization point.
    model: solved at that shift.
    """
    by_load = model.load_jacobian(arm, inputs)
    residual = (run.points - model.points - disturbance).reshape(len(shift), -1)
    residual = residual + np.matmul(by_load, shift[:, :, None])[:, :, 0]
    seen = np.isfinite(residual) & np.isfinite(by_load).all(axis=2)
    columns = by_load * attached_std(noise, run)[:, None]
    columns = np.where(seen[:, :, None], columns, 0.0) / noise.target_std
    residual = np.where(seen, residual, 0.0) / noise.target_std
    return probable_errors(residual, columns)[1]

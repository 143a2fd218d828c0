"""Displacement by one sigma of each reading: the common errors of y = h(x) + e, as columns.

Points are x, then y of all targets of a frame, as measured by a camera. A load of exactly zero is
not a reading and has no error: either nothing is attached in that frame, or the recording has no
measured moment. `attached_std` implements this rule.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.between_readings import (
    frames_sharing,
    interpolated_noise,
    interpolation_error,
)
from pneunet_ros.measurement.dataset import instants_among, RecordingData
from pneunet_ros.measurement.disturbances import BETWEEN_NODES, SMALLEST_STD
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs, steady_inputs
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.perturbation import neighbors
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import LOADS

PRESSURE_STEP = 20.0  # Pa, of a central difference
EDGE = 0.5  # s, invented: more than the delay of most cameras


def attached_std(noise: SensorNoise, run: RecordingData) -> Array:
    """Return one sigma of F1, F2 (N) and M (N m) as read in every frame, (frames, 3).

    A frame within `EDGE` of a reading has the error of that reading, because the delay is unknown.
    The interpolation error between two readings is included.
    """
    attached = np.any(run.load != 0.0, axis=1)
    if run.wrench_stamp_ns is not None and run.wrench is not None and not run.static:
        loaded_stamps = run.wrench_stamp_ns[np.any(run.wrench != 0.0, axis=1)]
        edge = round(EDGE * NANOSECONDS_PER_SECOND)
        first = np.searchsorted(loaded_stamps, run.stamp_ns - edge, side='left')
        attached |= np.searchsorted(loaded_stamps, run.stamp_ns + edge, side='right') > first
    moment_std = noise.moment_std if np.any(run.moment != 0.0) else 0.0
    stds = np.array([noise.force_std, noise.force_std, moment_std])
    return np.asarray(np.hypot(attached[:, None] * stds, missed_load(run, stds)))


def missed_load(run: RecordingData, stds: Array) -> Array:
    """Return one sigma of the interpolation error of the load, (frames, 3).

    stds (3,) of F1, F2 (N) and M (N m) as read.
    """
    if run.wrench_stamp_ns is None or run.wrench is None or run.static or run.load_known:
        return np.zeros((len(run.stamp_ns), LOADS))
    shown = instants_among(run.stamp_ns, run.wrench_stamp_ns)
    return interpolation_error(shown, run.wrench_stamp_ns, run.wrench, stds)


def target_std(noise: SensorNoise) -> float:
    """Return one sigma (m) of a single target: white noise and placement."""
    return float(target_stds(noise, np.array(noise.target_std)))


def target_stds(noise: SensorNoise, white: Array) -> Array:
    """Return one sigma (m) of targets with this white noise, including placement."""
    return np.maximum(np.hypot(white, noise.placement_std), SMALLEST_STD)


def measured_tip_std(noise: SensorNoise) -> float:
    """Return one sigma (m) of x, and of y, of a tip that the camera measured as a target."""
    return math.hypot(target_std(noise), noise.registration_std, noise.drift_std)


def camera_errors(std: float, targets: int) -> Array:
    """Return the displacement by a camera offset of std (m) in x and in y, (2 targets, 2) m."""
    displacement = np.zeros((2, targets, 2))
    displacement[0, :, 0] = displacement[1, :, 1] = std
    return displacement.reshape(2 * targets, 2)


def reading_errors(
    noise: SensorNoise,
    model: ForwardModel,
    arm: Arm,
    run: RecordingData,
    inputs: Inputs,
    jacobian: Array,
) -> Array:
    """Return the displacement by one sigma of each reading, (frames, 2 targets, errors) m.

    model: solved there; jacobian (frames, 2 targets, >= 3 + knots) as from
    `ForwardModel.point_jacobian`, with an additional row for a heading, which the camera does not
    move. The last two columns are the camera errors between the nodes of its path. A known load
    has the same error in every frame and is one of the `Disturbances` instead. Frames are treated
    as if each had its own readings. If n frames share readings, their errors are multiplied by
    sqrt(n), so that together they carry the information of the shared readings only once.
    """
    moves = pressure_moves(model, arm, run, inputs, jacobian)
    pressure = pressure_std(noise, arm, run) * np.sqrt(frames_of_pressure(arm, run))
    pressure = (pressure[:, None] * moves)[:, :, None]
    camera = camera_errors(noise.drift_std * BETWEEN_NODES, run.x.shape[1])
    camera = np.pad(camera, ((0, jacobian.shape[1] - len(camera)), (0, 0)))
    camera = np.broadcast_to(camera, (*jacobian.shape[:2], 2))
    if not run.loaded or run.load_known:
        return np.concatenate([pressure, camera], axis=2)
    shared = np.sqrt(frames_of_wrench(run))
    loads = jacobian[:, :, :LOADS] * (attached_std(noise, run) * shared[:, None])[:, None]
    return np.concatenate([pressure, loads, camera], axis=2)


def frames_of_pressure(arm: Arm, run: RecordingData) -> Array:
    """Return how many frames share the pressure readings of each frame, (frames,)."""
    if run.static or not run.pressurized:
        return np.ones(len(run.stamp_ns))
    return frames_sharing(shown_instants(arm, run), run.reading_stamp_ns)


def frames_of_wrench(run: RecordingData) -> Array:
    """Return how many frames share the load readings of each frame, (frames,)."""
    if run.static or run.wrench_stamp_ns is None:
        return np.ones(len(run.stamp_ns))
    return frames_sharing(instants_among(run.stamp_ns, run.wrench_stamp_ns), run.wrench_stamp_ns)


def shown_instants(arm: Arm, run: RecordingData) -> Stamps:
    """Return the times at which frames were taken, on the clock of the pressure, (frames,) ns."""
    return run.instants - round(arm.frame_delay * NANOSECONDS_PER_SECOND)


def pressure_std(noise: SensorNoise, arm: Arm, run: RecordingData) -> Array:
    """Return one sigma (Pa) of the pressure in every frame, (frames,).

    Includes the noise of a reading and the interpolation error.
    """
    missed = missed_pressure(noise, arm, run)
    return np.asarray(np.hypot(noise.pressure_std, missed))


def missed_pressure(noise: SensorNoise, arm: Arm, run: RecordingData) -> Array:
    """Return one sigma (Pa) of the interpolation error of the pressure, (frames,).

    Zero in static frames, and for a camera triggered together with the readings.
    """
    if run.static:
        return np.zeros(len(run.stamp_ns))
    shown = shown_instants(arm, run)
    return interpolation_error(shown, run.reading_stamp_ns, run.pressure, noise.pressure_std)


def pressure_moves(
    model: ForwardModel, arm: Arm, run: RecordingData, inputs: Inputs, jacobian: Array
) -> Array:
    """Return the displacement per pascal of a reading, (frames, coordinates) m.

    Computed from the table of kappa_p0, or by central differences if effects depend on the
    pressure or change a wrench with it. With the table alone, a pressure-dependent effect could
    replace the table and so evade the pressure noise.
    """
    slope = arm.intrinsic_curvature.slope(inputs.pressure)
    knots = jacobian[:, :, LOADS : LOADS + slope.shape[1]]
    by_table: Array = np.matmul(knots, slope[:, :, None])[:, :, 0]
    if not arm.effects:
        return by_table
    shifted_runs = [
        replace(run, pressure=run.pressure + side * PRESSURE_STEP) if arm.sensing else run
        for side in (-1.0, 1.0)
    ]
    below, above = (steady_inputs(arm, item).loads for item in shifted_runs)
    sides = [
        replace(
            inputs,
            pressure=inputs.pressure + side * PRESSURE_STEP,
            loads=inputs.loads + side * 0.5 * (above - below),
        )
        for side in (-1.0, 1.0)
    ]
    if np.array_equal(below, above) and not arm.effects_follow_pressure(
        inputs.pressure, PRESSURE_STEP, inputs.histories, inputs.loads
    ):
        return by_table
    displacement = model.difference(arm, *sides) / (2.0 * PRESSURE_STEP)
    displacement = displacement[:, : by_table.shape[1]]
    return np.asarray(np.where(np.isfinite(displacement), displacement, by_table))


def model_errors(arm: Arm, inputs: Inputs) -> Array:
    """Return the displacement by one sigma of pressure and of each column of the covariance.

    (frames, 2 targets, 1 + columns) m, by central differences of the whole model; zero, not NaN,
    where a neighbor has no equilibrium.
    """
    errors = [pressure_error(arm, inputs, arm.sensors.pressure_std)]
    for column in () if arm.covariance is None else arm.covariance.columns():
        before, after, distance = neighbors(arm, column)
        errors.append((solved_points(after, inputs) - solved_points(before, inputs)) / distance)
    stacked = np.stack([error.reshape(len(inputs.pressure), -1) for error in errors], axis=2)
    return np.where(np.isfinite(stacked), stacked, 0.0)


def pressure_error(arm: Arm, inputs: Inputs, std: float) -> Array:
    """Return the displacement by one sigma (Pa) of pressure, (frames, 2, targets) m.

    Central difference of the whole model; NaN where a neighbor has no equilibrium.
    """
    below, above = (
        solved_points(arm, replace(inputs, pressure=inputs.pressure + sign * PRESSURE_STEP))
        for sign in (-1.0, 1.0)
    )
    return std * (above - below) / (2.0 * PRESSURE_STEP)


def solved_points(arm: Arm, inputs: Inputs) -> Array:
    """Return the targets (frames, 2, targets) m, NaN in frames without an equilibrium."""
    model = ForwardModel(arm.target_arclength)
    solved = model.solve(arm, inputs)
    return np.where(solved[:, None, None], model.points, np.nan)


def coordinate_stds(arm: Arm, run: RecordingData, inputs: Inputs, noise: SensorNoise) -> Array:
    """Return one sigma (m) of every measured coordinate, (frames, 2, targets).

    Includes white noise, placement, and the interpolated noise of force and pressure readings; NaN
    where a target was not seen or a frame has no equilibrium. A known load has no noise; its error
    is the same in every frame. Do not use it for a fit: an error of a reading moves all targets of
    a frame together. For a fit use `reading_errors`, which also allows for a delayed load and for
    noise that is not white.
    """
    model = ForwardModel(arm.target_arclength)
    seen = run.seen & model.solve(arm, inputs)[:, None]
    loads = attached_std(noise, replace(run, wrench_stamp_ns=None, wrench=None))
    if run.load_known:
        loads = np.zeros_like(loads)
    pressure_stds = np.full(len(run.stamp_ns), noise.pressure_std)
    if not run.static:
        pressure_stds *= interpolated_noise(run.instants, run.reading_stamp_ns)
    pressure_stds = np.hypot(pressure_stds, missed_pressure(noise, arm, run))
    pressure = pressure_stds[:, None, None] * pressure_error(arm, inputs, 1.0)
    if run.wrench_stamp_ns is not None and not (run.static or run.load_known):
        shown = instants_among(run.stamp_ns, run.wrench_stamp_ns)
        stds = np.array([noise.force_std, noise.force_std, noise.moment_std])
        loads = loads * interpolated_noise(shown, run.wrench_stamp_ns)[:, None]
        loads = np.hypot(loads, missed_load(run, stds))
    by_load = model.load_jacobian(arm, inputs) * loads[:, None]
    variance = np.sum(by_load**2, axis=2).reshape(run.points.shape)
    variance += pressure**2 + target_std(noise) ** 2
    return np.sqrt(np.where(seen[:, None], variance, np.nan))

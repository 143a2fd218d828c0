"""Linearization of one recording around a model: residuals, Jacobian, covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.disturbances import (
    camera_path,
    disturbance_jacobian,
    inputs_with_load_error,
    painted_points,
)
from pneunet_ros.measurement.errors.covariance import Whitening
from pneunet_ros.measurement.errors.noise_model import reading_errors
from pneunet_ros.measurement.forward_model import as_points, Columns, ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.painted_targets import in_plane, PaintedTargets
from pneunet_ros.measurement.probable_load import probable_load_errors
from pneunet_ros.measurement.tip_pose import heading_residual
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import CURVATURE, LOADS, THETA, X, Y


class Parametrization(Protocol):
    """The unknown parameters of an arm as one vector."""

    @property
    def columns(self) -> Columns:
        """Columns of the rod's sections that depend on the parameters, (k, 2)."""

    def arm(self, values: Array) -> Arm:
        """Return the arm with these values; ModelError if they are invalid."""

    def input_jacobian(self, values: Array, inputs: Inputs) -> Array:
        """Return derivatives of the inputs of the `jacobian`, (frames, inputs, parameters)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedRun:
    """A run with the predictions of the fitted model.

    points (frames, 2, targets) m: prediction of the model alone; disturbance (frames, 2, targets)
    m: contribution of placement and camera; fields (frames, 6, targets) as from
    `solver.interpolation.at_stations`; whitened (frames,): the squared whitened residual; dof
    (frames,): the number of its coordinates. Frames without an equilibrium (`solved` False) do not
    count. Coordinates are x, then y of all targets, then the heading of the last target, the tip,
    in a run that has it.
    """

    run: RecordingData
    inputs: Inputs
    fields: Array
    points: Array
    disturbance: Array
    whitened: Array
    dof: Array
    solved: npt.NDArray[np.bool_]

    @property
    def residual(self) -> Array:
        """Measured minus predicted targets including disturbances, (frames, 2, targets) m."""
        return self.run.points - self.points - self.disturbance

    @property
    def counted(self) -> npt.NDArray[np.bool_]:
        """Coordinates in use, (frames, coordinates): targets seen in frames with a solution."""
        parts = [self.run.seen, self.run.seen]
        if self.run.heading is not None:
            parts.append(np.isfinite(self.run.heading)[:, None])
        return np.concatenate(parts, axis=1) & self.solved[:, None]

    def counting(self, solved: npt.NDArray[np.bool_]) -> FittedRun:
        """Return the run restricted to these frames (a mask)."""
        run = replace(self, solved=solved)
        return replace(run, dof=np.count_nonzero(run.counted, axis=1))

    def whiten_residual(self, whitening: Whitening, tangent: Array) -> Array:
        """Return the whitened residual (frames, coordinates); tangent as in `RunLinearization`."""
        residual = self.residual.reshape(len(self.solved), -1)
        if self.run.heading is not None:
            heading = heading_residual(self.run.heading, self.fields[:, THETA, -1])
            residual = np.column_stack([residual, heading])
        return whitening((residual + tangent)[:, :, None])[:, :, 0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RunLinearization:
    """Linearization of one recording at one point: y = h(x) + e.

    fitted: linearized at the measured load. Everything else is linearized at the most probable
    load: load_error (frames, 3) N, N m is its difference from the measured load, and tangent
    (frames, coordinates) the resulting change of the measured coordinates. fields (frames, 6,
    targets) as in `FittedRun`; jacobian (frames, coordinates, parameters + disturbances of the
    run); errors (frames, coordinates, n): displacement by one sigma of each reading;
    white_residual (frames, coordinates); whitening by the noise of targets and readings.
    """

    fitted: FittedRun
    fields: Array
    load_error: Array
    tangent: Array
    jacobian: Array
    errors: Array
    white_residual: Array
    whitening: Whitening

    def residual_of(
        self, model: ForwardModel, arm: Arm, inputs: Inputs, disturbance: Array
    ) -> Array:
        """Return the whitened residual of another arm and disturbance (n,), around this point."""
        inputs = inputs.with_loads(inputs.loads + self.load_error)
        other, _ = predict(model, arm, self.fitted.run, inputs, disturbance)
        return other.whiten_residual(self.whitening, self.tangent)


def predict(
    model: ForwardModel, arm: Arm, run: RecordingData, inputs: Inputs, disturbance: Array
) -> tuple[FittedRun, PaintedTargets]:
    """Return the unwhitened predictions of an arm for a run, and the painted positions.

    disturbance (n,): the unknowns of `of_run`. model: start of the search for equilibria; it is
    updated with the solutions.
    """
    solved = model.solve(arm, inputs_with_load_error(run, inputs, disturbance)).copy()
    fields = model.fields.copy()
    targets = painted_points(fields[:, THETA], fields[:, CURVATURE], disturbance)
    fitted = FittedRun(
        run=run,
        inputs=inputs,
        fields=fields,
        points=model.points.copy(),
        disturbance=in_plane(targets.displacement) + camera_path(run, disturbance),
        whitened=np.zeros(len(solved)),
        dof=np.zeros(len(solved), dtype=np.int64),
        solved=solved,
    )
    return fitted.counting(solved), targets


def at_painted_targets(fields: Array, targets: PaintedTargets) -> Array:
    """Return derivatives of fields (frames, inputs, 6, targets) at painted targets."""
    theta, curvature = fields[:, :, THETA], fields[:, :, CURVATURE]
    displacement = targets.by_theta[:, None] * theta + targets.by_curvature[:, None] * curvature
    fields[:, :, X] += displacement.real
    fields[:, :, Y] += displacement.imag
    return fields


def parameter_jacobian(
    parameters: Parametrization, values: Array, by_input: Array, inputs: Inputs
) -> Array:
    """Return derivatives of points (frames, 2 targets) by parameters; by_input: by rod inputs."""
    return np.asarray(np.matmul(by_input, parameters.input_jacobian(values, inputs)))


def linearize(
    model: ForwardModel,
    parameters: Parametrization,
    values: Array,
    disturbance: Array,
    run: RecordingData,
    inputs: Inputs,
    noise: SensorNoise,
) -> RunLinearization:
    """Return a recording linearized at values (n,) of parameters and its disturbance (m,).

    inputs: those of the arm with these values. model: start of the search for equilibria.
    ModelError if there is no such arm.
    """
    arm = parameters.arm(values)
    fitted, targets = predict(model, arm, run, inputs, disturbance)
    load_error = probable_load_errors(model, arm, run, inputs, fitted.disturbance, noise)
    probable = fitted
    if load_error.any():
        inputs = inputs.with_loads(inputs.loads + load_error)
        probable, targets = predict(model, arm, run, inputs, disturbance)
        solved = fitted.solved & probable.solved
        fitted, probable = fitted.counting(solved), probable.counting(solved)
    inputs = inputs_with_load_error(run, inputs, disturbance)
    fields = model.jacobian(arm, inputs, parameters.columns)
    by_input = as_points(at_painted_targets(fields, targets))
    moving = disturbance_jacobian(run, targets).reshape(*by_input.shape[:2], -1)
    std: float | Array = noise.target_std
    if run.heading is not None:  # an offset of the camera does not rotate the tip
        by_input = np.concatenate([by_input, fields[:, None, :, THETA, -1]], axis=1)
        moving = np.pad(moving, ((0, 0), (0, 1), (0, 0)))
        std = np.append(np.full(by_input.shape[1] - 1, noise.target_std), noise.heading_std)
    if run.load_known:
        moving[:, :, -LOADS:] = by_input[:, :, :LOADS]
    errors = reading_errors(noise, model, arm, run, inputs, by_input)
    tangent = np.matmul(by_input[:, :, :LOADS], load_error[:, :, None])[:, :, 0]
    whitening = Whitening(std, errors, probable.counted)
    jacobian = parameter_jacobian(parameters, values, by_input, inputs)
    white = probable.whiten_residual(whitening, tangent)
    return RunLinearization(
        fitted=replace(fitted, whitened=np.sum(white**2, axis=1)),
        fields=probable.fields,
        load_error=load_error,
        tangent=tangent,
        jacobian=np.concatenate([jacobian, moving], axis=2),
        errors=errors,
        white_residual=white,
        whitening=whitening,
    )

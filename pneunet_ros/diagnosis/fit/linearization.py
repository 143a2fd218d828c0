"""Recordings linearized around a fit: derivatives of whitened points.

The camera's path and the errors of readings are marginalized run by run. The remaining unknowns,
each scaled to a normal prior with unit variance, are the base model, the placement of the targets,
a field of negligible departures that every model has, and the tilt of a camera that is not exactly
parallel to the plane of the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pneunet_ros.calibration.map_estimation import NONE, ScaledPrior
from pneunet_ros.calibration.parameters import Parameters
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.diagnosis.fit.generic_field import Fields, fields_of, Regressors
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.effects.effect import Effect
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.disturbances import PATH_NODES, tilt_jacobian
from pneunet_ros.measurement.errors.covariance import Whitening
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.gauss_newton import Bounds
from pneunet_ros.measurement.inputs import Inputs, inputs_at_instants
from pneunet_ros.measurement.linearization import linearize, RunLinearization
from pneunet_ros.measurement.painted_targets import in_plane, paint
from pneunet_ros.measurement.reading_filter import filter_readings
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import CURVATURE, THETA, X, Y

MOST_LOST = 0.02  # share of the frames that may have no equilibrium


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearizedRun:
    """One run: whitened columns, and its additional whitening.

    base (rows, n): model and placement, scaled; path (rows, k): the camera's, which `path_filter`
    integrates out of whitened columns (rows, n); placed (frames, 2, targets) m: the part of the
    placement that `base` subtracts; fields: generic ones, and tilt: response of points to a tilt
    of the image, neither whitened. model: start of searches for equilibria. linear: the
    linearization without its Jacobian and errors, which are large.
    """

    linear: RunLinearization
    model: ForwardModel
    path_filter: Whitening
    base: Array
    path: Array
    placed: Array
    fields: Fields
    tilt: Array

    @property
    def run(self) -> RecordingData:
        """The recording."""
        return self.linear.fitted.run

    @property
    def log_volume(self) -> float:
        """Log of sqrt(det C / det D) of the errors used to whiten a run; see `Whitening`."""
        return self.linear.whitening.log_volume + self.path_filter.log_volume

    @property
    def inputs(self) -> Inputs:
        """The inputs of the arm, as read."""
        return self.linear.fitted.inputs

    def white(self, columns: Array) -> Array:
        """Whiten columns (frames, 2 targets, n) m, (rows, n)."""
        return self.path_filter(self.linear.whitening(columns).reshape(-1, columns.shape[2]))

    def white_by_frame(self, columns: Array) -> Array:
        """Whiten columns (frames, 2 targets, n) m frame by frame, (rows, frames n)."""
        frames, coordinates, count = columns.shape
        alone = np.zeros((frames, coordinates, frames, count))
        which = np.arange(frames)
        alone[which, :, which] = self.linear.whitening(columns)
        return self.path_filter(alone.reshape(frames * coordinates, frames * count))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearizationPoint:
    """Point of linearization: values of the base model's unknowns, placement, effects.

    placement (2, targets) m; effects are added to those of the model. origin (2,) m: offset of the
    base frame of all recordings from the neutral line, from the base fit.
    """

    parameters: Parameters
    values: Array
    placement: Array
    effects: tuple[Effect, ...] = ()
    origin: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def arm(self) -> Arm:
        """The arm at this point."""
        return self.with_effects().arm(self.values)

    def with_effects(self) -> Parameters:
        """Return the unknowns of an arm that also has these effects."""
        frame = self.parameters.frame
        return replace(
            self.parameters, frame=replace(frame, effects=(*frame.effects, *self.effects))
        )


class KnownInputs:
    """Inputs of arms in runs, cached per set of sensing and actuation effects.

    The last `alternatives` runs are alternatives: each follows all the other runs.
    """

    def __init__(
        self, runs: Sequence[RecordingData], noise: SensorNoise, alternatives: int = 0
    ) -> None:
        self.common = len(runs) - alternatives
        self.filtered = [filter_readings(run, noise) for run in runs]
        self.known: dict[tuple[Effect, ...], list[Inputs]] = {}
        self.shown: dict[float, list[RecordingData]] = {}

    def of(self, arm: Arm) -> list[Inputs]:
        """Return the inputs of an arm in all runs; reading noise does not enter the history."""
        in_time = [item for item in arm.effects if item.frame_delay]
        key = tuple(item for item in arm.effects if item in (*arm.sensing, *arm.acting, *in_time))
        if key not in self.known:
            runs = self.at_instants(arm.frame_delay)
            before, alternatives = runs[: self.common], runs[self.common :]
            all_inputs = [
                *inputs_at_instants(arm, before),
                *(inputs_at_instants(arm, [*before, run])[-1] for run in alternatives),
            ]
            self.known[key] = [
                replace(inputs, pressure=inputs.pressure + item.noise)
                for inputs, item in zip(all_inputs, self.filtered, strict=True)
            ]
        return self.known[key]

    def at_instants(self, delay: float) -> list[RecordingData]:
        """Return all runs with readings taken a delay (s) before each frame."""
        if delay not in self.shown:
            self.shown[delay] = [item.run.at_instants(delay) for item in self.filtered]
        return self.shown[delay]


class Linearization:
    """All linearized runs; the first `training` of them are fitted."""

    def __init__(
        self,
        point: LinearizationPoint,
        runs: Sequence[RecordingData],
        training: int,
        noise: SensorNoise,
        known_inputs: KnownInputs | None = None,
    ) -> None:
        self.point, self.runs, self.training, self.noise = point, tuple(runs), training, noise
        # The inputs do not depend on the base model: one table for all points.
        self.known_inputs = known_inputs or KnownInputs(self.runs, noise)
        parameters = point.with_effects()
        arm = parameters.arm(point.values)
        self.length = arm.length
        prior = ScaledPrior(parameters, self.runs, noise, arm.target_arclength)
        self.size, shared = prior.size, prior.shared
        values = np.concatenate([point.values, point.placement.ravel()])
        self.scale, self.mean = prior.scale[:shared, :shared], prior.mean[:shared]
        self.position = np.linalg.solve(self.scale, values - self.mean)
        all_inputs = self.known_inputs.of(arm)
        regressors = Regressors.of(arm, self.runs, all_inputs)
        self.blocks = [
            self.block(prior, which, arm, inputs, regressors)
            for which, inputs in enumerate(all_inputs)
        ]
        self.tolerance = self.tolerances()
        self.fixed = [
            np.concatenate(
                [
                    block.base,
                    block.white(block.fields.generic * self.tolerance),
                    block.white(block.tilt * LINEARIZATION.tilt),
                ],
                axis=1,
            )
            for block in self.blocks
        ]
        self.grams = [item.T @ item for item in self.fixed]

    def at(
        self, point: LinearizationPoint, runs: Sequence[RecordingData] | None = None
    ) -> Linearization:
        """Return the linearization of the same or other runs around another point."""
        known = self.known_inputs if runs is None else None
        runs = runs or self.runs
        return Linearization(point, runs, self.training, self.noise, known)

    def of_training(self) -> Linearization:
        """Return only the training runs, linearized at the same point."""
        return self.at(self.point, self.runs[: self.training])

    def block(
        self, prior: ScaledPrior, which: int, arm: Arm, inputs: Inputs, regressors: Regressors
    ) -> LinearizedRun:
        """Linearize one run, its camera at rest."""
        point, run, size, shared = self.point, self.runs[which], prior.size, prior.shared
        own = size + prior.disturbances.of_run(which)
        disturbance = np.zeros(own.size)
        disturbance[: shared - size] = point.placement.ravel()
        disturbance[shared - size :][: 2 * PATH_NODES] = np.repeat(point.origin, PATH_NODES)
        model = ForwardModel(arm.target_arclength, run.points)
        linear = linearize(
            model, point.with_effects(), point.values, disturbance, run, inputs, self.noise
        )
        linear_placement = linear.jacobian[:, :, size:shared] @ disturbance[: shared - size]
        white = linear.whitening(linear.jacobian).reshape(-1, linear.jacobian.shape[2])
        base = white[:, :shared] @ self.scale
        path = white[:, shared:] @ prior.disturbances.root_of_run(which)
        path_filter = Whitening(1.0, path)
        parameters = point.parameters
        knots = linear.jacobian[:, :, : parameters.cells]
        knots = knots.reshape(*knots.shape[:2], parameters.pressure.size, -1).sum(axis=2)
        return LinearizedRun(
            linear=replace(linear, jacobian=NONE, errors=NONE),
            model=model,
            path_filter=path_filter,
            base=path_filter(base),
            path=path,
            placed=linear_placement.reshape(run.points.shape),
            fields=fields_of(regressors, which, knots, linear.fitted.fields[:, THETA]),
            tilt=tilt_jacobian(linear.fitted.fields[:, [X, Y]], arm.length),
        )

    def tolerances(self) -> Array:
        """Return the negligible size of every generic field, (fields,).

        Together, the fields move the points by `LinearizationSettings.tolerance` of the length
        (root mean square) in frames with a shape.
        """
        fields = [block.fields.generic for block in self.blocks]
        squares = sum(np.nansum(field**2, axis=(0, 1)) for field in fields)
        rows = sum(field.shape[0] * field.shape[1] for field in fields)
        rms = np.sqrt(np.asarray(squares) / rows)
        seen = max(int(np.count_nonzero(rms)), 1)
        tolerance = LINEARIZATION.tolerance * self.length / np.sqrt(seen)
        return np.where(rms > 0.0, tolerance / np.maximum(rms, 1e-300), 0.0)

    def bounds(self, base: Array, unknowns: int) -> Bounds:
        """Return the bounds of a step of this many unknowns, the first ones scaled."""
        size = self.size
        rows = np.zeros((size, unknowns))
        rows[:, :size] = self.scale[:size, :size]
        values = self.mean[:size] + rows[:, :size] @ base[:size]
        return Bounds.of(rows, values, self.point.parameters.limits)

    def residual(
        self, values: Array, effects: Sequence[Effect], which: range
    ) -> list[Array] | None:
        """Return the whitened residuals (rows,) of runs for a model; None if there is no solution.

        Placement and departures are not subtracted; effects are added to those of the model.
        """
        try:
            arm = replace(self.point, values=values, effects=tuple(effects)).arm
            points = self.points(arm, which)
        except ModelError:  # a rigidity crosses zero
            return None
        if points is None:
            return None
        out = []
        for place, predicted in zip(which, points, strict=True):
            block = self.blocks[place]
            residual = (block.run.points - predicted).reshape(
                len(predicted), -1
            ) + block.linear.tangent
            out.append(block.white(residual[:, :, None])[:, 0])
        return out

    def points(self, arm: Arm, which: range) -> list[Array] | None:
        """Return predicted points (frames, 2, targets) m of an arm; None if there is no solution.

        Under the loads of the linearization; only the nonlinear part of the placement is included.
        """
        out = []
        all_inputs = self.known_inputs.of(arm)
        for place in which:
            block, inputs = self.blocks[place], all_inputs[place]
            inputs = inputs.with_loads(inputs.loads + block.linear.load_error)
            solved = block.model.solve(arm, inputs)
            lost = block.linear.fitted.counted.any(axis=1) & ~solved
            if lost.mean() > MOST_LOST:
                return None
            # A frame without an equilibrium carries no information: the residual is zero.
            as_seen = block.run.points + block.linear.tangent.reshape(block.run.points.shape)
            fields = block.model.fields
            beside = paint(
                fields[:, THETA], fields[:, CURVATURE], self.point.placement
            ).displacement
            points = block.model.points + in_plane(beside) + self.point.origin[:, None]
            out.append(np.where(lost[:, None, None], as_seen, points) - block.placed)
        return out

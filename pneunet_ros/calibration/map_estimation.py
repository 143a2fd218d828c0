"""The most probable model given recordings, and how sure that is: Gauss-Newton on target points.

What is fitted are the points, not differentiated curvature. Unknowns of the model, disturbances
of the measurement and the errors of pressure and force readings have Gaussian priors; readings are
integrated out frame by frame, the rest is solved for. All unknowns are scaled to their prior, so
that it is the unit matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.parameters import Parameters
from pneunet_ros.calibration.result import Fit, FittedRun
from pneunet_ros.core.arrays import Array, frozen_array, pressure_rows
from pneunet_ros.core.errors import ModelError
from pneunet_ros.measurement.covariance import Whitening
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.disturbances import Disturbances, PATH_NODES
from pneunet_ros.measurement.forward_model import ForwardModel, THETA
from pneunet_ros.measurement.inputs import Inputs, inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
from scipy.linalg import block_diag, cho_factor, cho_solve

MOST_STEPS = 25
SMALL_STEP = 0.05  # standard deviations of all that is fitted, together
NEARLY = 10.0  # as many left where the model cannot explain the recordings: still a model
MOST_HALVINGS = 8
# of drift_std: a random walk between its nodes on a straight line, per frame
BETWEEN_NODES = 1.0 / np.sqrt(6.0 * (PATH_NODES - 1))


class Posterior:
    """Cost and normal equations of the unknowns, over all runs."""

    def __init__(
        self,
        parameters: Parameters,
        runs: Sequence[RecordingData],
        noise: SensorNoise,
        targets: Array,
    ) -> None:
        self.parameters, self.runs, self.noise = parameters, tuple(runs), noise
        self.disturbances = Disturbances(targets=targets.size, runs=len(runs), noise=noise)
        self.series = [ForwardModel(targets) for _ in runs]
        self.whitenings: list[Whitening | None] = [None] * len(self.runs)
        model, rest = parameters.prior, self.disturbances.prior
        self.size = model.shape[0]
        prior = block_diag(model, rest)
        self.mean = np.concatenate([parameters.mean, np.zeros(rest.shape[0])])
        if parameters.known is not None:
            known = parameters.known
            placement = self.size + np.arange(known.placement.size)
            both = np.concatenate([np.arange(known.values.size), placement])
            prior[np.ix_(both, both)] = known.covariance
            self.mean[placement] = known.placement
        self.scale = np.linalg.cholesky(prior)

    def unscaled(self, scaled: Array) -> tuple[Array, Array]:
        """Return unknowns of the model and disturbances (m) of scaled ones."""
        values = self.mean + self.scale @ scaled
        return values[: self.size], values[self.size :]

    def cost(self, scaled: Array) -> float:
        """Half the squared norm of all that is whitened, by the whitening of `linearized`."""
        values, disturbance = self.unscaled(scaled)
        arm = self.parameters.arm(values)
        cost = 0.5 * float(scaled @ scaled)
        for which, inputs in enumerate(inputs_of(arm, self.runs)):
            fitted, _ = self.one(which, arm, inputs, disturbance)
            cost += 0.5 * float(fitted.whitened.sum())
        return cost

    def linearized(self, scaled: Array) -> tuple[float, tuple[FittedRun, ...], Array, Array]:
        """Return cost, runs, normal matrix and gradient at these unknowns, all scaled."""
        values, disturbance = self.unscaled(scaled)
        arm = self.parameters.arm(values)
        size = scaled.size
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        cost, runs = 0.5 * float(scaled @ scaled), []
        for which, inputs in enumerate(inputs_of(arm, self.runs)):
            self.whitenings[which] = None
            fitted, beside = self.one(which, arm, inputs, disturbance)
            jacobian = self.jacobian(which, fitted, arm, values, beside)
            whitening = self.whitenings[which]
            assert whitening is not None
            own = self.size + self.disturbances.of_run(which)
            places = np.concatenate([np.arange(self.size), own])
            residual = whitening(fitted.residual.reshape(len(beside), -1, 1))
            white = whitening(jacobian).reshape(-1, places.size)
            normal[np.ix_(places, places)] += white.T @ white
            gradient[places] += white.T @ residual.ravel()
            fitted = replace(fitted, whitened=np.sum(residual**2, axis=(1, 2)))
            cost += 0.5 * float(fitted.whitened.sum())
            runs.append(fitted)
        normal = self.scale.T @ normal @ self.scale
        return cost, tuple(runs), normal, self.scale.T @ gradient

    def one(
        self, which: int, arm: Arm, inputs: Inputs, disturbance: Array
    ) -> tuple[FittedRun, Array]:
        """Return a run beside the model, and how its points answer to disturbances."""
        series, run = self.series[which], self.runs[which]
        solved = series.solve(arm, inputs).copy()
        fields = series.fields.copy()
        own = self.disturbances.of_run(which)
        beside = self.disturbances.jacobian(run, fields[:, THETA])
        moved = beside @ disturbance[own]
        seen = run.seen & solved[:, None]
        whitening, whitened = self.whitenings[which], np.zeros(len(seen))
        if whitening is not None:
            residual = np.stack([run.x, run.y], axis=1) - series.points - moved
            whitened = np.sum(whitening(residual.reshape(len(seen), -1, 1)) ** 2, axis=(1, 2))
        fitted = FittedRun(
            run=run,
            inputs=inputs,
            fields=fields,
            points=series.points.copy(),
            disturbance=moved,
            whitened=whitened,
            dof=2 * seen.sum(axis=1),
            solved=solved,
        )
        return fitted, beside

    def jacobian(
        self, which: int, fitted: FittedRun, arm: Arm, values: Array, beside: Array
    ) -> Array:
        """How points (frames, 2 targets) answer to unknowns and disturbances; sets whitening."""
        inputs, run = fitted.inputs, fitted.run
        columns = self.parameters.columns
        answer = self.series[which].answer(arm, inputs, columns)
        frames, causes = answer.shape[:2]
        points = answer[:, :, :2].reshape(frames, causes, -1)
        seen = run.seen & fitted.solved[:, None]
        mask = np.repeat(seen[:, None], 2, axis=1).reshape(frames, -1)
        sensed = self.sensed(points, values, inputs, run)
        self.whitenings[which] = Whitening(self.noise.target_std, sensed, mask)
        model = np.matmul(points.transpose(0, 2, 1), self.parameters.causes(values, inputs))
        return np.concatenate([model, beside.reshape(frames, mask.shape[1], -1)], axis=2)

    def sensed(self, points: Array, values: Array, inputs: Inputs, run: RecordingData) -> Array:
        """Return what one sigma of each reading moves, (frames, 2 targets, readings).

        points (frames, causes, 2 targets) are the answers. Two more columns are what the camera
        moves between the nodes of its path.
        """
        parameters = self.parameters
        table = values[: parameters.cells].reshape(parameters.pressure.size, -1)
        row, _ = pressure_rows(parameters.pressure, inputs.pressure)
        step = np.diff(parameters.pressure)[:, None]
        slope = (np.diff(table, axis=0) / step)[row]
        knots = points[:, 3 : 3 + table.shape[1]]
        columns = [self.noise.pressure_std * np.einsum('fk,fkp->fp', slope, knots)]
        if run.loaded:
            moment_std = self.noise.moment_std if np.any(run.moment != 0.0) else 0.0
            stds = self.noise.force_std, self.noise.force_std, moment_std
            # A reading of exactly zero is no reading: nothing is attached in that frame.
            attached = np.any(run.force != 0.0, axis=1) | (run.moment != 0.0)
            points = points * attached[:, None, None]
            columns += [std * points[:, load] for load, std in enumerate(stds) if std > 0.0]
        between = np.zeros((2, *columns[0].shape))
        half = columns[0].shape[1] // 2
        between[0, :, :half] = between[1, :, half:] = self.noise.drift_std * BETWEEN_NODES
        return np.stack([*columns, *between], axis=2)


def fit(
    parameters: Parameters,
    runs: Sequence[RecordingData],
    noise: SensorNoise,
    targets: Array,
    start: Array | None = None,
    each: Callable[[int, float], None] = lambda step, cost: None,
    small: float = SMALL_STEP,
) -> Fit:
    """Find the most probable unknowns; `start`: values to begin with; `each` sees every step.

    small: standard deviations of all that is fitted, a step that ends the search.
    """
    posterior = Posterior(parameters, runs, noise, targets)
    scaled = np.zeros(posterior.scale.shape[0])
    if start is not None:
        size = posterior.size
        scaled[:size] = np.linalg.solve(posterior.scale[:size, :size], start - parameters.mean)
    last = posterior.linearized(scaled)
    status, converged, steps = 'no convergence within the allowed steps', False, 0
    for steps in range(1, MOST_STEPS + 1):
        cost, _, normal, gradient = last
        factor = cho_factor(normal + np.eye(scaled.size))
        step = cho_solve(factor, gradient - scaled)
        # Newton's decrement: the size of the step in standard deviations
        decrement = float(np.sqrt(step @ (gradient - scaled)))
        each(steps, cost)
        if decrement < small:
            status, converged = 'converged', True
            break
        share = lowering(posterior, scaled, step, cost)
        if share == 0.0:
            status = f'no step lowers the cost any more; {decrement:.2g} standard deviations left'
            converged = decrement < NEARLY
            break
        scaled = scaled + share * step
        last = posterior.linearized(scaled)
    return finished(posterior, scaled, last, steps, converged, status)


def lowering(posterior: Posterior, scaled: Array, step: Array, cost: float) -> float:
    """Return the share of a step that lowers the cost, halved until it does; 0 where none does."""
    for halvings in range(MOST_HALVINGS):
        share = 0.5**halvings
        try:
            if posterior.cost(scaled + share * step) < cost:
                return share
        except ModelError:  # no such arm: a rigidity through zero
            continue
    return 0.0


def finished(
    posterior: Posterior,
    scaled: Array,
    last: tuple[float, tuple[FittedRun, ...], Array, Array],
    steps: int,
    converged: bool,
    status: str,
) -> Fit:
    """Put the result together: covariance and information of the model's unknowns."""
    _, fitted, normal, gradient = last
    size = posterior.size
    hessian = normal + np.eye(scaled.size)
    whole = np.linalg.inv(hessian)
    scale = posterior.scale[:size, :size]
    values, disturbance = posterior.unscaled(scaled)
    shared = size + 2 * posterior.disturbances.targets  # unknowns and placement
    rows = posterior.scale[:shared]
    # Disturbances integrated out, with their prior: what the data say of the model alone.
    rest = np.linalg.inv(hessian[size:, size:])
    cross = normal[:size, size:]
    information = normal[:size, :size] - cross @ rest @ cross.T
    target = gradient + normal @ scaled
    information_vector = target[:size] - cross @ rest @ target[size:]
    unscale = np.linalg.inv(scale)
    return Fit(
        parameters=posterior.parameters,
        values=frozen_array(values),
        covariance=frozen_array(scale @ whole[:size, :size] @ scale.T),
        shared_covariance=frozen_array(rows @ whole @ rows.T),
        information=frozen_array(unscale.T @ information @ unscale),
        information_vector=frozen_array(unscale.T @ information_vector),
        placement=frozen_array(disturbance[: 2 * posterior.disturbances.targets].reshape(2, -1)),
        disturbance=frozen_array(disturbance),
        runs=fitted,
        chi_squared=float(sum(run.whitened.sum() for run in fitted)),
        dof=int(sum(run.dof.sum() for run in fitted)),
        steps=steps,
        converged=converged,
        status=status,
    )

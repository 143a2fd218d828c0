"""MAP estimation of the model by Gauss-Newton on target points.

The model is fitted to target points, not to curvature from numerical derivatives. Model
parameters, measurement disturbances and errors of pressure and force readings have Gaussian
priors; reading errors are marginalized frame by frame, all other unknowns are estimated. Unknowns
are scaled so that the prior covariance is the identity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.calibration.parameters import Parameters
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import MAP_ESTIMATION
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.disturbances import Disturbances
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.gauss_newton import Bounds, End, gauss_newton
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.measurement.linearization import linearize, RunLinearization
from pneunet_ros.model.uncertainty import SensorNoise
import scipy

MOST_STEPS = 25  # Gauss-Newton steps; a longer fit counts as not converged
MOST_HALVINGS = 8  # of a step, until the cost decreases
NEARLY = 10.0  # sigma left to gain when no step helps: still accepted; idle in acceptance/sweep.py

NONE = frozen_array(np.zeros(0))


class ScaledPrior:
    """The joint prior of parameters and disturbances: mean + scale z, z normal of unit variance.

    size: number of model parameters, which come first; placement follows, up to `shared`, and then
    the unknowns of each run: the camera's path, the error of a known load.
    """

    def __init__(
        self,
        parameters: Parameters,
        runs: Sequence[RecordingData],
        noise: SensorNoise,
        arclength: Array,
    ) -> None:
        self.disturbances = Disturbances(
            arclength=arclength, runs=runs, noise=noise, clamp_angle=parameters.frame.clamp_angle
        )
        model, rest = parameters.prior, self.disturbances.prior
        self.size = model.shape[0]
        self.shared = self.size + 2 * arclength.size
        prior = scipy.linalg.block_diag(model, rest)
        self.mean = np.concatenate([parameters.mean, np.zeros(rest.shape[0])])
        if parameters.earlier is not None:
            earlier = parameters.earlier
            placement = self.size + np.arange(earlier.placement.size)
            indices = np.concatenate([np.arange(earlier.values.size), placement])
            prior[np.ix_(indices, indices)] = earlier.covariance
            self.mean[placement] = earlier.placement
        self.scale = np.linalg.cholesky(prior)

    def unscale(self, scaled: Array) -> tuple[Array, Array]:
        """Return parameters of the model and disturbances of scaled unknowns."""
        values = self.mean + self.scale @ scaled
        return values[: self.size], values[self.size :]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearizedPosterior:
    """The posterior linearized at scaled unknowns (n,): cost, normal matrix (n, n), gradient (n,).

    Matrix and gradient are those of the data; the prior adds the identity matrix and -scaled.
    bounds: limits of a step.
    """

    scaled: Array
    cost: float
    runs: tuple[RunLinearization, ...]
    normal: Array
    gradient: Array
    bounds: Bounds

    def newton_step(self) -> tuple[Array, float]:
        """Return the full step, and the Newton decrement: its size in standard deviations."""
        factor = scipy.linalg.cho_factor(self.normal + np.eye(self.scaled.size))
        downhill = self.gradient - self.scaled
        step = scipy.linalg.cho_solve(factor, downhill)
        step, gain = self.bounds.hold(
            step,
            0.5 * float(step @ downhill),
            lambda right: np.asarray(scipy.linalg.cho_solve(factor, right)),
        )
        return step, float(np.sqrt(2.0 * max(gain, 0.0)))


class Posterior:
    """Negative log posterior over all runs, and its linearization.

    The forward models keep their equilibria as starting points. Every trial starts from the
    equilibria of the linearization, so that an arm that snaps to another equilibrium in too large
    a trial step does not stay there.
    """

    def __init__(
        self,
        parameters: Parameters,
        runs: Sequence[RecordingData],
        noise: SensorNoise,
        targets: Array,
    ) -> None:
        self.parameters, self.runs, self.noise = parameters, tuple(runs), noise
        self.prior = ScaledPrior(parameters, self.runs, noise, targets)
        self.models = [ForwardModel(targets, run.points) for run in runs]
        self.linearized: list[ForwardModel] = []

    def cost(self, scaled: Array, linearized: LinearizedPosterior) -> float:
        """Return the cost, whitened as in `linearize`; ModelError for invalid parameters."""
        values, disturbance = self.prior.unscale(scaled)
        arm = self.parameters.arm(values)
        cost = 0.5 * float(scaled @ scaled)
        for which, inputs in enumerate(inputs_of(arm, self.runs)):
            run_unknowns = disturbance[self.prior.disturbances.of_run(which)]
            every = np.arange(len(inputs.pressure))
            self.models[which].start_from(self.linearized[which], every)
            white = linearized.runs[which].residual_of(
                self.models[which], arm, inputs, run_unknowns
            )
            cost += 0.5 * float(np.sum(white**2))
        return cost

    def linearize(self, scaled: Array, *, keep_jacobians: bool = False) -> LinearizedPosterior:
        """Return the joint linearization of all runs at scaled unknowns.

        keep_jacobians: also keep the Jacobian of each frame, which needs much memory for a long
        film.
        """
        prior, size = self.prior, self.prior.size
        values, disturbance = prior.unscale(scaled)
        normal, gradient = np.zeros((scaled.size, scaled.size)), np.zeros(scaled.size)
        cost, runs = 0.5 * float(scaled @ scaled), []
        all_inputs = inputs_of(self.parameters.arm(values), self.runs)
        for which, (run, inputs) in enumerate(zip(self.runs, all_inputs, strict=True)):
            run_unknowns = prior.disturbances.of_run(which)
            linear = linearize(
                self.models[which],
                self.parameters,
                values,
                disturbance[run_unknowns],
                run,
                inputs,
                self.noise,
            )
            places = np.concatenate([np.arange(size), size + run_unknowns])
            white = linear.whitening(linear.jacobian).reshape(-1, places.size)
            normal[np.ix_(places, places)] += white.T @ white
            gradient[places] += white.T @ linear.white_residual.ravel()
            cost += 0.5 * float(linear.fitted.whitened.sum())
            runs.append(linear if keep_jacobians else replace(linear, jacobian=NONE, errors=NONE))
        self.linearized = [
            model.subset(np.arange(len(run.x)))
            for model, run in zip(self.models, self.runs, strict=True)
        ]
        return LinearizedPosterior(
            scaled=scaled,
            cost=cost,
            runs=tuple(runs),
            normal=prior.scale.T @ normal @ prior.scale,
            gradient=prior.scale.T @ gradient,
            bounds=Bounds.of(prior.scale[:size], values, self.parameters.limits),
        )


def fit(
    parameters: Parameters,
    runs: Sequence[RecordingData],
    noise: SensorNoise,
    targets: Array,
    start: Array | None = None,
    on_progress: Callable[[int, float], None] = lambda step, cost: None,
) -> Fit:
    """Find the maximum a posteriori parameters of a model, given recordings.

    Args:
        parameters: to be fitted, with their prior.
        runs: the recordings, frames with targets in the base frame.
        noise: one sigma of every sensor, SI.
        targets: (targets,) m, arclength of the targets.
        start: (n,) initial values; None: the mean of the prior.
        on_progress: called with the number of each step and the cost.

    Returns:
        The fit with covariance; `converged` and `status` say how the search ended.

    Raises:
        ModelError: the start is not a valid arm.
    """
    posterior = Posterior(parameters, runs, noise, targets)
    scaled, size = np.zeros(posterior.prior.mean.size), posterior.prior.size
    if start is not None:
        scale = posterior.prior.scale[:size, :size]
        scaled[:size] = np.linalg.solve(scale, start - parameters.mean)

    def lower(last: LinearizedPosterior, step: Array) -> Array | None:
        scaled = last.scaled + step
        try:
            return scaled if posterior.cost(scaled, last) < last.cost else None
        except ModelError:  # no such arm exists: its rigidity would be zero
            return None

    search = gauss_newton(
        posterior.linearize(scaled),
        LinearizedPosterior.newton_step,
        lower,
        posterior.linearize,
        small=MAP_ESTIMATION.small_step,
        most_steps=MOST_STEPS,
        most_halvings=MOST_HALVINGS,
        on_step=lambda step, last: on_progress(step, last.cost),
    )
    status = {
        End.CONVERGED: 'converged',
        End.STUCK: (
            'no step lowers the cost, although the linearization predicts a change of '
            f'{search.gain:.2g} standard deviations'
        ),
        End.UNFINISHED: 'no convergence within the allowed steps',
    }[search.end]
    nearly = search.end is End.STUCK and search.gain < NEARLY
    converged = search.end is End.CONVERGED or nearly
    return finalize(posterior, search.last, search.steps, converged, status)


def finalize(
    posterior: Posterior, last: LinearizedPosterior, steps: int, converged: bool, status: str
) -> Fit:
    """Assemble the result: covariance and information of the model parameters."""
    prior, size = posterior.prior, posterior.prior.size
    hessian = last.normal + np.eye(last.scaled.size)
    covariance = np.linalg.inv(hessian)
    scale, rows = prior.scale[:size, :size], prior.scale[: prior.shared]
    values, disturbance = prior.unscale(last.scaled)
    # The information of the data on the model alone: disturbances are marginalized with their
    # prior.
    rest = np.linalg.inv(hessian[size:, size:])
    cross = last.normal[:size, size:]
    information = last.normal[:size, :size] - cross @ rest @ cross.T
    target = last.gradient + last.normal @ last.scaled
    information_vector = target[:size] - cross @ rest @ target[size:]
    unscale = np.linalg.inv(scale)
    runs = tuple(item.fitted for item in last.runs)
    return Fit(
        parameters=posterior.parameters,
        values=frozen_array(values),
        covariance=frozen_array(scale @ covariance[:size, :size] @ scale.T),
        shared_covariance=frozen_array(rows @ covariance @ rows.T),
        information=frozen_array(unscale.T @ information @ unscale),
        information_vector=frozen_array(unscale.T @ information_vector),
        placement=frozen_array(disturbance[: prior.shared - size].reshape(2, -1)),
        disturbance=frozen_array(disturbance),
        origin=frozen_array(prior.disturbances.origin(disturbance)),
        runs=runs,
        chi_squared=float(sum(run.whitened.sum() for run in runs)),
        dof=int(sum(run.dof.sum() for run in runs)),
        log_evidence=-last.cost - 0.5 * float(np.linalg.slogdet(hessian)[1]),
        steps=steps,
        converged=converged,
        status=status,
    )


def posterior_at(fit: Fit, noise: SensorNoise) -> tuple[Posterior, LinearizedPosterior]:
    """Return the posterior linearized at the end of the search of a fit; noise of the fit."""
    runs, targets = [item.run for item in fit.runs], fit.parameters.frame.target_arclength
    posterior = Posterior(fit.parameters, runs, noise, targets)
    prior, values = posterior.prior, np.concatenate([fit.values, fit.disturbance])
    scaled = np.linalg.solve(prior.scale, values - prior.mean)
    return posterior, posterior.linearize(scaled, keep_jacobians=True)

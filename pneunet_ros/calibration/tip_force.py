"""End force estimated from measured targets, with its standard deviation (result (b)).

At known pressure, the force is estimated by fitting the model to all targets of a frame, or only
to the last one. With the tip alone, the estimate is ill-conditioned; `sigma` shows by how much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.covariance import Whitening
from pneunet_ros.measurement.errors.noise_model import camera_errors, model_errors, target_std
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import inputs_of
from pneunet_ros.model.arm import Arm

ERROR_STEPS = (0, 3)  # at which the model errors are evaluated, because they change little
MOST_STEPS = 30  # Gauss-Newton steps; forces that have not converged are rejected
LEAST_SHARE = 0.05  # smallest relaxation factor, if steps oscillate
SMALL_STEP = 1e-4  # sigma of the force: convergence
# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
LARGEST_STEP = 0.6  # of a component, of the weight
LARGEST_SIGMA = 60.0  # of the weight: beyond it a force is not determined


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EndForces:
    """F1, F2 (N) of frames, (frames, 2), and their covariance (frames, 2, 2).

    NaN if not found or not determined, such as F1 from the tip of a straight arm.
    """

    force: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation of F1 and F2, (frames, 2) N."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def end_forces(arm: Arm, run: RecordingData, *, tip_only: bool = False) -> EndForces:
    """Estimate the end force of every frame of a recording, ignoring its force readings.

    The errors include those of targets, their placement, camera position, pressure, and the
    covariance of the model. The search starts with the measured force, if any.

    Args:
        arm: the model, with its sensors' noise and its covariance.
        run: the recording; targets (frames, targets) m in the base frame.
        tip_only: use only the last target.

    Returns:
        Force (frames, 2) N in the base frame and its covariance, NaN where there is none.
    """
    noise, targets = arm.sensors, arm.target_arclength
    used = np.zeros(targets.size, dtype=bool)
    used[-1 if tip_only else slice(None)] = True
    (inputs,) = inputs_of(arm, [run])
    loads, frames = inputs.loads.copy(), len(inputs.pressure)
    model = ForwardModel(targets)
    measured = run.points
    seen = (np.isfinite(measured) & used).reshape(frames, -1)
    camera = camera_errors(float(np.hypot(noise.registration_std, noise.drift_std)), targets.size)
    converged, covariance = np.zeros(frames, dtype=bool), np.full((frames, 2, 2), np.nan)
    active = np.flatnonzero(np.count_nonzero(seen, axis=1) >= 2)
    errors = np.zeros((0, seen.shape[1], 0))
    factors, previous_step = np.ones(frames), np.zeros((frames, 2))
    largest_sigma = LARGEST_SIGMA * arm.weight
    for count in range(MOST_STEPS):
        if active.size == 0:
            break
        now = inputs.subset(active).with_loads(loads[active])
        solved = model.solve(arm, now)
        if count in ERROR_STEPS:
            by_model = model_errors(arm, now)
            common = np.broadcast_to(camera, (active.size, *camera.shape))
            errors = np.concatenate([by_model, common], axis=2)
        whitening = Whitening(target_std(noise), errors, seen[active] & solved[:, None])
        residual = (measured[active] - model.points).reshape(active.size, -1, 1)
        jacobian = whitening(model.load_jacobian(arm, now)[:, :, :2])
        transposed = jacobian.transpose(0, 2, 1)
        normal = np.matmul(transposed, jacobian)
        # Invertible even if no point moves; such a force is not determined.
        normal[:, [0, 1], [0, 1]] += 0.01 / largest_sigma**2
        covariance[active] = np.linalg.inv(normal)
        gradient = np.matmul(transposed, whitening(residual))
        step = np.matmul(covariance[active], gradient)[:, :, 0]
        size = np.sqrt(np.einsum('fi,fij,fj->f', step, normal, step))
        largest = np.maximum(np.abs(step).max(axis=1), 1e-12 * arm.weight)
        share = np.minimum(
            relaxation(step, previous_step[active], factors[active]),
            LARGEST_STEP * arm.weight / largest,
        )
        loads[active, :2] += share[:, None] * step
        factors[active], previous_step[active] = share, step
        # Beyond buckling the force is not unique: another equilibrium fits as well.
        converged[active] = solved & model.stable & (size < SMALL_STEP)
        unconverged = np.flatnonzero(solved & (size >= SMALL_STEP))
        active, model, errors = active[unconverged], model.subset(unconverged), errors[unconverged]
    covariance[~converged] = np.nan
    determined = np.diagonal(covariance, axis1=1, axis2=2) < largest_sigma**2
    covariance = np.where(determined[:, :, None] & determined[:, None, :], covariance, np.nan)
    return EndForces(force=np.where(determined, loads[:, :2], np.nan), covariance=covariance)


def relaxation(step: Array, previous_step: Array, factors: Array) -> Array:
    """Return the relaxation factor of each step (frames, 2).

    previous_step: the last full step, scaled by `factors` when it was applied. If the residuals of
    a model are much larger than noise, full steps oscillate around the best force or diverge.

    Source: Irons and Tuck, Int. J. Numer. Methods Eng. 1 (1969).
    """
    change = previous_step - step
    projection, size = np.sum(previous_step * change, axis=1), np.sum(change**2, axis=1)
    known = previous_step.any(axis=1) & (size > 0.0)
    share: Array = np.divide(factors * projection, size, out=np.ones(len(step)), where=known)
    return np.clip(share, LEAST_SHARE, 1.0)

"""The load that most probably acted in a frame, given its targets: where a frame is linearized.

An arm may be so compliant that the noise of a force sensor moves its tip by millimeters, further
than a straight line follows. Then not the reading is where the model is linearized, but the load
that reading and targets together make most probable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.settings import tuning
from pneunet_ros.measurement.covariance import probable_errors
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.noise_model import attached_std
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbableLoadSettings:
    """How the most probable load is searched, and from when on it is no error of a reading."""

    rounds: int = tuning(2, 'of Gauss-Newton', source='what is left after them is a line')
    furthest: float = tuning(
        3.0,
        'that noise is a reading off; what is further is little by little, and from twice as far '
        'wholly, taken for the error of a model that is not fitted yet',
        unit='sigma',
        source='invented',
    )


PROBABLE_LOAD = ProbableLoadSettings()


def probable_load_errors(
    model: ForwardModel,
    arm: Arm,
    run: RecordingData,
    inputs: Inputs,
    disturbance: Array,
    noise: SensorNoise,
    settings: ProbableLoadSettings = PROBABLE_LOAD,
) -> Array:
    """Return by how much the load differs from its reading, (frames, 3) N, N m.

    Zero where nothing was read, where no noise of the reading would explain it, and in a frame
    that has no shape there. A known load is taken as it is: its error is the same in all frames.

    inputs: with the load as read; disturbance (frames, 2, targets) m: what placement and camera
    add; model: where the search for the equilibria starts.
    """
    shift = np.zeros_like(inputs.loads)
    std = attached_std(noise, run)
    if run.load_known or not std.any():
        return shift
    read = model.solve(arm, inputs).copy()
    for _ in range(settings.rounds):
        now = inputs.with_loads(inputs.loads + shift)
        errors = linear_errors(model, arm, run, now, shift, disturbance, noise)
        kept = np.clip(2.0 - np.abs(errors).max(axis=1) / settings.furthest, 0.0, 1.0)
        shift = std * errors * kept[:, None]
        solved = model.solve(arm, inputs.with_loads(inputs.loads + shift))
        shift[read & ~solved] = 0.0
    return shift


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

    The noise of pressure is left out, as the errors say only where to linearize. model: solved
    there.
    """
    by_load = model.load_jacobian(arm, inputs)
    residual = (run.points - model.points - disturbance).reshape(len(shift), -1)
    residual = residual + np.matmul(by_load, shift[:, :, None])[:, :, 0]
    seen = np.isfinite(residual) & np.isfinite(by_load).all(axis=2)
    columns = by_load * attached_std(noise, run)[:, None]
    columns = np.where(seen[:, :, None], columns, 0.0) / noise.target_std
    residual = np.where(seen, residual, 0.0) / noise.target_std
    return probable_errors(residual, columns)[1]

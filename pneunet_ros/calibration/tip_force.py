"""The end force behind measured targets, with its standard deviation (result (b) of the paper).

All targets of a frame, or the last one alone, the pressure known: the force is what brings the
model there. From the tip alone it is badly conditioned; `sigma` says how badly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.forward_model import ForwardModel
from pneunet_ros.measurement.inputs import Inputs, inputs_of
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.neighbors import neighbors
from pneunet_ros.model.uncertainty import SensorNoise

MOST_STEPS = 30
SMALL_STEP = 1e-4  # of a standard deviation of the force
LARGEST_STEP = 0.1  # N
SMALLEST_NORMAL = 1e-4  # 1/N^2, of a force that is not determined at all
LARGEST_SIGMA = 10.0  # N: what is less certain is not determined
PRESSURE_STEP = 20.0  # Pa
SPREAD_STEPS = (0, 3)  # when what the model leaves open is computed: it changes little


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EndForces:
    """F1, F2 (N) of frames, (frames, 2), and their covariance (frames, 2, 2).

    NaN: not found, or not determined, such as F1 from the tip of a straight arm.
    """

    force: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        """Standard deviation of F1 and F2, (frames, 2) N."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def end_forces(arm: Arm, run: RecordingData, *, tip_only: bool = False) -> EndForces:
    """Find the end force of every frame of a run, without looking at its force readings.

    The errors: targets, their placement, the camera's place, pressure, and the model's covariance.
    The search begins with the force that was read where there is one.
    """
    noise, targets = arm.sensors, arm.target_arclength
    used = np.zeros(targets.size, dtype=bool)
    used[-1 if tip_only else slice(None)] = True
    (inputs,) = inputs_of(arm, [run])
    loads, frames = inputs.loads.copy(), len(inputs.pressure)
    series = ForwardModel(targets)
    measured = np.stack([run.x, run.y], axis=1)
    seen = (np.isfinite(measured) & used).reshape(frames, -1)
    errors = point_errors(noise, targets.size)
    found, covariance = np.zeros(frames, dtype=bool), np.full((frames, 2, 2), np.nan)
    some = np.flatnonzero(np.count_nonzero(seen, axis=1) >= 2)
    spread = np.zeros((frames, seen.shape[1], 0))
    for count in range(MOST_STEPS):
        if some.size == 0:
            break
        now = inputs.at(some).with_loads(loads[some])
        solved = series.solve(arm, now)
        if count in SPREAD_STEPS:
            moved = model_spread(arm, now)
            spread = np.zeros((frames, *moved.shape[1:]))
            spread[some] = moved
        slopes = series.load_answer(arm, now)[:, :, :2]
        residual = (measured[some] - series.points).reshape(some.size, -1)
        step, covariance[some] = weighted_steps(
            errors, spread[some], slopes, residual, seen[some] & solved[:, None]
        )
        size = np.sqrt(np.einsum('fi,fij,fj->f', step, np.linalg.inv(covariance[some]), step))
        share = np.minimum(1.0, LARGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-12))
        loads[some] += np.column_stack([share[:, None] * step, np.zeros(some.size)])
        # Beyond buckling another equilibrium fits as well: no force is told apart there.
        found[some] = solved & series.stable & (size < SMALL_STEP)
        going_on = np.flatnonzero(solved & (size >= SMALL_STEP))
        some, series = some[going_on], series.some(going_on)
    covariance[~found] = np.nan
    known = np.diagonal(covariance, axis1=1, axis2=2) < LARGEST_SIGMA**2
    covariance = np.where(known[:, :, None] & known[:, None, :], covariance, np.nan)
    return EndForces(force=np.where(known, loads[:, :2], np.nan), covariance=covariance)


def point_errors(noise: SensorNoise, targets: int) -> Array:
    """Return the covariance of measured points, (2 targets, 2 targets), less the model's own."""
    variance = noise.target_std**2 + noise.placement_std**2
    common = np.kron(np.eye(2), np.ones((targets, targets)))
    place = noise.registration_std**2 + noise.drift_std**2
    return variance * np.eye(2 * targets) + place * common


def weighted_steps(
    errors: Array, spread: Array, slopes: Array, residual: Array, seen: npt.NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return the weighted least squares step (frames, 2) of every frame and its covariance.

    errors (points, points); spread (frames, points, n) of the model; slopes (frames, points, 2);
    residual and seen (frames, points).
    """
    both = seen[:, :, None] & seen[:, None, :]
    whole = errors + np.matmul(spread, spread.transpose(0, 2, 1))
    scale = errors[0, 0]  # what is not seen stands alone, with a slope of zero
    whole = np.where(both, whole, scale * np.eye(errors.shape[0]))
    slopes = np.where(seen[:, :, None], slopes, 0.0)
    right = np.concatenate([slopes, np.where(seen, residual, 0.0)[:, :, None]], axis=2)
    weighted = np.linalg.solve(whole, right)
    normal = np.matmul(slopes.transpose(0, 2, 1), weighted)
    normal[:, [0, 1], [0, 1]] += SMALLEST_NORMAL  # where the points do not answer at all
    covariance = np.linalg.inv(normal[:, :, :2])
    return np.matmul(covariance, normal[:, :, 2:])[:, :, 0], covariance


def model_spread(arm: Arm, inputs: Inputs) -> Array:
    """Return what one sigma of the pressure and of each column of the covariance moves.

    (frames, 2 targets, 1 + columns) m; NaN-free, zero where a neighbor has no equilibrium.
    """

    def points(arm: Arm, inputs: Inputs) -> Array:
        series = ForwardModel(arm.target_arclength)
        solved = series.solve(arm, inputs)
        return np.where(solved[:, None, None], series.points, np.nan)

    ends = [
        points(arm, replace(inputs, pressure=inputs.pressure + sign * PRESSURE_STEP))
        for sign in (-1.0, 1.0)
    ]
    moved = [arm.sensors.pressure_std * (ends[1] - ends[0]) / (2.0 * PRESSURE_STEP)]
    for column in () if arm.covariance is None else arm.covariance.columns():
        before, after, distance = neighbors(arm, column)
        moved.append((points(after, inputs) - points(before, inputs)) / distance)
    spread = np.stack([change.reshape(len(inputs.pressure), -1) for change in moved], axis=2)
    return np.where(np.isfinite(spread), spread, 0.0)

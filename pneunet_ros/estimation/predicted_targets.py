"""Where the targets must be seen if the estimate is right, and how far a frame is from that.

Errors of readings, of the model and of the camera's place move all targets of a frame together:
they are columns of the covariance, not spread over its diagonal. Noise that ignores this has the
right size and raises false alarms all the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator, PRESSURE
from pneunet_ros.estimation.sensor_mapping import gauge_pressure
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.model.equilibrium import linearize, with_pressure_change
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.interpolation import at_stations

SMALLEST_STD = 1e-7  # m, of a target; stands for zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Snapshot:
    """A pressure reading, what was estimated at it, and what the estimator knew then."""

    reading: PressureReading
    state: EstimatorState
    estimate: ShapeEstimate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedTargets:
    """Where the targets of the arm must be measured; x, y (targets,) m in the base frame.

    errors (sources, 2, targets) m: what one sigma of each independent error of reading or model
    does to all of them. The place of the camera and the targets' own noise are not among these.
    """

    x: Array
    y: Array
    errors: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Innovation:
    """How far the targets seen in one frame are from where they must be, in units of the noise.

    chi_square is that of all `coordinates` together; at_targets (targets,) that of each target by
    itself, per coordinate, NaN where one was not seen.
    """

    coordinates: int
    chi_square: float
    at_targets: Array


def predict_targets(estimator: Estimator, moment: Snapshot) -> PredictedTargets:
    """Return where the targets must be at an estimate of this estimator."""
    arm, shape, history = estimator.arm, moment.estimate.shape, moment.state.history
    assert shape.solution is not None and history is not None
    rods, change = with_pressure_change(arm, moment.estimate.chamber_pressure, history)
    places = np.empty((6, arm.target_arclength.size))
    at_stations(
        shape.solution.panels,
        shape.solution.nodes,
        rods.knots,
        rods.rotation[0],
        arm.target_arclength,
        places,
    )
    changes = estimator.changes(rods, change, history)
    response = linearize(shape.solution, rods, changes, arm.target_arclength)
    wrench, _, _ = estimator.wrench_at(moment.state, moment.reading.stamp_ns)
    gauge = gauge_pressure(estimator.settings, moment.reading.pressure)
    mixing = estimator.noise_columns(moment.reading, gauge, wrench)
    errors = np.tensordot(mixing, response.stations[:, :2], axes=1)
    x, y = arm.see(places[0], places[1])
    if arm.seeing:  # a camera that distorts distorts errors as well, and may be in error itself
        moved = arm.see(places[0] + errors[:, 0], places[1] + errors[:, 1])
        errors = np.stack([moved[0] - x, moved[1] - y], axis=1)
        for column, (before, after, distance) in enumerate(estimator.model_columns):
            less, more = (np.stack(side.see(places[0], places[1])) for side in (before, after))
            errors[PRESSURE + 1 + column] += (more - less) / distance
    return PredictedTargets(x=x, y=y, errors=errors)


def innovation(
    expected: PredictedTargets, sightings: TargetSightings, noise: SensorNoise
) -> Innovation | None:
    """Compare a frame with what was expected; None where no target was seen.

    Of the white noise of a target the larger is taken, as the model has it or as the tracker says.
    """
    seen = np.isfinite(sightings.x) & np.isfinite(sightings.y)
    targets = int(np.count_nonzero(seen))
    if not targets:
        return None
    apart = np.stack([sightings.x - expected.x, sightings.y - expected.y])[:, seen]
    white = np.fmax(sightings.std[seen], noise.target_std)
    std = np.maximum(np.hypot(white, noise.placement_std), SMALLEST_STD)
    camera = np.zeros((2, 2, targets))
    camera[0, 0] = camera[1, 1] = np.hypot(noise.registration_std, noise.drift_std)
    apart /= std
    common = np.concatenate([expected.errors[:, :, seen], camera]) / std
    # Of C = 1 + P P^T, by the small matrix 1 + P^T P.
    columns = common.reshape(len(common), -1)
    along = columns @ apart.ravel()
    small = np.eye(len(columns)) + columns @ columns.T
    chi_square = float(np.sum(apart**2) - along @ np.linalg.solve(small, along))
    # Of each target: its own two by two block of C.
    xx, xy, yy = (
        1.0 + np.sum(common[:, 0] ** 2, axis=0),
        np.sum(common[:, 0] * common[:, 1], axis=0),
        1.0 + np.sum(common[:, 1] ** 2, axis=0),
    )
    at_targets = np.full(seen.size, np.nan)
    quadratic = yy * apart[0] ** 2 - 2.0 * xy * apart[0] * apart[1] + xx * apart[1] ** 2
    at_targets[seen] = 0.5 * quadratic / (xx * yy - xy**2)
    return Innovation(coordinates=2 * targets, chi_square=chi_square, at_targets=at_targets)

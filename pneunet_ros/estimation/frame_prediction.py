"""Predicted targets of a frame, from the estimates before and after the frame.

A frame is rarely taken exactly at a reading. The arm is assumed to move linearly between
estimates, under the loads read before and after the frame, including their interpolation errors.
Unlike an estimate, which uses the last received wrench, the prediction also uses later wrenches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.measurement.between_readings import (
    furthest_error,
    interpolate,
    interpolated_noise,
    interpolation_error,
    places_between,
)
from pneunet_ros.measurement.disturbances import SMALLEST_STD
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.moving_arm import delayed_noise_parts
from pneunet_ros.measurement.predicted_targets import (
    predict_targets,
    PredictedTargets,
    seen_targets,
)
from pneunet_ros.solver.columns import LOADS

NEIGHBORS = 2  # estimates on either side of a frame, for interpolation


def predict_frame(
    estimator: Estimator, estimates: Sequence[ShapeEstimate], shown_ns: int
) -> PredictedTargets | None:
    """Return the predicted targets of a frame showing the arm at a stamp (ns).

    estimates: one or more, at increasing stamps (ns). None if the estimates are so far apart that
    the error of linear interpolation may exceed the noise of a target.
    """
    stamps = np.array([estimate.stamp_ns for estimate in estimates])
    after = int(np.searchsorted(stamps, shown_ns))
    around = slice(max(after - NEIGHBORS, 0), after + NEIGHBORS)
    estimates, stamps = estimates[around], stamps[around]
    nearest = estimates[int(np.argmin(np.abs(stamps - shown_ns)))]
    curved = nearest.second_order
    assert nearest.noise is not None and curved is not None
    predicted = predict_targets(estimator.table, nearest.noise, curved)
    if len(estimates) < 2:
        return in_motion(estimator, predicted, [nearest], [1.0], nearest)
    shown = np.array([shown_ns])
    (before,), (fraction,) = places_between(shown, stamps)
    pair, shares = estimates[before : before + 2], (1.0 - fraction, fraction)
    displacement = np.zeros((2, predicted.x.size))
    for estimate, weight in zip(pair, shares, strict=True):
        if estimate is not nearest and weight > 0.0:
            assert estimate.curved is not None
            targets = seen_targets(estimator.arm, estimate.curved.sensitivity)
            displacement += weight * (np.array(targets) - [predicted.x, predicted.y])
    wrench_ns, wrench = wrenches_of(estimates)
    chamber = np.array([[estimate.chamber_pressure] for estimate in estimates])
    std = np.maximum(np.diag(nearest.noise)[: PRESSURE + 1], SMALLEST_STD)
    missed = np.append(
        interpolation_error(shown, wrench_ns, wrench, std[:PRESSURE]),
        interpolation_error(shown, stamps, chamber, std[PRESSURE:]),
    )
    noise, furthest = (
        np.append(np.repeat(of(shown, wrench_ns), LOADS), of(shown, stamps))
        for of in (interpolated_noise, furthest_error)
    )
    size = np.ones(len(predicted.errors))
    size[: PRESSURE + 1] = np.hypot(noise, missed / std)
    error = (furthest * missed / std) @ np.abs(predicted.errors[: PRESSURE + 1, :, -1])
    read = np.array([interpolate(shown, wrench_ns, column)[0] for column in wrench.T])
    used = shares[0] * load_of(pair[0]) + shares[1] * load_of(pair[1])
    displacement += np.tensordot(read - used, predicted.by_load, axes=1)
    distance = max(math.hypot(*error), math.hypot(*displacement[:, -1]))
    if distance**2 > estimator.arm.length * estimator.arm.sensors.target_std:
        return None
    at_rest = replace(
        predicted,
        x=predicted.x + displacement[0],
        y=predicted.y + displacement[1],
        errors=size[:, None, None] * predicted.errors,
    )
    return in_motion(estimator, at_rest, pair, shares, nearest)


def in_motion(
    estimator: Estimator,
    predicted: PredictedTargets,
    pair: Sequence[ShapeEstimate],
    shares: Sequence[float],
    nearest: ShapeEstimate,
) -> PredictedTargets:
    """Return the predicted targets of a moving arm, given its equilibrium targets.

    pair, shares: the estimates around the frame, and their interpolation weights; nearest: the
    estimate whose motion provides the errors.
    """
    places = estimator.target_places
    if places is None or nearest.motion is None:
        return predicted
    deviation = np.zeros((3, predicted.x.size))
    for estimate, share in zip(pair, shares, strict=True):
        if estimate.motion is not None:
            deviation += share * estimate.motion.deviation(places)
    see = partial(estimator.arm.see_moves, predicted.x, predicted.y)
    errors, shapes = (
        np.stack(see(moves[:, 0], moves[:, 1]), axis=1)
        for moves in (nearest.motion.errors(places), nearest.motion.shapes(places))
    )
    late = delayed_noise_parts(predicted.errors[: PRESSURE + 1], shapes)
    return predicted.displaced(*see(deviation[0], deviation[1]), np.concatenate([errors, late]))


def load_of(estimate: ShapeEstimate) -> Array:
    """Return F1, F2 (N), M (N m) of an estimate, (3,)."""
    return np.array([*estimate.shape.force, estimate.shape.end_moment])


def wrenches_of(estimates: Sequence[ShapeEstimate]) -> tuple[Stamps, Array]:
    """Return the stamps (wrenches,) ns and loads (wrenches, 3) used by estimates."""
    read = {
        estimate.stamp_ns - round((estimate.wrench_age or 0.0) * NANOSECONDS_PER_SECOND): load_of(
            estimate
        )
        for estimate in estimates
    }
    stamps = sorted(read)
    return np.array(stamps), np.array([read[stamp] for stamp in stamps])

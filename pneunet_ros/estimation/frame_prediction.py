"""Predicted targets of a frame, from the estimates before and after it.

A frame is rarely taken with a reading. The arm is assumed to move linearly between estimates,
under the load of the readings before and after the frame, and the interpolation errors of both are
included. An estimate uses the last wrench that had come; what was read behind it counts here, too.
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
from pneunet_ros.measurement.moving_arm import late_parts
from pneunet_ros.measurement.predicted_targets import (
    predict_targets,
    PredictedTargets,
    seen_targets,
)
from pneunet_ros.solver.columns import LOADS

BESIDE = 2  # estimates on either side of a frame, for interpolation


def predict_frame(
    estimator: Estimator, estimates: Sequence[ShapeEstimate], shown_ns: int
) -> PredictedTargets | None:
    """Return the predicted targets of a frame that shows the arm at a stamp (ns).

    estimates: at increasing stamps (ns), at least one. None if they are too far apart: the arm
    moves, or may have moved, so far between them that linear interpolation is wrong by more than
    the noise of a target.
    """
    stamps = np.array([estimate.stamp_ns for estimate in estimates])
    behind = int(np.searchsorted(stamps, shown_ns))
    near = slice(max(behind - BESIDE, 0), behind + BESIDE)
    estimates, stamps, shown = estimates[near], stamps[near], np.array([shown_ns])
    nearest = estimates[int(np.argmin(np.abs(stamps - shown_ns)))]
    curved = nearest.second_order
    assert nearest.noise is not None and curved is not None
    predicted = predict_targets(estimator.table, nearest.noise, curved)
    if len(estimates) < 2:
        return in_motion(estimator, predicted, [nearest], [1.0], nearest)
    places, shares = places_between(shown, stamps)
    before, share = int(places[0]), float(shares[0])
    pair = estimates[before : before + 2]
    moved = np.zeros((2, predicted.x.size))
    for estimate, weight in zip(pair, (1.0 - share, share), strict=True):
        if estimate is not nearest and weight > 0.0:
            assert estimate.curved is not None
            there = seen_targets(estimator.arm, estimate.curved.sensitivity)
            moved += weight * (np.stack(there) - [predicted.x, predicted.y])
    wrench_ns, wrench = wrenches_of(estimates)
    together = np.array_equal(wrench_ns, stamps)  # as without a force sensor
    if not together:
        used = (1.0 - share) * load_of(pair[0]) + share * load_of(pair[1])
        load = np.array([float(interpolate(shown, wrench_ns, part)[0]) for part in wrench.T])
        moved += np.tensordot(load - used, predicted.by_load, axes=1)
    chamber = np.array([[estimate.chamber_pressure] for estimate in estimates])
    std = np.maximum(np.diag(nearest.noise)[: PRESSURE + 1], SMALLEST_STD)
    if together:
        read = np.concatenate([wrench, chamber], axis=1)
        missed = interpolation_error(shown, stamps, read, std)[0] / std
    else:
        missed = np.append(
            interpolation_error(shown, wrench_ns, wrench, std[:LOADS])[0] / std[:LOADS],
            interpolation_error(shown, stamps, chamber, std[PRESSURE:])[0] / std[PRESSURE:],
        )
    furthest = missed * furthest_error(shown, stamps)
    if not together:
        furthest[:LOADS] = missed[:LOADS] * furthest_error(shown, wrench_ns)
    strayed = np.hypot(*np.abs(furthest) @ np.abs(predicted.errors[: PRESSURE + 1, :, -1]))
    gone = np.hypot(*moved[:, -1])
    if max(strayed, gone) ** 2 > estimator.arm.length * estimator.arm.sensors.target_std:
        return None
    size = np.ones(len(predicted.errors))
    size[: PRESSURE + 1] = math.hypot(1.0 - share, share)
    if not together:
        size[:LOADS] = interpolated_noise(shown, wrench_ns)
    size[: PRESSURE + 1] = np.hypot(size[: PRESSURE + 1], missed)
    still = replace(
        predicted,
        x=predicted.x + moved[0],
        y=predicted.y + moved[1],
        errors=size[:, None, None] * predicted.errors,
    )
    return in_motion(estimator, still, pair, [1.0 - share, share], nearest)


def in_motion(
    estimator: Estimator,
    predicted: PredictedTargets,
    pair: Sequence[ShapeEstimate],
    shares: Sequence[float],
    nearest: ShapeEstimate,
) -> PredictedTargets:
    """Return the predicted targets of a moving arm, given its equilibrium targets.

    pair, shares: the estimates around the frame, and how near it is to each; nearest: whose
    motion has the errors.
    """
    places = estimator.target_places
    if places is None or nearest.motion is None:
        return predicted
    beside = np.zeros((3, predicted.x.size))
    for estimate, share in zip(pair, shares, strict=True):
        if estimate.motion is not None:
            beside += share * estimate.motion.beside(places)
    see = partial(estimator.arm.see_moves, predicted.x, predicted.y)
    errors, shapes = (
        np.stack(see(moves[:, 0], moves[:, 1]), axis=1)
        for moves in (nearest.motion.errors(places), nearest.motion.shapes(places))
    )
    late = late_parts(predicted.errors[: PRESSURE + 1], shapes)
    return predicted.moved(*see(beside[0], beside[1]), np.concatenate([errors, late]))


def load_of(estimate: ShapeEstimate) -> Array:
    """Return F1, F2 (N), M (N m) of an estimate, (3,)."""
    return np.array([*estimate.shape.force, estimate.shape.end_moment])


def wrenches_of(estimates: Sequence[ShapeEstimate]) -> tuple[Stamps, Array]:
    """Return the stamps (wrenches,) ns and loads (wrenches, 3) that estimates have used."""
    read = {
        estimate.stamp_ns - round((estimate.wrench_age or 0.0) * NANOSECONDS_PER_SECOND): load_of(
            estimate
        )
        for estimate in estimates
    }
    stamps = sorted(read)
    return np.array(stamps), np.array([read[stamp] for stamp in stamps])

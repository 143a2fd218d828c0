"""Predicted targets of a frame, from the estimates before and after it.

A frame is rarely taken exactly at a reading. The arm is assumed to move linearly between
estimates, under the loads read before and after the frame, including their interpolation errors.
Unlike an estimate, which uses the last wrench that had arrived, this also uses later wrenches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import kernel
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.measurement.between_readings import (
    explained_changes,
    FURTHEST,
    line_between,
    MISSED,
    NOISE,
    place_between,
    VALUE,
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

NEIGHBORS = 2  # estimates on either side of a frame, for interpolation


def predict_frame(
    estimator: Estimator, estimates: Sequence[ShapeEstimate], shown_ns: int
) -> PredictedTargets | None:
    """Return the predicted targets of a frame showing the arm at a stamp (ns).

    estimates: one or more, at increasing stamps (ns). None if they are too far apart: the arm may
    have moved so far between them that the error of linear interpolation exceeds the noise of a
    target.
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
    before, fraction = place_between(shown_ns, stamps)
    pair, shares = estimates[before : before + 2], (1.0 - fraction, fraction)
    displacement = np.zeros((2, predicted.x.size))
    for estimate, weight in zip(pair, shares, strict=True):
        if estimate is not nearest and weight > 0.0:
            assert estimate.curved is not None
            targets = seen_targets(estimator.arm, estimate.curved.sensitivity)
            displacement += weight * (np.array(targets) - [predicted.x, predicted.y])
    wrench_ns, wrench = wrenches_of(estimates)
    size = np.ones(len(predicted.errors))
    std = np.maximum(np.diag(nearest.noise)[: PRESSURE + 1], SMALLEST_STD)
    distance = move_to_frame(
        shown_ns,
        stamps,
        np.array([[estimate.chamber_pressure] for estimate in estimates]),
        wrench_ns,
        wrench,
        shares[0] * load_of(pair[0]) + shares[1] * load_of(pair[1]),
        std,
        explained_changes(std),
        predicted.errors,
        predicted.by_load,
        displacement,
        size,
    )
    if distance**2 > estimator.arm.length * estimator.arm.sensors.target_std:
        return None
    at_rest = replace(
        predicted,
        x=predicted.x + displacement[0],
        y=predicted.y + displacement[1],
        errors=size[:, None, None] * predicted.errors,
    )
    return in_motion(estimator, at_rest, pair, shares, nearest)


@kernel
def move_to_frame(
    shown_ns: int,
    stamps: Stamps,
    chamber: Array,
    wrench_ns: Stamps,
    wrench: Array,
    used: Array,
    std: Array,
    least: Array,
    errors: Array,
    by_load: Array,
    displacement: Array,
    size: Array,
) -> float:
    """Move predicted targets to a frame between readings; returns the motion (m) of the tip.

    stamps (estimates,) ns, with chamber (estimates, 1) Pa; wrench_ns (wrenches,), with wrench
    (wrenches, 3) N, N m; used (3,): the load on the line between the estimates; std (4,): one
    sigma of a reading; least (4,): from `explained_changes`; errors, by_load: as in
    PredictedTargets. Adds the effect of the load read at the frame to displacement (2, targets) m,
    and fills size (sources,), the size of each error. The result is the larger of the error of
    linear interpolation and the displacement of the tip.
    """
    loads, pressure = np.empty((4, LOADS)), np.empty((4, 1))
    line_between(shown_ns, wrench_ns, wrench, least[:LOADS].copy(), loads)
    line_between(shown_ns, stamps, chamber, least[LOADS:].copy(), pressure)
    last = displacement.shape[1] - 1
    error_x, error_y = 0.0, 0.0
    for source in range(LOADS + 1):
        line = loads[:, source] if source < LOADS else pressure[:, 0]
        missed = line[MISSED] / std[source]
        error_x += missed * line[FURTHEST] * abs(errors[source, 0, last])
        error_y += missed * line[FURTHEST] * abs(errors[source, 1, last])
        size[source] = math.hypot(line[NOISE], missed)
    for axis in range(2):
        for target in range(last + 1):
            for i in range(LOADS):
                load_change = loads[VALUE, i] - used[i]
                displacement[axis, target] += load_change * by_load[i, axis, target]
    return max(
        math.hypot(error_x, error_y), math.hypot(displacement[0, last], displacement[1, last])
    )


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
    late = late_parts(predicted.errors[: PRESSURE + 1], shapes)
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

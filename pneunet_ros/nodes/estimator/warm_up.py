"""Warm-up before the first reading: kernels and message templates."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.predicted_targets import predict_targets
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.model.arm import Arm
from pneunet_ros.solver.boundary_value_problem import BoundaryValueProblem


def warm_up(estimator: Estimator, serializer: MessageSerializer) -> str:
    """Run every kernel and encoder once; return why the model gave no estimate, or ''.

    A kernel that is compiled or loaded at first use would delay the readings of a running arm, so
    the kernels for difficult cases are run as well.
    """
    arm = estimator.arm
    low, high = arm.pressure_range
    middle = 0.5 * (low + high)
    shifted = middle + 0.01 * (high - low)
    BoundaryValueProblem(arm.rods(np.array([middle])), (0.0, 0.0), 0.0).continue_in_load()
    force_x, force_y, moment = load_inside(arm)
    readings = (
        WrenchReading(
            stamp_ns=1,
            force_x=force_x,
            force_y=force_y,
            moment=moment,
            frame_id=estimator.settings.frame_id,
        ),
        PressureReading(stamp_ns=1, pressure=estimator.settings.pressure.reading(middle)),
        PressureReading(stamp_ns=2, pressure=estimator.settings.pressure.reading(shifted)),
    )
    state, outcome = EstimatorState(), None
    for reading in readings:
        state, outcome = estimator.step(state, reading)
    if not isinstance(outcome, ShapeEstimate):
        return '' if outcome is None else outcome.sentence
    for topic in OUTPUTS:
        serializer.bytes_of(topic, outcome)
    if estimator.settings.watch_targets:
        assert outcome.noise is not None and outcome.second_order is not None
        predict_targets(estimator.table, outcome.noise, outcome.second_order)
    return ''


def load_inside(arm: Arm) -> tuple[float, float, float]:
    """Return a load F1, F2 (N), M (N m) inside the domain at mid-range pressure.

    Half of any calibrated load is inside, because the convex domain includes the unloaded arm.
    """
    if arm.domain is None:
        return 0.0, 0.1 * arm.weight, 0.0
    rows = arm.domain.end_load
    force_x, force_y, moment, _ = rows[int(np.argmax(np.hypot(rows[:, 0], rows[:, 1])))].tolist()
    return 0.5 * force_x, 0.5 * force_y, 0.5 * moment

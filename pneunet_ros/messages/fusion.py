"""Messages of the fusion: inputs, and one entry per output topic.

The shape has the layout of the estimator's topics, so that subscribers of these only need to remap
names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.outcome import drop
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.fusion.estimate import FusedEstimate, FusionOutcome, Mode
from pneunet_ros.fusion.fusion import Event, Fusion
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.messages.builders import (
    Input,
    MessageTypes,
    Output,
    point_cloud,
    POINTS_TYPE,
    UNREADABLE,
)
from pneunet_ros.messages.estimate import OUTPUTS, STATE, state_point, StateMode
from pneunet_ros.messages.readings import (
    decode_targets,
    FUSED,
    PRESSURE_TYPE,
    TARGETS,
    WRENCH_TYPE,
)

# The point of `fused/end_force`: float32 coordinates, and the mode in the 4 bytes after them.
FORCE_POINT = np.dtype(
    {
        'names': ['x', 'y', 'z', 'fx', 'fy', 'cov_xx', 'cov_xy', 'cov_yy', 'mode'],
        'formats': ['<f4'] * 3 + ['<f8'] * 5 + ['<i4'],
        'offsets': [0, 4, 8, *range(16, 56, 8), 12],
        'itemsize': 56,
    }
)

# The point of `fused/contact`: float32 coordinates, 4 bytes of padding, and its estimates.
CONTACT_POINT = np.dtype(
    {
        'names': ['x', 'y', 'z', 's', 'std_s', 'force', 'std_force', 'log_odds'],
        'formats': ['<f4'] * 3 + ['<f8'] * 5,
        'offsets': [0, 4, 8, *range(16, 56, 8)],
        'itemsize': 56,
    }
)


def force_point(fused: FusedEstimate) -> npt.NDArray[Any]:
    """Return the record of FORCE_POINT at the tip; NaN if not determined."""
    point = np.zeros(1, FORCE_POINT)
    point['x'], point['y'], _ = fused.estimate.shape.tip
    point['fx'], point['fy'] = fused.force
    (point['cov_xx'], point['cov_xy']), (_, point['cov_yy']) = fused.force_covariance
    point['mode'] = fused.mode
    return point


def force_cloud(fused: FusedEstimate, heading: Any, types: MessageTypes) -> Any:
    """Build a PointCloud2 of one point."""
    known = bool(np.isfinite(fused.force_covariance).all())
    return point_cloud(force_point(fused), heading, types, is_dense=known)


def contact_points(fused: FusedEstimate) -> npt.NDArray[Any]:
    """Return the records of CONTACT_POINT; none without a contact, or if it may be a tip force."""
    contact = fused.contact
    if contact is None or contact.ambiguous:
        return np.zeros(0, CONTACT_POINT)
    point = np.zeros(1, CONTACT_POINT)
    point['x'], point['y'] = contact.x, contact.y
    point['s'], point['std_s'] = contact.arclength, contact.std_arclength
    point['force'], point['std_force'] = contact.force, contact.std_force
    point['log_odds'] = contact.log_odds
    return point


def contact_cloud(fused: FusedEstimate, heading: Any, types: MessageTypes) -> Any:
    """Build a PointCloud2 of one point or none."""
    return point_cloud(contact_points(fused), heading, types)


def end_wrench(fused: FusedEstimate, heading: Any, types: MessageTypes) -> Any:
    """Build a WrenchStamped of the tip force; NaN if not determined."""
    vector = types('geometry_msgs/msg/Vector3')
    force_x, force_y = fused.force.tolist()
    return types(WRENCH_TYPE)(
        header=heading,
        wrench=types('geometry_msgs/msg/Wrench')(
            force=vector(x=force_x, y=force_y, z=0.0),
            torque=vector(x=0.0, y=0.0, z=fused.estimate.shape.end_moment),
        ),
    )


def pressure_bias(fused: FusedEstimate, heading: Any, types: MessageTypes) -> Any:
    """Build a FluidPressure of the slow pressure error (Pa) and its variance (Pa^2)."""
    return types(PRESSURE_TYPE)(
        header=heading, fluid_pressure=fused.pressure_bias, variance=fused.pressure_bias_std**2
    )


def of_estimate(output: Output[ShapeEstimate]) -> Output[FusedEstimate]:
    """Return an output of the estimator for the shape in a fused estimate."""
    numbers = cast(Callable[[ShapeEstimate], npt.NDArray[Any]], output.numbers)
    fused = cast(Output[Any], output)
    return replace(
        fused, name=f'{FUSED}/{output.name}', numbers=lambda result: numbers(result.estimate)
    )


def fused_state(fused: FusedEstimate) -> npt.NDArray[Any]:
    """Return the one record of STATE_POINT."""
    return state_point(fused.estimate, STATE_MODES[fused.mode])


# The modes of `state` and `fused/state` start at the estimator's, those of `fused/end_force` at
# the best.
STATE_MODES = {
    Mode.PREDICTION: StateMode.PREDICTION,
    Mode.FUSED: StateMode.FUSED,
    Mode.CAMERA_ONLY: StateMode.CAMERA_ONLY,
}
FUSION_OUTPUTS: tuple[Output[FusedEstimate], ...] = (
    *(of_estimate(output) for output in OUTPUTS if output is not STATE),
    Output(name=f'{FUSED}/{STATE.name}', type=STATE.type, build=STATE.build, numbers=fused_state),
    Output(name=f'{FUSED}/end_wrench', type=WRENCH_TYPE, build=end_wrench),
    Output(name=f'{FUSED}/end_force', type=POINTS_TYPE, build=force_cloud),
    Output(name=f'{FUSED}/contact', type=POINTS_TYPE, build=contact_cloud),
    Output(name=f'{FUSED}/pressure_bias', type=PRESSURE_TYPE, build=pressure_bias),
)


def fuse_message(
    fusion: Fusion, state: FusionState, sensor: Input[Any], message: Any
) -> tuple[FusionState, FusionOutcome]:
    """Process a message of pressure, end wrench or targets, live and in a replay.

    The outcome is that of `Fusion.step`; an invalid message is counted and gives a Refusal.
    """
    event: Event
    try:
        if sensor is TARGETS:
            targets = len(fusion.arm.target_arclength)
            event = decode_targets(message, fusion.sensors.frame_id, targets)
        else:
            event = sensor.decode(message)
    except MessageError as error:
        refusal = drop(0, UNREADABLE, str(error))
        if sensor is TARGETS:
            return state.count_unused(UNREADABLE), refusal
        return state.count_rejected(UNREADABLE), refusal
    return fusion.step(state, event)

"""ROS messages <-> readings and estimates, by field name: the table of the estimator's topics.

Nothing of ROS is imported: a message is anything with the fields of its type, be it of rclpy or
decoded from a recording. A new topic is one function and one line in `TOPICS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy.typing as npt
from pneunet_ros.errors import MessageError
from pneunet_ros.estimate_messages import (
    ARRAY_TYPE,
    centerline_numbers,
    curvature_numbers,
    encode_centerline,
    encode_curvature,
    encode_jacobian,
    encode_shape,
    encode_tip,
    jacobian_numbers,
    MessageTypes,
    PATH_TYPE,
    POINTS_TYPE,
    POSE_TYPE,
    shape_numbers,
    tip_numbers,
)
from pneunet_ros.readings import PressureReading, Reading, WrenchReading
from pneunet_ros.shape import ShapeEstimate
from pneunet_ros.units import NANOSECONDS_PER_SECOND

PRESSURE_TYPE = 'sensor_msgs/msg/FluidPressure'
WRENCH_TYPE = 'geometry_msgs/msg/WrenchStamped'
UNREADABLE = 'unreadable'  # reason of a refusal: a message is not what its topic promises


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """A topic that is read: its last name, its type, and how a message becomes a reading."""

    direction: ClassVar[Literal['in', 'out']] = 'in'
    name: str
    type: str
    decode: Callable[[Any], Reading]


@dataclass(frozen=True, slots=True, kw_only=True)
class Output:
    """A topic that is written: its name, its type, and how an estimate becomes a message.

    `encode(estimate, frame_id, types)` builds the message. `numbers(estimate)`, where given, are
    all the numbers in it but stamps, row by row as they stand in the serialized message: with them
    `cdr_template` fills it in place.
    """

    direction: ClassVar[Literal['in', 'out']] = 'out'
    name: str
    type: str
    encode: Callable[[ShapeEstimate, str, MessageTypes], Any]
    numbers: Callable[[ShapeEstimate], npt.NDArray[Any]] | None = None


def decode_pressure(message: Any) -> PressureReading:
    """Return the reading in a FluidPressure, even NaN; MessageError on another content."""
    try:
        return PressureReading(
            stamp_ns=_nanoseconds(message.header.stamp),
            pressure=float(message.fluid_pressure),
            variance=float(message.variance),
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise MessageError(f'a message is no usable {PRESSURE_TYPE}: {error}') from error


def decode_wrench(message: Any) -> WrenchReading:
    """Return the planar part of a WrenchStamped as it is; MessageError on another content."""
    try:
        force = message.wrench.force
        return WrenchReading(
            stamp_ns=_nanoseconds(message.header.stamp),
            force_x=float(force.x),
            force_y=float(force.y),
            moment=float(message.wrench.torque.z),
            frame_id=str(message.header.frame_id),
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise MessageError(f'a message is no usable {WRENCH_TYPE}: {error}') from error


def _nanoseconds(stamp: Any) -> int:
    seconds, nanoseconds = int(stamp.sec), int(stamp.nanosec)
    if not 0 <= nanoseconds < NANOSECONDS_PER_SECOND:
        raise ValueError(f'nanosec = {nanoseconds} of its stamp is not within [0, 999999999]')
    return seconds * NANOSECONDS_PER_SECOND + nanoseconds


TOPICS: tuple[Input | Output, ...] = (
    Input(name='pressure', type=PRESSURE_TYPE, decode=decode_pressure),
    Input(name='end_wrench', type=WRENCH_TYPE, decode=decode_wrench),
    Output(
        name='centerline', type=PATH_TYPE, encode=encode_centerline, numbers=centerline_numbers
    ),
    Output(name='curvature', type=ARRAY_TYPE, encode=encode_curvature, numbers=curvature_numbers),
    Output(name='shape', type=POINTS_TYPE, encode=encode_shape, numbers=shape_numbers),
    Output(name='tip', type=POSE_TYPE, encode=encode_tip, numbers=tip_numbers),
    Output(name='tip_jacobian', type=ARRAY_TYPE, encode=encode_jacobian, numbers=jacobian_numbers),
)
INPUTS = tuple(topic for topic in TOPICS if isinstance(topic, Input))
OUTPUTS = tuple(topic for topic in TOPICS if isinstance(topic, Output))

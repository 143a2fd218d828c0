"""ROS messages <-> readings and estimates, by field name: the table of the estimator's topics.

Nothing of ROS is imported: a message is anything with the fields of its type, be it of rclpy or
decoded from a recording. A new topic is one function and one line in `TOPICS`.
"""

from __future__ import annotations

from typing import Any

from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.readings import PressureReading, Reading, WrenchReading
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.messages.builders import (
    ARRAY_TYPE,
    Input,
    nanoseconds,
    Output,
    PATH_TYPE,
    POINTS_TYPE,
    UNFIT,
)
from pneunet_ros.messages.estimate import (
    centerline_numbers,
    curvature_numbers,
    encode_centerline,
    encode_curvature,
    encode_jacobian,
    encode_shape,
    encode_tip,
    jacobian_numbers,
    POSE_TYPE,
    shape_numbers,
    tip_numbers,
)

PRESSURE_TYPE = 'sensor_msgs/msg/FluidPressure'
WRENCH_TYPE = 'geometry_msgs/msg/WrenchStamped'


def decode_pressure(message: Any) -> PressureReading:
    """Return the reading in a FluidPressure, even NaN; MessageError on another content."""
    try:
        return PressureReading(
            stamp_ns=nanoseconds(message.header.stamp),
            pressure=float(message.fluid_pressure),
            variance=float(message.variance),
        )
    except UNFIT as error:
        raise MessageError(f'a message is no usable {PRESSURE_TYPE}: {error}') from error


def decode_wrench(message: Any) -> WrenchReading:
    """Return the planar part of a WrenchStamped as it is; MessageError on another content."""
    try:
        force = message.wrench.force
        return WrenchReading(
            stamp_ns=nanoseconds(message.header.stamp),
            force_x=float(force.x),
            force_y=float(force.y),
            moment=float(message.wrench.torque.z),
            frame_id=str(message.header.frame_id),
        )
    except UNFIT as error:
        raise MessageError(f'a message is no usable {WRENCH_TYPE}: {error}') from error


TOPICS: tuple[Input[Reading] | Output[ShapeEstimate], ...] = (
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

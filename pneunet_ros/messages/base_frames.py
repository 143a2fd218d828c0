"""Direction of gravity from messages: an accelerometer on the base, or tf frames."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.frames import Quaternion
from pneunet_ros.core.readings import FrameReading, ImuReading
from pneunet_ros.messages.builders import header, MessageTypes, nanoseconds, usable

IMU_TYPE = 'sensor_msgs/msg/Imu'
TRANSFORM_TYPE = 'tf2_msgs/msg/TFMessage'


def decode_imu(message: Any) -> ImuReading:
    """Return specific force and angular velocity of an Imu, unchanged; MessageError if invalid.

    The first number of a covariance is -1 if the IMU does not measure the quantity. An angular
    velocity that is not finite counts as not measured.
    """
    with usable(IMU_TYPE):
        force, turn = message.linear_acceleration, message.angular_velocity
        rate = float(turn.x), float(turn.y), float(turn.z)
        measured = float(message.angular_velocity_covariance[0]) != -1.0
        variance = max(float(message.linear_acceleration_covariance[at]) for at in (0, 4, 8))
        return ImuReading(
            stamp_ns=nanoseconds(message.header.stamp),
            x=float(force.x),
            y=float(force.y),
            z=float(force.z),
            frame_id=str(message.header.frame_id),
            known=float(message.linear_acceleration_covariance[0]) != -1.0,
            rate=rate if measured and all(map(math.isfinite, rate)) else 3 * (math.nan,),
            variance=variance if 0.0 < variance < math.inf else 0.0,
        )


def imu_message(
    stamp_ns: int, row: Array, frame_id: str, types: MessageTypes, std: float = 0.0
) -> Any:
    """Build an Imu of a specific force (m/s^2) and a rate about z (rad/s, NaN: none), (4,).

    std (m/s^2): one sigma of each component of the force, 0 = unknown.
    """
    vector, quaternion = types('geometry_msgs/msg/Vector3'), types('geometry_msgs/msg/Quaternion')
    x, y, z, rate = map(float, row)
    unknown, known = np.zeros(9), np.zeros(9)
    unknown[0] = -1.0
    turns = math.isfinite(rate)
    return types(IMU_TYPE)(
        header=header(stamp_ns, frame_id, types),
        orientation=quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=vector(x=0.0, y=0.0, z=rate if turns else 0.0),
        angular_velocity_covariance=known if turns else unknown,
        linear_acceleration=vector(x=x, y=y, z=z),
        linear_acceleration_covariance=std**2 * np.eye(3).ravel(),
    )


def decode_frames(message: Any, *, fixed: bool) -> tuple[FrameReading, ...]:
    """Return the rotations of frames in a TFMessage; MessageError if invalid.

    fixed: whether the message is from /tf_static.
    """
    with usable(TRANSFORM_TYPE):
        return tuple(
            FrameReading(
                stamp_ns=nanoseconds(one.header.stamp),
                frame_id=str(one.child_frame_id).lstrip('/'),
                parent=str(one.header.frame_id).lstrip('/'),
                quaternion=_quaternion(one.transform.rotation),
                fixed=fixed,
            )
            for one in message.transforms
        )


def _quaternion(orientation: Any) -> Quaternion:
    x, y, z, w = (float(getattr(orientation, name)) for name in 'xyzw')
    return x, y, z, w

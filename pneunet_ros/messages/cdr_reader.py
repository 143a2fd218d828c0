"""Fast CDR decoding of live sensor messages: a header, then numbers.

Results have only the fields in use. Only plain little-endian CDR is supported, which every
middleware writes on common computers; None means an unexpected type or layout, which is left to
the ROS deserializer.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
from types import SimpleNamespace
from typing import Any

from pneunet_ros.messages.base_frames import IMU_TYPE
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE

LITTLE_ENDIAN = b'\x00\x01'  # beginning of the encapsulation
PADDING = 3  # bytes of padding that may follow
BODY = 4  # bytes of encapsulation; fields are aligned from there
HEADER = struct.Struct('<iII')  # stamp, and the size of the frame's name
NUMBER = 8  # bytes


def vector(x: float, y: float, z: float) -> Any:
    """Return a Vector3."""
    return SimpleNamespace(x=x, y=y, z=z)


# The count of numbers (float64) of a type, and the fields that they are.
FIELDS: dict[str, tuple[int, Callable[[tuple[float, ...]], dict[str, Any]]]] = {
    PRESSURE_TYPE: (2, lambda given: {'fluid_pressure': given[0], 'variance': given[1]}),
    WRENCH_TYPE: (
        6,
        lambda given: {
            'wrench': SimpleNamespace(force=vector(*given[:3]), torque=vector(*given[3:]))
        },
    ),
    # Orientation and angular velocity precede the specific force, each with its covariance.
    IMU_TYPE: (
        37,
        lambda given: {
            'angular_velocity': vector(*given[13:16]),
            'angular_velocity_covariance': given[16:25],
            'linear_acceleration': vector(*given[25:28]),
            'linear_acceleration_covariance': given[28:],
        },
    ),
}


def read_message(raw: bytes, type_name: str) -> Any | None:
    """Read a message if its type is supported here; return None if not."""
    if type_name not in FIELDS or raw[:2] != LITTLE_ENDIAN:
        return None
    count, fields = FIELDS[type_name]
    try:
        seconds, rest, size = HEADER.unpack_from(raw, BODY)
        begin = BODY + HEADER.size
        end = begin + size
        frame_id, place = raw[begin : end - 1].decode(), end + (BODY - end) % NUMBER
        numbers = struct.unpack_from(f'<{count}d', raw, place)
    except (ValueError, struct.error):  # invalid text raises a ValueError
        return None
    last = place + count * NUMBER
    if not size or raw[end - 1] or len(raw) > last + PADDING:
        return None
    stamp = SimpleNamespace(sec=seconds, nanosec=rest)
    header = SimpleNamespace(stamp=stamp, frame_id=frame_id)
    return SimpleNamespace(header=header, **fields(numbers))

"""Fast CDR decoding of sensor messages, limited to the fields in use.

Results have only these fields of the message. Only plain little-endian CDR is supported, which
every middleware writes on common computers; None means an unexpected type or layout, which the ROS
deserializer then handles.
"""

from __future__ import annotations

from collections.abc import Callable
import struct
from types import SimpleNamespace
from typing import Any

from pneunet_ros.messages.base_frames import IMU_TYPE
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE

LITTLE_ENDIAN = b'\x00\x01'  # beginning of the encapsulation
PADDING = 3  # bytes of padding that may follow
BODY = 4  # bytes of encapsulation; fields are aligned from there
TIME, LENGTH = struct.Struct('<iI'), struct.Struct('<I')
TWO, SIX = struct.Struct('<2d'), struct.Struct('<6d')
IMU = struct.Struct('<37d')  # 4 + 9, 3 + 9, 3 + 9: each with its covariance
LAYOUT, SHAPE = struct.Struct('<IBxxxI'), struct.Struct('<II')


def read_pressure(raw: bytes) -> tuple[Any, int]:
    """Read a FluidPressure."""
    header, end = read_header(raw)
    place = aligned(end, 8)
    pressure, variance = TWO.unpack_from(raw, place)
    message = SimpleNamespace(header=header, fluid_pressure=pressure, variance=variance)
    return message, place + TWO.size


def read_wrench(raw: bytes) -> tuple[Any, int]:
    """Read a WrenchStamped."""
    header, end = read_header(raw)
    place = aligned(end, 8)
    numbers = SIX.unpack_from(raw, place)
    force, torque = vector(*numbers[:3]), vector(*numbers[3:])
    message = SimpleNamespace(header=header, wrench=SimpleNamespace(force=force, torque=torque))
    return message, place + SIX.size


def read_imu(raw: bytes) -> tuple[Any, int]:
    """Read the specific force of an Imu, which follows orientation and angular velocity."""
    header, end = read_header(raw)
    place = aligned(end, 8)
    numbers = IMU.unpack_from(raw, place)
    message = SimpleNamespace(
        header=header,
        linear_acceleration=vector(*numbers[25:28]),
        linear_acceleration_covariance=numbers[28:],
    )
    return message, place + IMU.size


def read_points(raw: bytes) -> tuple[Any, int]:
    """Read a PointCloud2."""
    header, end = read_header(raw)
    place = aligned(end, 4)
    height, width = SHAPE.unpack_from(raw, place)
    (count,) = LENGTH.unpack_from(raw, place + 8)
    place += 12
    fields = []
    for _ in range(count):
        name, end = read_text(raw, aligned(place, 4))
        place = aligned(end, 4)
        offset, datatype, number = LAYOUT.unpack_from(raw, place)
        place += LAYOUT.size
        fields.append(SimpleNamespace(name=name, offset=offset, datatype=datatype, count=number))
    is_bigendian = raw[place]
    place = aligned(place + 1, 4)
    point_step, row_step = SHAPE.unpack_from(raw, place)
    (size,) = LENGTH.unpack_from(raw, place + 8)
    begin = place + 12
    message = SimpleNamespace(
        header=header,
        height=height,
        width=width,
        fields=fields,
        is_bigendian=bool(is_bigendian),
        point_step=point_step,
        row_step=row_step,
        data=memoryview(raw)[begin : begin + size],
    )
    return message, begin + size + 1  # is_dense is not read


READERS: dict[str, Callable[[bytes], tuple[Any, int]]] = {
    PRESSURE_TYPE: read_pressure,
    WRENCH_TYPE: read_wrench,
    IMU_TYPE: read_imu,
    POINTS_TYPE: read_points,
}


def read_message(raw: bytes, type_name: str) -> Any | None:
    """Read a message if its type is supported here; return None if not."""
    reader = READERS.get(type_name)
    if reader is None or raw[:2] != LITTLE_ENDIAN:
        return None
    try:
        message, end = reader(raw)
    except (ValueError, IndexError, struct.error):  # invalid text raises a ValueError
        return None
    return message if end <= len(raw) <= end + PADDING else None


def read_header(raw: bytes) -> tuple[Any, int]:
    """Read a header; also returns its end offset."""
    seconds, rest = TIME.unpack_from(raw, BODY)
    frame_id, end = read_text(raw, BODY + TIME.size)
    stamp = SimpleNamespace(sec=seconds, nanosec=rest)
    return SimpleNamespace(stamp=stamp, frame_id=frame_id), end


def read_text(raw: bytes, place: int) -> tuple[str, int]:
    """Read a zero-terminated text; also returns its end offset."""
    (size,) = LENGTH.unpack_from(raw, place)
    begin = place + LENGTH.size
    end = begin + size
    if not size or end > len(raw) or raw[end - 1]:
        raise ValueError('a string is not terminated')
    return raw[begin : end - 1].decode(), end


def aligned(place: int, size: int) -> int:
    """Return the next offset aligned to this many bytes."""
    return place + (BODY - place) % size


def vector(x: float, y: float, z: float) -> Any:
    """Return a Vector3."""
    return SimpleNamespace(x=x, y=y, z=z)

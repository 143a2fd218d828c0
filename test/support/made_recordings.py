"""Recordings made on the spot, for tests of what reads and writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.recordings.message_store import jazzy, ROSBAGS_TYPES, serialize
from pneunet_ros.recordings.recording_writer import write_recording

PRESSURE, WRENCH = '/pneunet/pressure', '/pneunet/end_wrench'
STEP_NS = 10_000_000


def header(stamp_ns: int, frame_id: str = 'pneunet_base') -> Any:
    """Return a Header with this stamp."""
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    stamp = ROSBAGS_TYPES('builtin_interfaces/msg/Time')(sec=seconds, nanosec=nanoseconds)
    return ROSBAGS_TYPES('std_msgs/msg/Header')(stamp=stamp, frame_id=frame_id)


def pressure(stamp_ns: int, value: float = 31e3) -> Any:
    """Return a FluidPressure."""
    return ROSBAGS_TYPES(PRESSURE_TYPE)(
        header=header(stamp_ns), fluid_pressure=value, variance=0.0
    )


def wrench(stamp_ns: int, value: float = 0.175) -> Any:
    """Return a WrenchStamped with a force along x."""
    vector = ROSBAGS_TYPES('geometry_msgs/msg/Vector3')
    return ROSBAGS_TYPES(WRENCH_TYPE)(
        header=header(stamp_ns),
        wrench=ROSBAGS_TYPES('geometry_msgs/msg/Wrench')(
            force=vector(x=value, y=0.0, z=0.0), torque=vector(x=0.0, y=0.0, z=0.0)
        ),
    )


def write_readings(path: Path, count: int = 100, pressure_topic: str = PRESSURE) -> Path:
    """Write pressure and, at the same log times, wrench; the pressure first, to be put right."""
    with write_recording(path) as writer:
        pressures = writer.add(pressure_topic, PRESSURE_TYPE)
        wrenches = writer.add(WRENCH, WRENCH_TYPE)
        for index in range(count):
            stamp = index * STEP_NS
            writer.write(pressures, stamp, pressure(stamp, float(index)))
            writer.write(wrenches, stamp, wrench(stamp, float(index)))
    return path


def write_by_mcap(path: Path, log_times: list[int], **options: Any) -> Path:
    """Write pressures at these log times by mcap's own writer, whose options shape the file.

    Their values are 0, 1, ... in the order of the file.
    """
    options = {'compression': CompressionType.NONE, 'chunk_size': 1000} | options
    with path.open('wb') as stream:
        writer = Writer(stream, **options)
        writer.start('ros2')
        definition, _ = jazzy().generate_msgdef(PRESSURE_TYPE, ros_version=2)
        schema = writer.register_schema(PRESSURE_TYPE, 'ros2msg', definition.encode())
        channel = writer.register_channel(PRESSURE, 'cdr', schema)
        for index, log_time in enumerate(log_times):
            # A header holds its seconds in 32 bits, whatever the log time.
            raw = serialize(pressure(min(log_time, 10**18), float(index)), PRESSURE_TYPE)
            writer.add_message(channel, log_time, raw, log_time)
        writer.finish()
    return path

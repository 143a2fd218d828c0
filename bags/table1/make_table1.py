"""Make the recording of Table 1: pressure and end load as if held and ramped in the laboratory.

The 15 rows are the paper's; all else (see README.md) is ours. Every run makes the same bytes:

    python bags/table1/make_table1.py
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import os
from pathlib import Path
import tempfile
from typing import Any

from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, PASCALS_PER_KILOPASCAL
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.recordings.bag_folder import METADATA
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording

# Pressure (kPa), F_A along x and F_B along y (N): de Payrebrune & O'Reilly 2016, Table 1.
TABLE_1 = (
    (0.0, 0.25, 0.0),
    (5.0, 0.25, 0.0),
    (10.5, 0.225, 0.0),
    (17.2, 0.2, 0.025),
    (24.2, 0.2, 0.05),
    (31.0, 0.175, 0.07),
    (37.1, 0.16, 0.1),
    (44.9, 0.15, 0.125),
    (51.5, 0.15, 0.175),
    (53.8, 0.15, 0.2),
    (56.6, 0.15, 0.2),
    (58.2, 0.15, 0.225),
    (61.3, 0.15, 0.25),
    (63.6, 0.15, 0.26),
    (66.0, 0.15, 0.275),
)
# The order in which the rows are held: up to the last one and back down to the first.
ORDER = (*range(len(TABLE_1)), *reversed(range(len(TABLE_1) - 1)))

NAME = 'table1'
PRESSURE_TOPIC, WRENCH_TOPIC = '/pneunet/pressure', '/pneunet/end_wrench'
PRESSURE_FRAME = 'pressure_sensor'
START_NS = NANOSECONDS_PER_SECOND
PERIOD_NS = NANOSECONDS_PER_SECOND // 20
HOLD_STEPS = 40  # 2 s
RAMP_STEPS = 20  # 1 s


def holds() -> Iterator[tuple[int, int, int]]:
    """Yield row (0 to 14) of every hold, its first and its last stamp in ns."""
    for place, row in enumerate(ORDER):
        start = START_NS + place * (HOLD_STEPS + RAMP_STEPS) * PERIOD_NS
        yield row, start, start + HOLD_STEPS * PERIOD_NS


def readings() -> Iterator[tuple[int, float, float, float]]:
    """Yield stamp (ns), pressure (Pa), force along x and along y (N)."""
    stamp = START_NS
    for place, row in enumerate(ORDER):
        for _ in range(HOLD_STEPS + 1):
            yield (stamp, *in_si(TABLE_1[row]))
            stamp += PERIOD_NS
        for next_row in ORDER[place + 1 : place + 2]:
            low, high = in_si(TABLE_1[row]), in_si(TABLE_1[next_row])
            for step in range(1, RAMP_STEPS):
                share = step / RAMP_STEPS
                yield (stamp, *(a + share * (b - a) for a, b in zip(low, high, strict=True)))
                stamp += PERIOD_NS


def in_si(row: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a row with its pressure in Pa."""
    return row[0] * PASCALS_PER_KILOPASCAL, row[1], row[2]


def header(stamp_ns: int, frame_id: str) -> Any:
    """Return a Header with this stamp."""
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS_PER_SECOND)
    stamp = ROSBAGS_TYPES('builtin_interfaces/msg/Time')(sec=seconds, nanosec=nanoseconds)
    return ROSBAGS_TYPES('std_msgs/msg/Header')(stamp=stamp, frame_id=frame_id)


def pressure_message(stamp_ns: int, pressure: float) -> Any:
    """Return a FluidPressure of unknown variance."""
    return ROSBAGS_TYPES(PRESSURE_TYPE)(
        header=header(stamp_ns, PRESSURE_FRAME), fluid_pressure=pressure, variance=0.0
    )


def wrench_message(stamp_ns: int, force_x: float, force_y: float) -> Any:
    """Return a WrenchStamped without moment."""
    vector = ROSBAGS_TYPES('geometry_msgs/msg/Vector3')
    wrench = ROSBAGS_TYPES('geometry_msgs/msg/Wrench')(
        force=vector(x=force_x, y=force_y, z=0.0), torque=vector(x=0.0, y=0.0, z=0.0)
    )
    return ROSBAGS_TYPES(WRENCH_TYPE)(header=header(stamp_ns, BASE_FRAME), wrench=wrench)


def make(folder: Path) -> None:
    """Write the recording as a rosbag2 folder, which must not exist yet."""
    with write_recording(folder) as writer:
        pressures = writer.add(PRESSURE_TOPIC, PRESSURE_TYPE)
        wrenches = writer.add(WRENCH_TOPIC, WRENCH_TYPE)
        for stamp, pressure, force_x, force_y in readings():
            # The load first: a reading of pressure is answered with the load known by then.
            writer.write(wrenches, stamp, wrench_message(stamp, force_x, force_y))
            writer.write(pressures, stamp, pressure_message(stamp, pressure))


def main() -> None:
    """Make the recording beside this script, or where the command line says."""
    parser = argparse.ArgumentParser(description='Make the recording of Table 1.')
    parser.add_argument('--output', type=Path, default=Path(__file__).resolve().parent)
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    # This folder also holds the script and its README, which stay.
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        made = Path(scratch) / NAME
        make(made)
        for file in (f'{NAME}.mcap', METADATA):
            os.replace(made / file, folder / file)


if __name__ == '__main__':
    main()

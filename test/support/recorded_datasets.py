"""Small recordings of pressure, end wrench and targets, made on the spot and bent for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.readings import (
    pressure_message,
    PRESSURE_TYPE,
    targets_message,
    TIP_POSE,
    wrench_message,
    WRENCH_TYPE,
)
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording

BASE = 'pneunet_base'
START = 1_000_000_000_000
MS = 1_000_000
SPACING = 0.02  # m between the targets
TYPES = {
    'pressure': PRESSURE_TYPE,
    'end_wrench': WRENCH_TYPE,
    'targets': POINTS_TYPE,
    'tip_pose': TIP_POSE.type,
}


def pressure(stamp_ns: int, value: float) -> Any:
    return pressure_message(stamp_ns, [value], BASE, ROSBAGS_TYPES)


def wrench(stamp_ns: int, force: tuple[float, float], frame_id: str = BASE) -> Any:
    return wrench_message(stamp_ns, [*force, 1e-3], frame_id, ROSBAGS_TYPES)


def targets(stamp_ns: int, height: float, count: int = 3, frame_id: str = BASE) -> Any:
    """Return targets in a row that rises to `height`; NaN: none was seen."""
    x = SPACING * np.arange(count)
    return targets_message(stamp_ns, x, x / x[-1] * height, frame_id, ROSBAGS_TYPES)


def readings(count: int = 20, loaded: bool = True) -> list[tuple[str, int, Any]]:
    """Return (name, log time, message): pressure and wrench each 10 ms, targets each 20 ms.

    Pressure is 100 Pa times its index, the force 0.01 N times it, the height 1 mm times the index
    of the frame. Frames are 2 ms late, logged 5 ms late.
    """
    said: list[tuple[str, int, Any]] = []
    for index in range(count):
        stamp = START + 10 * index * MS
        said.append(('pressure', stamp, pressure(stamp, 100.0 * index)))
        if loaded:
            said.append(('end_wrench', stamp, wrench(stamp + MS, (0.01 * index, -0.01 * index))))
        if index % 2 == 0:
            cloud = targets(stamp + 2 * MS, 0.001 * (index // 2))
            said.append(('targets', stamp + 5 * MS, cloud))
    return said


def record(path: Path, said: Sequence[tuple[str, int, Any]], namespace: str = '/pneunet') -> Path:
    """Write messages given by the last name of their topic."""
    with write_recording(path) as writer:
        names = dict.fromkeys(name for name, _, _ in said)
        topics = {name: writer.add(f'{namespace}/{name}', TYPES[name]) for name in names}
        for name, log_time, message in said:
            writer.write(topics[name], log_time, message)
    return path

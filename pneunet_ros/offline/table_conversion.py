"""Series of a recording to a table of readings, and back."""

from __future__ import annotations

from collections.abc import Mapping
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.messages.readings import (
    pressure_message,
    targets_message,
    TARGETS_NAME,
    wrench_message,
)
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recorded_series import Series, SERIES_TYPES
from pneunet_ros.recordings.recording_writer import RecordingWriter
from pneunet_ros.tables.reading_table import ReadingTable

NAMESPACE = '/pneunet'


def tabulate(series: Mapping[str, Series], more: npt.ArrayLike = ()) -> ReadingTable:
    """Return the table of these series: a row for every stamp of any, and for those in `more`."""
    stamps = [np.asarray(more, dtype=np.int64), *(one.stamp_ns for one in series.values())]
    stamp_ns = np.unique(np.concatenate(stamps))
    frames = series.get(TARGETS_NAME)
    targets = 0 if frames is None else frames.values.shape[2]
    pressure = np.full((len(stamp_ns), 1), math.nan)
    wrench = np.full((len(stamp_ns), 3), math.nan)
    places = np.full((len(stamp_ns), 2, targets), math.nan)
    into = {'pressure': pressure, 'end_wrench': wrench, TARGETS_NAME: places}
    for name, one in series.items():
        into[name][np.searchsorted(stamp_ns, one.stamp_ns)] = one.values
    return ReadingTable(
        stamp_ns=stamp_ns,
        pressure=pressure[:, 0],
        wrench=wrench,
        x=places[:, 0],
        y=places[:, 1],
    )


def record_table(writer: RecordingWriter, table: ReadingTable) -> dict[str, int]:
    """Write the readings of a table, each logged at its stamp; returns counts by topic."""
    counts = {f'{NAMESPACE}/{name}': count for name, count in table.counts().items() if count}
    topics = {
        name: writer.add(f'{NAMESPACE}/{name}', type_name)
        for name, type_name in SERIES_TYPES.items()
        if f'{NAMESPACE}/{name}' in counts
    }
    framed = table.framed
    for row, stamp_ns in enumerate(table.stamp_ns.tolist()):
        if 'end_wrench' in topics and np.isfinite(table.wrench[row]).all():
            force_x, force_y, moment = table.wrench[row].tolist()
            load = WrenchReading(
                stamp_ns=stamp_ns,
                force_x=force_x,
                force_y=force_y,
                moment=moment,
                frame_id=BASE_FRAME,
            )
            writer.write(topics['end_wrench'], stamp_ns, wrench_message(load, ROSBAGS_TYPES))
        if 'pressure' in topics and math.isfinite(table.pressure[row]):
            reading = PressureReading(stamp_ns=stamp_ns, pressure=float(table.pressure[row]))
            message = pressure_message(reading, BASE_FRAME, ROSBAGS_TYPES)
            writer.write(topics['pressure'], stamp_ns, message)
        if TARGETS_NAME in topics and framed[row]:
            cloud = targets_message(
                stamp_ns, table.x[row], table.y[row], BASE_FRAME, ROSBAGS_TYPES
            )
            writer.write(topics[TARGETS_NAME], stamp_ns, cloud)
    return counts

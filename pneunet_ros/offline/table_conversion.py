"""Series of a recording to a table of readings, and back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.messages.readings import SENSORS, TARGETS
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recorded_series import ReadingSeries
from pneunet_ros.recordings.recording_writer import RecordingWriter
from pneunet_ros.tables.reading_table import ReadingTable

NAMESPACE = '/pneunet'


def tabulate(series: Mapping[str, ReadingSeries], more: npt.ArrayLike = ()) -> ReadingTable:
    """Return the table of these series: a row for every stamp of any, and for those in `more`."""
    stamps = [np.asarray(more, dtype=np.int64), *(item.stamp_ns for item in series.values())]
    stamp_ns = np.unique(np.concatenate(stamps))
    targets = series[TARGETS.name].values.shape[2] if TARGETS.name in series else 0
    values = {
        sensor.name: np.full((len(stamp_ns), *sensor.row_shape(targets)), np.nan)
        for sensor in SENSORS
    }
    for name, item in series.items():
        values[name][np.searchsorted(stamp_ns, item.stamp_ns)] = item.values
    return ReadingTable(stamp_ns=stamp_ns, values=values)


def record_table(writer: RecordingWriter, table: ReadingTable) -> dict[str, int]:
    """Write the readings of a table, each logged at its stamp; returns counts by topic."""
    counts = {f'{NAMESPACE}/{name}': count for name, count in table.counts().items() if count}
    topics = {
        sensor.name: writer.add(f'{NAMESPACE}/{sensor.name}', sensor.type)
        for sensor in SENSORS
        if f'{NAMESPACE}/{sensor.name}' in counts
    }
    present = table.present()
    ranked = sorted(SENSORS, key=lambda sensor: sensor.rank)
    for row, stamp_ns in enumerate(table.stamp_ns.tolist()):
        for sensor in ranked:
            if present[sensor.name][row]:
                values = table.values[sensor.name][row]
                message = sensor.message(stamp_ns, values, BASE_FRAME, ROSBAGS_TYPES)
                writer.write(topics[sensor.name], stamp_ns, message)
    return counts

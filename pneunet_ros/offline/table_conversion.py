"""Convert series of a recording to a table of readings, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.progress import report_progress, STEP
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, SENSORS, TARGETS
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.recordings.recorded_series import ReadingSeries
from pneunet_ros.recordings.recording_writer import RecordingWriter
from pneunet_ros.tables.reading_table import ReadingTable
from rosbags.interfaces import Connection

NAMESPACE = '/pneunet'
WrittenMessage = tuple[int, Connection, bytes]  # stamp in ns, topic, serialized


def tabulate(series: Mapping[str, ReadingSeries], more: npt.ArrayLike = ()) -> ReadingTable:
    """Return the table of these series: a row for each of their stamps and each in `more`."""
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
    """Write the readings of a table, each with its stamp as log time; returns counts by topic."""
    for stamp_ns, topic, raw in table_messages(writer, table):
        writer.write_raw(topic, stamp_ns, raw)
    return {f'{NAMESPACE}/{name}': count for name, count in table.counts().items() if count}


def table_messages(
    writer: RecordingWriter, table: ReadingTable, wrench: str = END_WRENCH.name
) -> Iterator[WrittenMessage]:
    """Yield the readings of a table as messages: stamp in ns, topic, serialized bytes.

    wrench: last name of the topic for end loads.
    """
    counts, present = table.counts(), table.present()
    sensors = sorted(SENSORS, key=lambda sensor: sensor is PRESSURE)  # it triggers the estimate
    ranked = [sensor for sensor in sensors if counts[sensor.name]]
    names = {sensor.name: sensor.name for sensor in ranked} | {END_WRENCH.name: wrench}
    topics = {
        sensor.name: writer.add(f'{NAMESPACE}/{names[sensor.name]}', sensor.type)
        for sensor in ranked
    }
    for row, stamp_ns in enumerate(table.stamp_ns.tolist()):
        if row % STEP == 0:
            report_progress('writing the recording', row, len(table.stamp_ns))
        for sensor in ranked:
            if present[sensor.name][row]:
                values = table.values[sensor.name][row]
                message = sensor.message(stamp_ns, values, BASE_FRAME, ROSBAGS_TYPES)
                yield stamp_ns, topics[sensor.name], serialize(message, sensor.type)

"""Readings as a table: a row per stamp, with what was said at it; from and to recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.errors import RecordingError
from pneunet_ros.frames import BASE_FRAME
from pneunet_ros.message_store import ROSBAGS_TYPES
from pneunet_ros.reading_messages import (
    pressure_message,
    targets_message,
    TARGETS_NAME,
    wrench_message,
)
from pneunet_ros.readings import PressureReading, WrenchReading
from pneunet_ros.recorded_series import Series, SERIES_TYPES
from pneunet_ros.recording_writer import RecordingWriter
from pneunet_ros.run import Stamps
from pneunet_ros.shape import Array, frozen_array
from pneunet_ros.units import NANOSECONDS_PER_SECOND, seconds_between

NAMESPACE = '/pneunet'
LATEST_STAMP = 2**31 * NANOSECONDS_PER_SECOND  # a header holds its seconds in 32 bits


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingTable:
    """What was read at each stamp, in the words of the contract.

    stamp_ns (rows,) increases; pressure (rows,) Pa gauge and wrench (rows, 3) N, N, N m in the
    base frame are NaN where there is no reading; x and y (rows, targets) m where targets were
    seen, NaN where not. A row without any target is no frame.
    """

    stamp_ns: Stamps
    pressure: Array
    wrench: Array
    x: Array
    y: Array

    def __post_init__(self) -> None:
        """Check the shapes and the order of the stamps."""
        rows, targets = len(self.stamp_ns), np.shape(self.x)[1]
        shapes = {
            'pressure': (rows,),
            'wrench': (rows, 3),
            'x': (rows, targets),
            'y': (rows, targets),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape))
        if not np.all(np.diff(self.stamp_ns) > 0):
            raise RecordingError('the stamps of a table must increase')

    @property
    def framed(self) -> npt.NDArray[np.bool_]:
        """In which rows targets were seen, (rows,)."""
        return np.asarray((np.isfinite(self.x) & np.isfinite(self.y)).any(axis=1))

    def counts(self) -> dict[str, int]:
        """Return how many readings there are, by the names of their topics."""
        return {
            'pressure': int(np.count_nonzero(np.isfinite(self.pressure))),
            'end_wrench': int(np.count_nonzero(np.isfinite(self.wrench).all(axis=1))),
            TARGETS_NAME: int(np.count_nonzero(self.framed)),
        }


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


def columns(table: ReadingTable) -> dict[str, npt.NDArray[np.generic]]:
    """Return the columns of a table by names that `import` knows; time counts from its start.

    What was never read has no column.
    """
    start = int(table.stamp_ns[0]) if len(table.stamp_ns) else 0
    seconds = [seconds_between(start, stamp) for stamp in table.stamp_ns.tolist()]
    found: dict[str, npt.NDArray[np.generic]] = {
        'stamp_ns': table.stamp_ns,
        'time_s': np.array(seconds),
    }
    counts = table.counts()
    if counts['pressure']:
        found['pressure_pa'] = table.pressure
    if counts['end_wrench']:
        for place, name in enumerate(('force_x_n', 'force_y_n', 'moment_n_m')):
            found[name] = table.wrench[:, place]
    for target in range(table.x.shape[1]):
        found[f'x{target}_m'] = table.x[:, target]
        found[f'y{target}_m'] = table.y[:, target]
    return found


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

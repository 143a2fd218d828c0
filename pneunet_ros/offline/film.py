"""Merge a tracked film and a table of readings, on two clocks, into one recording.

The recording uses the clock of the table. The two clocks start at the first frame and at the first
row. The frame at t in the film shows the arm at t - delay in the table.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
import heapq
from operator import itemgetter
from pathlib import Path

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.estimation.clock_delay import ClockDelay, estimate_delay
from pneunet_ros.measurement.string_load import tips_of
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, STRING_WRENCH, TARGETS, TIP_POSE
from pneunet_ros.messages.tracker import outputs_of, TRACKER_OUTPUTS
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.string import radius_of, String
from pneunet_ros.offline.table_conversion import NAMESPACE, table_messages, WrittenMessage
from pneunet_ros.recordings.recording_writer import OutputTopics, RecordingWriter
from pneunet_ros.tables.reading_table import ReadingTable
from pneunet_ros.tables.table_reader import FIRST_STAMP
from pneunet_ros.vision.tracker import Tracking


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilmedRun:
    """Frames and readings on one clock: tracked frames in order, and the table of readings.

    wrench: name of the topic for its end loads; rejected: stamps of unreadable frames.
    """

    trackings: tuple[Tracking, ...]
    table: ReadingTable
    wrench: str = END_WRENCH.name
    rejected: tuple[int, ...] = ()

    @property
    def covered(self) -> int:
        """Number of frames within the time span of the table."""
        stamps = np.array([frame.sightings.stamp_ns for frame in self.trackings])
        first, last = self.table.stamp_ns[[0, -1]]
        return int(np.count_nonzero((stamps >= first) & (stamps <= last)))


def check_readings(table: ReadingTable, path: Path) -> None:
    """Reject a table that cannot be combined with a film."""
    counts = table.counts()
    if not counts[PRESSURE.name]:
        raise RequestError(
            f'--readings {path} has no pressure: add a column such as pressure_kpa',
            reason='no_pressure',
        )
    for sensor in (TARGETS, TIP_POSE):
        if counts[sensor.name]:
            raise RequestError(
                f'--readings {path} holds {sensor.name}, which are measured in the film: leave '
                'these columns out with --ignore COLUMN',
                reason='given_twice',
            )


def check_no_forces(table: ReadingTable, option: str) -> None:
    """Reject a load option if the table has force readings."""
    if table.counts()[END_WRENCH.name]:
        raise RequestError(
            f'{option} is only for tables without forces, but this table has force columns',
            reason='exclusive',
        )


def with_end_load(table: ReadingTable, force_x: float, force_y: float) -> ReadingTable:
    """Add a known constant end load (N, base frame) to a table without loads."""
    check_no_forces(table, '--end-load')
    load = np.tile([force_x, force_y, 0.0], (len(table.stamp_ns), 1))
    return replace(table, values={**table.values, END_WRENCH.name: load})


def delay_of(trackings: Sequence[Tracking], table: ReadingTable) -> ClockDelay:
    """Estimate the delay of the film's clock relative to the table's."""
    sightings = [tracking.sightings for tracking in trackings]
    read = table.present()[PRESSURE.name]
    time = _seconds(table.stamp_ns - table.stamp_ns[0])
    drive = [table.values[PRESSURE.name][read, 0]]
    loaded = table.present()[END_WRENCH.name]
    if loaded.any():
        forces = table.values[END_WRENCH.name][loaded, :2]
        drive += [np.interp(time[read], time[loaded], force) for force in forces.T]
    return estimate_delay(
        _seconds(np.array([frame.stamp_ns for frame in sightings]) - 1),
        np.array([np.concatenate([frame.x, frame.y]) for frame in sightings]),
        time[read],
        np.column_stack(drive),
    )


def _seconds(nanoseconds: Array) -> Array:
    return np.asarray(nanoseconds / NANOSECONDS_PER_SECOND)


def join_clocks(
    trackings: Iterable[Tracking], table: ReadingTable, delay: float, rejected: Iterable[int]
) -> FilmedRun:
    """Convert frames and readings to the clock of the table.

    If the film begins before a table that starts at zero, both are shifted so that no stamp is
    zero.
    """
    trackings = tuple(trackings)
    start = int(table.stamp_ns[0]) - 1 - round(delay * NANOSECONDS_PER_SECOND)
    first = min(start + trackings[0].sightings.stamp_ns, int(table.stamp_ns[0]))
    shift = max(0, FIRST_STAMP - first)
    return FilmedRun(
        trackings=tuple(_shifted(tracking, start + shift) for tracking in trackings),
        table=replace(table, stamp_ns=table.stamp_ns + shift),
        rejected=tuple(stamp + start + shift for stamp in rejected),
    )


def _shifted(tracking: Tracking, by_ns: int) -> Tracking:
    sightings, curve = tracking.sightings, tracking.curve
    return replace(
        tracking,
        sightings=replace(sightings, stamp_ns=sightings.stamp_ns + by_ns),
        curve=None if curve is None else replace(curve, stamp_ns=curve.stamp_ns + by_ns),
    )


def with_string(run: FilmedRun, string: String, arm: Arm) -> FilmedRun:
    """Return a film with a string at the tip: the load in each row follows the tip.

    The load is known between two successive frames that show the tip. Raises RequestError if no
    frame shows it, or if the eye of the string lies on the arm.
    """
    sightings = [frame.sightings for frame in run.trackings]
    points = np.array([[frame.x, frame.y] for frame in sightings])
    string.check_clearance(points[:, 0], points[:, 1], radius_of(arm))
    tips = tips_of(points, arm)
    if not np.isfinite(tips).all(axis=1).any():
        raise RequestError(
            '--string: no frame of the film shows the tip, to which the string is tied',
            reason='no_tip',
        )
    start = run.table.stamp_ns[0]
    found = np.array([frame.stamp_ns for frame in sightings])
    lost = np.setdiff1d(np.array(run.rejected, np.int64), found)
    frames = np.concatenate([found, lost]) - start
    tips = np.concatenate([tips, np.full((lost.size, 2), np.nan)])[np.argsort(frames)]
    frames.sort()
    rows = run.table.stamp_ns - start
    tip_positions = np.column_stack(
        [np.interp(rows, frames, part, left=np.nan, right=np.nan) for part in tips.T]
    )
    load = np.column_stack([string.pull(tip_positions), np.zeros(len(tip_positions))])
    table = replace(run.table, values={**run.table.values, END_WRENCH.name: load})
    return replace(run, table=table, wrench=STRING_WRENCH.name)


def record_film(writer: RecordingWriter, run: FilmedRun) -> None:
    """Write frames and readings in chronological order."""
    messages = (
        table_messages(writer, run.table, run.wrench),
        _frame_messages(writer, run.trackings),
    )
    for stamp_ns, topic, raw in heapq.merge(*messages, key=itemgetter(0)):
        writer.write_raw(topic, stamp_ns, raw)


def _frame_messages(
    writer: RecordingWriter, trackings: Iterable[Tracking]
) -> Iterator[WrittenMessage]:
    names = {f'{NAMESPACE}/{output.name}': output for output in TRACKER_OUTPUTS}
    topics = OutputTopics(writer, names, BASE_FRAME)
    for tracking in trackings:
        for topic, raw in topics.messages(outputs_of(tracking)):
            yield tracking.sightings.stamp_ns, topic, raw

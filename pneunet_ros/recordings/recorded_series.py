"""Topics of a recording as columns: stamps and numbers of pressure, end load and targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, LARGEST
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import AHEAD, match_stamps, RESTARTED, StampGate, Stamps
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.messages.builders import IMAGE_TYPE, Input, UNREADABLE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.readings import (
    END_WRENCH,
    PRESSURE,
    Sensor,
    SENSORS,
    TARGETS,
    UnusableTopic,
)
from pneunet_ros.recordings.recording import Recording

REASONS = {
    UNREADABLE: 'not readable',
    'not_finite': f'NaN, infinite or beyond {LARGEST:g}',
    'no_stamp': 'without a header stamp',
    'duplicate': 'with the same stamp as the previous one',
    'older': 'older than the previous one',
    AHEAD: 'with a stamp in the future',
    RESTARTED: 'on the other side of a jump back in time',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingSeries:
    """The usable readings of a sensor: increasing stamps (readings,), and a row for each.

    values (readings, *sensor.row_shape): pressure (readings, 1) Pa gauge; end_wrench (readings, 3)
    N, N, N m in the base frame; targets (readings, 2, targets) m, NaN where not seen; tip_pose
    (readings, 3) m, m, rad, NaN where not measured. `left_out` counts the dropped readings by
    reason.
    """

    sensor: Sensor[Any]
    topic: str
    stamp_ns: Stamps
    values: Array
    left_out: Mapping[str, int]

    @property
    def period(self) -> float:
        """Median time (s) from one reading to the next; NaN for less than two."""
        if len(self.stamp_ns) < 2:
            return math.nan
        return float(np.median(np.diff(self.stamp_ns))) * 1e-9

    def sentences(self) -> tuple[Note, ...]:
        """Describe the number of dropped readings, and the reasons."""
        return tuple(
            Note(
                f'{self.topic}: {count} {self.sensor.label}{"" if count == 1 else "s"} dropped, '
                f'{REASONS[reason]}',
                reason=reason,
            )
            for reason, count in self.left_out.items()
        )


def find_series(
    recording: Recording,
    sensor: Input[Any],
    overrides: Mapping[str, str],
    *,
    required: bool = True,
) -> str | None:
    """Return the topic of a sensor; None if it is optional and missing.

    Raises RecordingError like `Recording.find`, with a remedy if the topic is missing.
    """
    name, override = sensor.name, overrides.get(sensor.name)
    found = recording.candidates(name, sensor.type)
    if override is None and sensor in SENSORS:
        found = without_other_arms(recording, found, overrides)
        override = found[0] if len(found) == 1 else None
    if override is None and not found:
        if not required:
            return None
        raise RecordingError(
            f'{recording.path} {without_topic(recording, sensor, overrides)}', reason='no_topic'
        )
    return recording.find(name, sensor.type, override)


def without_other_arms(
    recording: Recording, candidates: Iterable[str], overrides: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the candidates, excluding topics of other arms.

    If one of several topics is named explicitly, its namespace identifies the arm, and topics in
    the namespaces of other arms are excluded. A namespace with a single topic belongs to a sensor,
    such as a valve, not to another arm.
    """
    types = {topic.name: topic.type for topic in recording.topics}
    for name, topic in overrides.items():
        rivals = recording.candidates(name, types.get(topic, ''))
        own = topic.removesuffix(name)
        is_arm = any(one.startswith(own) and one not in rivals for one in types)
        if topic in rivals and is_arm:
            spaces = [one.removesuffix(name) for one in rivals if one != topic]
            others = tuple(one for one in spaces if not own.startswith(one))
            candidates = [
                one for one in candidates if one.startswith(own) or not one.startswith(others)
            ]
    return tuple(candidates)


def without_topic(recording: Recording, sensor: Input[Any], overrides: Mapping[str, str]) -> str:
    """Report that a recording has no topic of a sensor, with a remedy."""
    types = {topic.type for topic in recording.topics}
    of_type = [topic.name for topic in recording.topics if topic.type == sensor.type]
    same_type = without_other_arms(recording, of_type, overrides)
    if same_type:
        remedy = f'name it, e.g. --topic {sensor.name}={same_type[0]}'
    elif sensor is END_WRENCH:
        remedy = 'add --no-wrench-required if nothing was attached to the arm'
    elif sensor is TARGETS and types & {IMAGE_TYPE, COMPRESSED_TYPE}:
        remedy = (
            f'`pneunet track {recording.path} --model arm.yaml --output TRACKED.mcap` finds the '
            'targets in its images'
        )
    elif sensor is PRESSURE:
        remedy = (
            '`pneunet import TABLE.csv --output REC.mcap` turns a table of pressures into a '
            'recording'
        )
    else:
        remedy = f'record it; the recording contains {recording.contents()}'
    return f'has no topic {sensor.name} of type {sensor.type}: {remedy}'


def find_recorded(
    recording: Recording, sensors: Iterable[Input[Any]], overrides: Mapping[str, str]
) -> dict[str, str]:
    """Return the recorded topics of these sensors, full names by names."""
    found = {
        sensor.name: find_series(recording, sensor, overrides, required=False)
        for sensor in sensors
    }
    return {name: topic for name, topic in found.items() if topic is not None}


def read_series(
    recording: Recording,
    topics: Mapping[str, str],
    settings: EstimatorSettings,
    targets: int | None = None,
) -> dict[str, ReadingSeries]:
    """Read the series of these topics in one pass; topics: full names by names of SENSORS.

    targets: required number (None: that of the first message). Raises RecordingError for invalid
    targets and for readings in a wrong frame.
    """
    sensors = {topics[sensor.name]: sensor for sensor in SENSORS if sensor.name in topics}
    stamps: dict[str, list[int]] = {topic: [] for topic in sensors}
    rows: dict[str, list[Array]] = {topic: [] for topic in sensors}
    unreadable: Counter[str] = Counter()
    for message in recording.messages(tuple(topics.values())):
        sensor = sensors[message.topic]
        try:
            stamp_ns, row = sensor.read(message.message, settings, targets)
        except UnusableTopic as error:
            raise RecordingError(
                f'{recording.path}: {message.topic} at log time {message.log_time_ns} ns: {error}',
                reason='unreadable',
            ) from error
        except MessageError:
            unreadable[message.topic] += 1
            continue
        if sensor.per_target:
            targets = row.shape[1]
        stamps[message.topic].append(stamp_ns)
        rows[message.topic].append(row)
    return {
        sensor.name: _in_order(sensor, topic, stamps[topic], rows[topic], unreadable[topic])
        for topic, sensor in sensors.items()
    }


def _in_order(
    sensor: Sensor[Any], topic: str, stamps: Sequence[int], rows: Sequence[Array], unreadable: int
) -> ReadingSeries:
    """Keep the readings in sequence, by the rules of the estimator.

    If time jumps back by more than a second, the longest interval between jumps is kept.
    """
    counts: Counter[str] = Counter({UNREADABLE: unreadable} if unreadable else {})
    stretches: list[list[int]] = [[]]
    gate = StampGate()
    for index, stamp_ns in enumerate(stamps):
        if not sensor.per_target and not sensor.present(rows[index][None])[0]:
            reason = 'not_finite'
        else:
            reason, _ = gate.fault(sensor.label, stamp_ns)
        if reason == RESTARTED:
            stretches.append([])
        elif reason:
            counts[reason] += 1
        if reason == AHEAD:  # the last message was wrong, not this one
            stretches[-1].pop()
        elif reason and reason != RESTARTED:
            continue
        gate = gate.after(stamp_ns)
        stretches[-1].append(index)
    kept = max(stretches, key=len)
    jumped = sum(len(stretch) for stretch in stretches) - len(kept)
    if jumped:
        counts[RESTARTED] = jumped
    shape = rows[0].shape if rows else sensor.row_shape(0)
    return ReadingSeries(
        sensor=sensor,
        topic=topic,
        stamp_ns=np.array([stamps[index] for index in kept], dtype=np.int64),
        values=freeze(np.array([rows[index] for index in kept]).reshape(len(kept), *shape)),
        left_out=MappingProxyType(dict(counts)),
    )


def nearest(stamp_ns: Stamps, series: ReadingSeries) -> tuple[Stamps, npt.NDArray[np.bool_]]:
    """Return the index of the reading nearest to each stamp, and whether it matches.

    A reading matches within half the median period of the readings (a single reading: at the same
    stamp). The series must not be empty.
    """
    reach = 0.5e9 * (series.period if len(series.stamp_ns) > 1 else 0.0)
    return match_stamps(stamp_ns, series.stamp_ns, reach)

"""Topics of a recording as columns: stamps and numbers of pressure, end load and targets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.stamps import match_stamps, stamp_fault, Stamps, STARTS_ANEW
from pneunet_ros.estimation.sensor_mapping import base_wrench, gauge_pressure, wrong_frame
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.messages.builders import POINTS_TYPE, UNREADABLE
from pneunet_ros.messages.readings import decode_targets, TARGETS_NAME
from pneunet_ros.messages.topics import decode_pressure, decode_wrench, PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.recordings.recording import Recording

# What may be read as a series: type by last name, in the words of the contract.
SERIES_TYPES = {'pressure': PRESSURE_TYPE, 'end_wrench': WRENCH_TYPE, TARGETS_NAME: POINTS_TYPE}
WHAT = {'pressure': 'pressure reading', 'end_wrench': 'end wrench', TARGETS_NAME: 'frame'}
REASONS = {
    UNREADABLE: 'not readable',
    'not_finite': 'NaN or infinite',
    'no_stamp': 'without a header stamp',
    'duplicate': 'with the stamp of the one before',
    'older': 'older than the one before',
    STARTS_ANEW: 'on the other side of a jump back in time',
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """The usable readings of a topic: stamps (readings,) that increase, and a row for each.

    values: pressure (readings, 1) Pa gauge; end_wrench (readings, 3) N, N, N m in the base frame;
    targets (readings, 2, targets) m, NaN where not seen. `left_out` counts the rest by reason.
    """

    name: str
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

    def sentences(self) -> tuple[str, ...]:
        """Say how many readings were left out, and why."""
        return tuple(
            f'{self.topic}: {count} {WHAT[self.name]}{"" if count == 1 else "s"} left out, '
            f'{REASONS[reason]}'
            for reason, count in self.left_out.items()
        )


def find_series(
    recording: Recording, name: str, overrides: Mapping[str, str], *, required: bool = True
) -> str | None:
    """Return the topic of a series; None where it is not required and not there.

    Raises RecordingError as `Recording.find` does.
    """
    type_name = SERIES_TYPES[name]
    if not required and name not in overrides and not recording.candidates(name, type_name):
        return None
    return recording.find(name, type_name, overrides.get(name))


def read_series(
    recording: Recording,
    topics: Mapping[str, str],
    settings: EstimatorSettings,
    targets: int | None = None,
) -> dict[str, Series]:
    """Return the series of these topics, full names by the names of SERIES_TYPES, in one pass.

    targets: how many there must be (None: as many as in the first message). Raises RecordingError
    for targets that are no targets and for readings in a wrong frame.
    """
    names = {topic: name for name, topic in topics.items()}
    stamps: dict[str, list[int]] = {name: [] for name in topics}
    rows: dict[str, list[Array]] = {name: [] for name in topics}
    unreadable: Counter[str] = Counter()
    for message in recording.messages(tuple(names)):
        name = names[message.topic]
        try:
            if name == TARGETS_NAME:
                found = decode_targets(message.message, settings.frame_id, targets)
                stamp_ns, row = found.stamp_ns, np.array([found.x, found.y])
                targets = row.shape[1]
            else:
                stamp_ns, row = _reading(name, message.message, settings)
        except MessageError as error:
            if name == TARGETS_NAME or isinstance(error, _WrongFrame):
                raise RecordingError(
                    f'{recording.path}: {message.topic} at log time {message.log_time_ns} ns: '
                    f'{error}'
                ) from error
            unreadable[name] += 1
            continue
        stamps[name].append(stamp_ns)
        rows[name].append(row)
    return {
        name: _in_order(name, topic, stamps[name], rows[name], unreadable[name])
        for name, topic in topics.items()
    }


class _WrongFrame(MessageError):
    """An end wrench in a frame that is not known: so are all of its topic."""


def _reading(name: str, message: Any, settings: EstimatorSettings) -> tuple[int, Array]:
    if name == 'pressure':
        pressure = decode_pressure(message)
        return pressure.stamp_ns, np.array([gauge_pressure(settings, pressure.pressure)])
    wrench = decode_wrench(message)
    sentence = wrong_frame(settings, wrench)
    if sentence:
        raise _WrongFrame(sentence)
    load = base_wrench(settings, wrench)
    return load.stamp_ns, np.array([load.force_x, load.force_y, load.moment])


def _in_order(
    name: str, topic: str, stamps: Sequence[int], rows: Sequence[Array], unreadable: int
) -> Series:
    """Keep the readings that may follow one another, by the rules of the estimator.

    Where time jumps back by more than a second, the longest stretch between jumps is kept.
    """
    counts: Counter[str] = Counter({UNREADABLE: unreadable} if unreadable else {})
    stretches: list[list[int]] = [[]]
    for index, stamp_ns in enumerate(stamps):
        last = stamps[stretches[-1][-1]] if stretches[-1] else None
        if name != TARGETS_NAME and not np.isfinite(rows[index]).all():
            reason = 'not_finite'
        else:
            reason, _ = stamp_fault(WHAT[name], last, stamp_ns)
        if reason == STARTS_ANEW:
            stretches.append([])
        elif reason:
            counts[reason] += 1
            continue
        stretches[-1].append(index)
    kept = max(stretches, key=len)
    jumped = sum(len(stretch) for stretch in stretches) - len(kept)
    if jumped:
        counts[STARTS_ANEW] = jumped
    shape = rows[0].shape if rows else {'pressure': (1,), 'end_wrench': (3,)}.get(name, (2, 0))
    return Series(
        name=name,
        topic=topic,
        stamp_ns=np.array([stamps[index] for index in kept], dtype=np.int64),
        values=freeze(np.array([rows[index] for index in kept]).reshape(len(kept), *shape)),
        left_out=MappingProxyType(dict(counts)),
    )


def nearest(stamp_ns: Stamps, series: Series) -> tuple[Stamps, npt.NDArray[np.bool_]]:
    """Return the index of the nearest reading to each stamp, and whether it belongs to it.

    It does within half the median period of the readings (one reading alone: with the very stamp).
    The series must not be empty.
    """
    reach = 0.5e9 * (series.period if len(series.stamp_ns) > 1 else 0.0)
    return match_stamps(stamp_ns, series.stamp_ns, reach)

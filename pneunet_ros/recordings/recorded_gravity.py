"""Direction of gravity in a recording, processed as in the estimator."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.outcome import drop, Refusal
from pneunet_ros.core.readings import FrameReading
from pneunet_ros.core.stamps import match_stamps, RESTARTED, stamp_fault, Stamps
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.estimation.base_gravity import BaseGravity, Direction, GravitySource
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.between_readings import interpolate
from pneunet_ros.messages.builders import UNREADABLE
from pneunet_ros.messages.readings import BASE_IMU, FIXED_FRAMES, gravity_inputs
from pneunet_ros.model.gravity import Gravity
from pneunet_ros.recordings.recorded_series import find_recorded, find_series
from pneunet_ros.recordings.recording import Recording


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedGravity:
    """Gravity in the base frame, in g: increasing stamps (n,), and x, y (n, 2).

    reach (s): how long a reading is valid; sentences: notes on omitted readings.
    """

    stamp_ns: Stamps
    direction: Array
    reach: float
    sentences: tuple[str, ...]

    def is_known(self, stamp_ns: Stamps) -> npt.NDArray[np.bool_]:
        """Return a mask of the stamps (ns) at which gravity is known."""
        return match_stamps(stamp_ns, self.stamp_ns, self.reach * NANOSECONDS_PER_SECOND)[1]

    def at(self, stamp_ns: Stamps) -> Array:
        """Interpolate gravity linearly at stamps (n,) ns; returns (n, 2)."""
        columns = self.direction.T
        return np.column_stack([interpolate(stamp_ns, self.stamp_ns, one) for one in columns])


def with_imu_mounting(
    recording: Recording, overrides: Mapping[str, str], settings: EstimatorSettings
) -> EstimatorSettings:
    """Return settings with the mounting of the accelerometer, if the recording gives it.

    The mounting is read from /tf_static, unless the settings or its frame define it.
    """
    topic = find_series(recording, BASE_IMU, overrides, required=False)
    fixed = find_series(recording, FIXED_FRAMES, overrides, required=False)
    if topic is None or fixed is None or settings.imu_from_base:
        return settings
    source = GravitySource(settings=settings, gravity=Gravity())
    known, turn = BaseGravity(), None
    with suppress(MessageError):  # undecodable messages are counted by `read_gravity`
        for message in recording.messages([fixed]):
            known, _ = source.take_frames(known, FIXED_FRAMES.decode(message.message))
        for message in recording.messages([topic]):
            turn = source.turn_of_imu(known.frames, BASE_IMU.decode(message.message).frame_id)
            break
    return settings if turn is None else replace(settings, imu_from_base=' '.join(map(repr, turn)))


def read_gravity(
    recording: Recording,
    overrides: Mapping[str, str],
    settings: EstimatorSettings,
    gravity: Gravity,
) -> RecordedGravity | None:
    """Return the recorded direction of gravity; None if the direction of the model applies.

    gravity: of the model. Raises RecordingError if a recorded direction is required but none is
    usable.
    """
    source = GravitySource(settings=settings, gravity=gravity)
    inputs = {sensor.name: sensor for sensor in gravity_inputs(source)}
    topics = find_recorded(recording, inputs.values(), overrides)
    found = {topic: inputs[name] for name, topic in topics.items()}
    required = bool(source.frame) or gravity.is_measured
    if not required and BASE_IMU not in found.values():
        return None
    known, refused, counts = BaseGravity(), dict[str, Refusal](), Counter[str]()
    stretches: list[list[tuple[int, Direction]]] = [[]]  # between jumps back in time
    for message in recording.messages(tuple(found)):
        refusal: Refusal | None
        try:
            reading = found[message.topic].decode(message.message)
        except MessageError as error:
            refusal = drop(message.log_time_ns, UNREADABLE, str(error))
        else:
            known, refusal = source.take(known, reading)
        if refusal is not None:
            refused.setdefault(refusal.reason, refusal)
            counts[refusal.reason] += 1
            continue
        read_ns = known.reading.stamp_ns if known.reading else latest_stamp(reading)
        direction, _ = source.at(known, read_ns)
        if direction is None:
            continue
        last_ns = stretches[-1][-1][0] if stretches[-1] else -1
        if stamp_fault(BASE_IMU.label, last_ns, read_ns)[0] == RESTARTED:
            stretches.append([(read_ns, direction)])
        elif read_ns > last_ns:
            stretches[-1].append((read_ns, direction))
    kept = max(stretches, key=len)  # as of the readings
    if not kept:
        refusal_at_start = source.at(known, 1)[1]
        why = [one.sentence for one in refused.values()] or [
            refusal_at_start.sentence if refusal_at_start else ''
        ]
        raise RecordingError(f'{recording.path}: {"; ".join(why)}', reason='no_gravity')
    varies = not source.frame or source.moves(known)
    return RecordedGravity(
        stamp_ns=np.array([read_ns for read_ns, _ in kept], dtype=np.int64),
        direction=np.array([direction for _, direction in kept]),
        reach=settings.gravity_timeout if varies else math.inf,
        sentences=tuple(
            f'dropped {count} readings of gravity ({reason}): {refused[reason].sentence}'
            for reason, count in counts.items()
        ),
    )


def latest_stamp(reading: Any) -> int:
    """Return the latest stamp (ns) of readings of frames."""
    return max((one.stamp_ns for one in reading if isinstance(one, FrameReading)), default=0)

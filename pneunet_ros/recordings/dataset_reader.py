"""Reads recordings for calibration and diagnosis: frames matched with pressure and load.

Omitted data are counted in sentences; missing data are not filled in.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import as_weight
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.between_readings import interpolate
from pneunet_ros.measurement.dataset import frame_instants, frames_in_jumps, RecordingData
from pneunet_ros.messages.readings import (
    END_WRENCH,
    PRESSURE,
    Sensor,
    STRING_WRENCH,
    TARGETS,
    TIP_POSE,
)
from pneunet_ros.model.gravity import Gravity
from pneunet_ros.recordings.recorded_gravity import read_gravity
from pneunet_ros.recordings.recorded_series import find_series, nearest, read_series, ReadingSeries
from pneunet_ros.recordings.recording import open_recording, Recording

_AS_SHIPPED, _AS_MODEL = EstimatorSettings(), Gravity()
_NO_OVERRIDES: Mapping[str, str] = MappingProxyType({})


def read_run(
    path: str | Path,
    targets: int,
    overrides: Mapping[str, str] = _NO_OVERRIDES,
    settings: EstimatorSettings = _AS_SHIPPED,
    gravity: Gravity = _AS_MODEL,
) -> tuple[RecordingData, tuple[str, ...]]:
    """Read pressure, end wrench and targets of a recording for calibration and diagnosis.

    A frame is matched with the pressure reading and the end wrench with the nearest header stamp
    within half a median period; frames without a match, without a seen target, or during a jump of
    the pressure are excluded. Without a wrench topic, or with `wrench_required` false, nothing was
    attached; a constant wrench, or that of a string, is a known load, not a reading. Without a
    pressure topic, the pressure of the arm is zero. The pose of the tip is matched with the
    nearest frame.

    Args:
        path: of an .mcap file or a rosbag2 folder.
        targets: number of targets of the arm.
        overrides: full topic name by last name.
        settings: meaning of the readings (sign and yaw of the wrench, gauge or absolute pressure).
        gravity: of the model, and whether a sensor measures it.

    Returns:
        The recording (Pa gauge; N, N m, m in the base frame), and sentences on omitted data.

    Raises:
        RecordingError: a topic is missing or invalid, or no frame is left.
    """
    recording = open_recording(path)
    topics, by_string = _topics(recording, overrides, settings)
    read = read_series(recording, topics, settings, targets)
    sentences = [*recording.sentences]
    series = _without_empty(path, read, sentences)
    readings, wrench = series.get(PRESSURE.name), series.get(END_WRENCH.name)
    poses = series.get(TIP_POSE.name)
    frames, points, pose = _frames(series, targets)
    keep = TARGETS.present(points)
    if pose is not None:
        keep |= TIP_POSE.present(pose)
    _report_excluded(sentences, frames, ~keep, 'no_target', 'no target was visible')
    reading, keep = _match_pressure(sentences, frames, readings, keep)
    load, known, keep = _match_load(sentences, frames, wrench, by_string, keep)
    measured = read_gravity(recording, overrides, settings, gravity)
    if measured is not None:
        sentences += measured.sentences
        unknown = keep & ~measured.is_known(frames.stamp_ns)
        _report_excluded(
            sentences, frames, unknown, 'no_gravity', 'the direction of gravity is unknown'
        )
        keep &= ~unknown
    if not keep.any():
        raise RecordingError(
            f'{path}: no frames are left: {"; ".join(sentences)}', reason='no_frames'
        )
    run = RecordingData(
        name=str(path),
        reading_stamp_ns=frames.stamp_ns if readings is None else readings.stamp_ns,
        pressure=np.zeros(reading.size) if readings is None else readings.values[:, 0],
        pressurized=readings is not None,
        stamp_ns=frames.stamp_ns[keep],
        reading=reading[keep],
        loaded=wrench is not None,
        load_known=known,
        wrench_stamp_ns=None if wrench is None else wrench.stamp_ns,
        wrench=None if wrench is None else wrench.values,
        force=load[keep, :2],
        moment=load[keep, 2],
        x=points[keep, 0],
        y=points[keep, 1],
        tip_pose=None if pose is None else pose[keep],
        tip_frame=tip_frame(recording, None if poses is None else poses.topic, settings),
        gravity=None if measured is None else measured.at(frames.stamp_ns[keep]),
        gravity_stamp_ns=None if measured is None else measured.stamp_ns,
        gravity_read=None if measured is None else measured.direction,
    )
    return run, tuple(sentences)


def tip_frame(recording: Recording, topic: str | None, settings: EstimatorSettings) -> str:
    """Return the frame id of the tip poses; the base frame if none is given."""
    for message in () if topic is None else recording.messages([topic]):
        with suppress(MessageError):
            frame = TIP_POSE.decode(message.message).frame_id
            return BASE_FRAME if frame in ('', settings.frame_id) else str(frame)
    return BASE_FRAME


def is_constant(values: Array) -> bool:
    """Whether a load (readings, 3) is bit-identical throughout, and not zero.

    A sensor never reads constant values, so the load is a known weight that was entered by hand.
    """
    return len(values) > 1 and bool(np.all(values == values[0]) and np.any(values[0] != 0.0))


def _topics(
    recording: Recording, overrides: Mapping[str, str], settings: EstimatorSettings
) -> tuple[dict[str, str], bool]:
    """Return the topic of each sensor, and whether the end wrench is that of a string."""
    sensors: list[Sensor[Any]] = [
        PRESSURE,
        TIP_POSE,
        TARGETS,
        *([END_WRENCH] if settings.wrench_required else []),
    ]
    topics: dict[str, str] = {}
    for sensor in sensors:
        required = sensor is TARGETS and TIP_POSE.name not in topics
        topic = find_series(recording, sensor, overrides, required=required)
        if topic is not None:
            topics[sensor.name] = topic
    if not settings.wrench_required or END_WRENCH.name in topics:
        return topics, False
    by_string = find_series(recording, STRING_WRENCH, overrides, required=False)
    if by_string is None:
        return topics, False
    return topics | {END_WRENCH.name: by_string}, True


def _without_empty(
    path: str | Path, series: Mapping[str, ReadingSeries], sentences: list[str]
) -> dict[str, ReadingSeries]:
    """Return the series with readings; only a tip pose in addition to targets may be empty."""
    seen = series.get(TARGETS.name)
    found: dict[str, ReadingSeries] = {}
    for name, item in series.items():
        if len(item.stamp_ns):
            sentences += item.sentences()
            found[name] = item
            continue
        why = '; '.join(item.sentences()) or 'the topic is empty'
        if name != TIP_POSE.name or seen is None or not len(seen.stamp_ns):
            raise RecordingError(
                f'{path}: {item.topic} contains nothing usable: {why}', reason='nothing_usable'
            )
        sentences.append(
            Note(f'{item.topic} was not used, only targets: {why}', reason='nothing_usable')
        )
    return found


def _frames(
    series: Mapping[str, ReadingSeries], targets: int
) -> tuple[ReadingSeries, Array, Array | None]:
    """Return the stamps of frames, targets (frames, 2, targets) and tip (frames, 3).

    A tip pose belongs to the frame with the nearest stamp; without a targets topic, each pose is a
    frame.
    """
    poses = series.get(TIP_POSE.name)
    if TARGETS.name not in series:
        assert poses is not None
        return poses, np.full((len(poses.stamp_ns), 2, targets), np.nan), poses.values
    frames = series[TARGETS.name]
    if poses is None:
        return frames, frames.values, None
    at, matched = nearest(frames.stamp_ns, poses)
    return frames, frames.values, np.where(matched[:, None], poses.values[at], np.nan)


def _match_pressure(
    sentences: list[str],
    frames: ReadingSeries,
    readings: ReadingSeries | None,
    keep: npt.NDArray[np.bool_],
) -> tuple[Stamps, npt.NDArray[np.bool_]]:
    """Return the pressure reading of each frame, and the remaining frames, outside of jumps."""
    if readings is None:
        sentences.append(
            Note('there is no pressure topic: the pressure is taken as 0 Pa', reason='no_pressure')
        )
        return np.arange(len(frames.stamp_ns)), keep
    reading, keep = _match(sentences, frames, readings, keep)
    shown = frame_instants(frames.stamp_ns, readings.stamp_ns, reading)
    jumped = keep & frames_in_jumps(shown, readings.stamp_ns, readings.values[:, 0])
    why = 'the pressure jumped between two readings'
    _report_excluded(sentences, frames, jumped, 'between_readings', why)
    return reading, keep & ~jumped


def _match_load(
    sentences: list[str],
    frames: ReadingSeries,
    wrench: ReadingSeries | None,
    by_string: bool,
    keep: npt.NDArray[np.bool_],
) -> tuple[Array, bool, npt.NDArray[np.bool_]]:
    """Return the end load (frames, 3), whether it is a known load, and the remaining frames."""
    if wrench is None:
        return np.zeros((len(frames.stamp_ns), 3)), False, keep
    at, keep = _match(sentences, frames, wrench, keep)
    if not by_string and not is_constant(wrench.values):
        return wrench.values[at], False, keep
    why = 'was computed from the pull of a string' if by_string else 'never changes'
    force = float(np.hypot(*wrench.values[:, :2].T).max(initial=0.0))
    size = f' of {as_weight(force)}' if force > 0.0 else ''  # or a moment alone
    sentences.append(
        Note(
            f'{wrench.topic} {why}: a known load{size}, not measured by a sensor',
            reason='known_load',
        )
    )
    if not by_string:
        return wrench.values[at], True, keep
    columns = [interpolate(frames.stamp_ns, wrench.stamp_ns, one) for one in wrench.values.T]
    return np.column_stack(columns), True, keep  # its direction follows the tip


def _match(
    sentences: list[str],
    frames: ReadingSeries,
    readings: ReadingSeries,
    keep: npt.NDArray[np.bool_],
) -> tuple[Stamps, npt.NDArray[np.bool_]]:
    """Return the reading nearest to each frame, and the remaining frames."""
    found, matched = nearest(frames.stamp_ns, readings)
    why = f'no {readings.topic} reading within half its period'
    _report_excluded(sentences, frames, keep & ~matched, 'unmatched', why)
    return found, keep & matched


def _report_excluded(
    sentences: list[str],
    frames: ReadingSeries,
    left_out: npt.NDArray[np.bool_],
    reason: str,
    why: str,
) -> None:
    count = int(np.count_nonzero(left_out))
    if count:
        plural = '' if count == 1 else 's'
        sentences.append(
            Note(f'{frames.topic}: {count} frame{plural} excluded, {why}', reason=reason)
        )

"""Estimated or measured shapes of a recording as arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
import math
from typing import Any, NamedTuple

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.core.notes import Note
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.shape_error import Centerlines, Pressures, ShapeSeries, Tips
from pneunet_ros.messages.builders import nanoseconds, POINTS_TYPE, POSE_TYPE, UNFIT
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.readings import PRESSURE, TARGETS, TIP_POSE
from pneunet_ros.recordings.recorded_series import find_recorded, read_series
from pneunet_ros.recordings.recording import open_recording, Recording

TIP, SHAPE = 'tip', 'shape'
ESTIMATES = {TIP: POSE_TYPE, SHAPE: POINTS_TYPE}
SHAPE_TOPICS = (*ESTIMATES, TARGETS.name, TIP_POSE.name)
PLACES = [0, 1, 6, 7]  # indices of x and y among the 36 covariances of a pose


class StampedRows(NamedTuple):
    """Rows of numbers of a topic, with its frame, increasing stamps, and notes."""

    frame: str
    stamp_ns: Stamps
    rows: list[Array]
    sentences: tuple[str, ...]


def read_shapes(path: Any, overrides: Mapping[str, str], target_arclength: Array) -> ShapeSeries:
    """Read the shapes of a recording: estimates or, if there are none, measurements.

    overrides: full topic names by SHAPE_TOPICS; they also choose between estimates and
    measurements if a recording has both. target_arclength (targets,) m: positions of the targets.
    Raises RecordingError if the recording has neither, or if they cannot be read.
    """
    recording = open_recording(path)
    if set(overrides) & set(ESTIMATES) or (not overrides and estimate_topics(recording, {})):
        return read_estimates(recording, overrides)
    return read_measured(recording, overrides, target_arclength)


def estimate_topics(recording: Recording, overrides: Mapping[str, str]) -> dict[str, str]:
    """Return the existing topics of tip and shape, full names by last names.

    Raises RecordingError if a name is ambiguous.
    """
    return {
        name: recording.find(name, kind, overrides.get(name))
        for name, kind in ESTIMATES.items()
        if name in overrides or recording.candidates(name, kind)
    }


def read_estimates(recording: Recording, overrides: Mapping[str, str]) -> ShapeSeries:
    """Return the shapes of an estimator; without `tip`, the tip is the end of the shape."""
    topics = estimate_topics(recording, overrides)
    centerlines = tips = None
    frames, sentences = [], [*recording.sentences]
    if SHAPE in topics:
        topic = topics[SHAPE]
        found = read_rows(recording, topic, shape_row)
        frames.append(found.frame)
        sentences += found.sentences
        arclength = found.rows[0][0]
        if not all(np.array_equal(row[0], arclength) for row in found.rows):
            raise RecordingError(
                f'{recording.path}: the stations of {topic} change during the recording',
                reason='wrong_shape',
            )
        rows, stamp_ns = np.array(found.rows), found.stamp_ns
        centerlines = Centerlines(
            topic=topic, stamp_ns=stamp_ns, arclength=arclength, points=rows[:, 1:3]
        )
        tips = Tips(topic=topic, stamp_ns=stamp_ns, place=rows[:, 1:3, -1], heading=rows[:, 3, -1])
    if TIP in topics:
        tips, found = read_tips(recording, topics[TIP])
        frames.append(found.frame)
        sentences += found.sentences
    return ShapeSeries(
        name=str(recording.path),
        centerlines=centerlines,
        tips=tips,
        frame=frames[-1],
        pressures=read_pressures(recording),
        whole=SHAPE in topics,
        sentences=tuple(sentences),
    )


def read_tips(recording: Recording, topic: str) -> tuple[Tips, StampedRows]:
    """Return the free end with its covariance from an estimator."""
    found = read_rows(recording, topic, tip_row)
    rows = np.array(found.rows)
    tips = Tips(
        topic=topic,
        stamp_ns=found.stamp_ns,
        place=rows[:, :2],
        heading=rows[:, 2],
        covariance=freeze(rows[:, 3:].reshape(-1, 2, 2)),
    )
    return tips, found


def read_measured(
    recording: Recording, overrides: Mapping[str, str], target_arclength: Array
) -> ShapeSeries:
    """Return the targets and the pose of the tip."""
    topics = find_recorded(recording, (TARGETS, TIP_POSE), overrides)
    centerlines = tips = None
    sentences = [*recording.sentences]
    frames = {name: first_frame(recording, topic) for name, topic in topics.items()}
    frame = next(iter(frames.values()), '') or BASE_FRAME  # that of the targets, if there are any
    if frames.get(TIP_POSE.name, '') not in ('', frame):
        sentences.append(
            Note(
                f'{topics.pop(TIP_POSE.name)} was ignored: it is in the frame '
                f'{frames[TIP_POSE.name]}, and the targets are in {frame}',
                reason='other_frame',
            )
        )
    settings = EstimatorSettings(frame_id=frame)
    series = read_series(recording, topics, settings, target_arclength.size)
    for item in series.values():
        sentences += item.sentences()
    if TARGETS.name in series:
        targets = series[TARGETS.name]
        centerlines = Centerlines(
            topic=targets.topic,
            stamp_ns=targets.stamp_ns,
            arclength=target_arclength,
            points=targets.values.reshape(-1, 2, target_arclength.size),
        )
    if TIP_POSE.name in series:
        poses = series[TIP_POSE.name]
        tips = Tips(
            topic=poses.topic,
            stamp_ns=poses.stamp_ns,
            place=poses.values[:, :2],
            heading=poses.values[:, 2],
        )
    if centerlines is None and tips is None:
        raise RecordingError(
            f'{recording.path} contains no shape: it has none of the topics '
            f'{", ".join(SHAPE_TOPICS)}; `pneunet replay --output` writes estimates, `pneunet '
            'track --output` writes targets',
            reason='no_topic',
        )
    return ShapeSeries(
        name=str(recording.path),
        centerlines=centerlines,
        tips=tips,
        frame=frame,
        pressures=read_pressures(recording),
        sentences=tuple(sentences),
    )


def first_frame(recording: Recording, topic: str) -> str:
    """Return the frame of the first message of a topic; empty if it names none."""
    for message in recording.messages([topic]):
        with suppress(*UNFIT, MessageError):
            return str(message.message.header.frame_id)
    return ''


def read_pressures(recording: Recording) -> Pressures | None:
    """Return the pressures of a recording; None without a unique topic of pressures."""
    if len(recording.candidates(PRESSURE.name, PRESSURE.type)) != 1:
        return None
    topic = recording.find(PRESSURE.name, PRESSURE.type)
    found = read_series(recording, {PRESSURE.name: topic}, EstimatorSettings())
    series = found.get(PRESSURE.name)
    if series is None or not len(series.stamp_ns):
        return None
    return Pressures(stamp_ns=series.stamp_ns, values=series.values[:, 0])


def read_rows(recording: Recording, topic: str, row_of: Callable[[Any], Array]) -> StampedRows:
    """Return the numbers of every message of a topic, in the order of their header stamps.

    Of several messages with equal stamps, the first is used. Raises RecordingError if a message is
    unusable.
    """
    stamps: list[int] = []
    rows: list[Array] = []
    frames: set[str] = set()
    for message in recording.messages([topic]):
        try:
            stamp_ns = nanoseconds(message.message.header.stamp)
            frames.add(str(message.message.header.frame_id))
            rows.append(row_of(message.message))
        except (*UNFIT, MessageError) as error:
            raise RecordingError(
                f'{recording.path}: {topic} at log time {message.log_time_ns} ns is not usable: '
                f'{error}',
                reason='unreadable',
            ) from error
        stamps.append(stamp_ns)
    if not rows:
        raise RecordingError(f'{recording.path}: {topic} is empty', reason='empty')
    if len(frames) > 1:
        raise RecordingError(
            f'{recording.path}: {topic} is in {len(frames)} different frames', reason='wrong_frame'
        )
    increasing_ns, kept = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
    twice = len(stamps) - kept.size
    return StampedRows(
        frame=''.join(frames),
        stamp_ns=increasing_ns,
        rows=[rows[index] for index in kept.tolist()],
        sentences=(f'{topic}: dropped {twice} messages with repeated stamps',) if twice else (),
    )


def tip_row(message: Any) -> Array:
    """Return x, y (m), heading (rad) and the four covariances of x and y (m^2) of a tip, (7,)."""
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    covariance = np.asarray(message.pose.covariance, dtype=np.float64)[PLACES]
    heading = 2.0 * math.atan2(orientation.z, orientation.w)
    return np.array([position.x, position.y, heading, *covariance], dtype=np.float64)


def shape_row(message: Any) -> Array:
    """Return arclength, x, y (m) and heading (rad) of all stations of a shape, (4, stations)."""
    points = cloud_points(message)
    return np.stack([points[name].astype(np.float64) for name in ('s', 'x', 'y', 'theta')])

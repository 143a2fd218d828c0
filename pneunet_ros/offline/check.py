"""Contents of a recording: topics, timing, synchronization, ranges, uses."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from pneunet_ros.calibration.checks.frames_in_motion import frames_in_motion
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import PneunetError, RecordingError
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import kilopascals, seconds_between, seconds_since
from pneunet_ros.measurement.steady_states import hold_intervals
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, SENSORS
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
from pneunet_ros.offline.judge import judge_recording, NO_VERDICTS, Verdicts
from pneunet_ros.offline.uses import run_reader, UseRequest, uses
from pneunet_ros.recordings.recorded_gravity import read_gravity, with_imu_mounting
from pneunet_ros.recordings.recorded_series import find_series, nearest, read_series, ReadingSeries
from pneunet_ros.recordings.recording import open_recording, Recording

GAP = 2.5  # median periods without a message
NOISE_RANGE = 8.0  # range of constant readings, in standard deviations
RANGE_SHARE = 0.005  # the same, of the calibrated range of pressure


def check_recording(path: Any, request: UseRequest) -> dict[str, Any]:
    """Return all facts about a recording for JSON, SI.

    Raises RecordingError only if the file cannot be read at all; problems with its content are in
    `sentences`, and in the reasons under `uses`.
    """
    recording = open_recording(path)
    sentences = [*recording.sentences]
    series: dict[str, ReadingSeries] = {}
    settings = with_imu_mounting(recording, request.overrides, request.settings)
    for sensor in SENSORS:
        try:
            topic = find_series(recording, sensor, request.overrides, required=False)
            if topic is not None:
                series |= read_series(recording, {sensor.name: topic}, settings)
        except RecordingError as error:
            sentences.append(str(error))
    for item in series.values():
        sentences += item.sentences()
    try:
        gravity = read_gravity(recording, request.overrides, settings, request.arm.gravity)
        sentences += [] if gravity is None else gravity.sentences
    except RecordingError as error:
        sentences.append(str(error))
    series = {name: item for name, item in series.items() if len(item.stamp_ns)}
    try:
        verdicts = judge_recording(
            recording,
            request.arm,
            request.settings,
            request.overrides,
            own_model=request.own_model,
        )
    except RecordingError:
        verdicts = NO_VERDICTS  # the sentences report the reason
    about = implausible_readings(series, request, verdicts)
    sentences = [*about, *sentences] if verdicts.contradicted else [*sentences, *about]
    run = run_reader(recording, request)
    motion = None
    with suppress(PneunetError):  # the reason is given with the uses
        motion = frames_in_motion([run()], request.arm)
    if motion is not None:
        sentences = [f'{motion.sentence}{propose_motion_recording(request.arm)}', *sentences]
    return {
        'recording': path,
        'seconds': seconds_between(recording.start_ns, recording.end_ns),
        'topics': topics_of(recording, series),
        'sync': {name: sync(series, name) for name in series if name != PRESSURE.name}
        if PRESSURE.name in series
        else {},
        'ranges': ranges(series),
        'holds': holds(series, request.arm),
        'verdicts': verdicts.summary,
        'uses': uses(recording, request, verdicts, run),
        'in_motion': None if motion is None else motion.summary,
        'sentences': sentences,
    }


def propose_motion_recording(arm: Arm) -> str:
    """Propose a recording of motion if the motion of the arm is unknown."""
    if arm.inertia is not None:
        return ''
    return (
        f', and {arm.name} has no `motion`: record the arm swinging freely (pluck it at constant '
        'pressure and record 20 s), and give the recording to calibrate --motion'
    )


def topics_of(recording: Recording, series: Mapping[str, ReadingSeries]) -> list[dict[str, Any]]:
    """Return type, count, rate (Hz), jitter and gaps of every topic.

    Times are header stamps for readings, and log times for all other topics.
    """
    logged = {topic.name: array('q') for topic in recording.topics}
    for message in recording.raw_messages(tuple(logged)):
        logged[message.topic].append(message.log_time_ns)
    stamped = {item.topic: item.stamp_ns for item in series.values()}
    return [
        {
            'name': topic.name,
            'type': topic.type,
            'count': len(logged[topic.name]),
            'stamps': 'header' if topic.name in stamped else 'log',
            **timing(stamped.get(topic.name, np.array(logged[topic.name], dtype=np.int64))),
        }
        for topic in recording.topics
    ]


def timing(stamp_ns: Stamps) -> dict[str, Any]:
    """Return rate (Hz) by the median period, jitter (s, standard deviation) and gaps."""
    intervals = np.diff(stamp_ns) * 1e-9
    if not intervals.size or float(np.median(intervals)) <= 0.0:
        return {'rate': None, 'jitter': None, 'gaps': 0, 'longest_gap': None}
    period = float(np.median(intervals))
    regular = intervals[intervals <= GAP * period]
    return {
        'rate': 1.0 / period,
        'jitter': float(np.std(regular)),
        'gaps': int(np.count_nonzero(intervals > GAP * period)),
        'longest_gap': float(np.max(intervals)),
    }


def sync(series: Mapping[str, ReadingSeries], name: str) -> dict[str, Any]:
    """Return the timing of a topic relative to the pressure.

    share: fraction with a pressure reading within half its period. offset: median time (s) to the
    nearest pressure reading, positive if that is earlier; starts: how much later (s) the topic
    begins.
    """
    stamps, pressure = series[name].stamp_ns, series[PRESSURE.name]
    found, matched = nearest(stamps, pressure)
    return {
        'share': float(np.mean(matched)),
        'offset': float(np.median(stamps - pressure.stamp_ns[found])) * 1e-9,
        'starts': seconds_since(int(pressure.stamp_ns[0]), int(stamps[0])),
    }


def ranges(series: Mapping[str, ReadingSeries]) -> dict[str, Any]:
    """Return the range of readings, and the number of frames in which each target was seen."""
    found: dict[str, Any] = {}
    for item in series.values():
        if item.sensor.per_target:
            found['targets'] = item.values.shape[2]
            found['frames'] = len(item.values)
            found['seen_per_target'] = np.isfinite(item.values[:, 0]).sum(axis=0)
        for column, component in enumerate(item.sensor.components):
            if np.isfinite(item.values[:, column]).any():
                found[component.name] = limits(item.values[:, column])
    return found


def limits(values: Array) -> list[float]:
    """Return the smallest and the largest value, ignoring NaN."""
    return [float(np.nanmin(values)), float(np.nanmax(values))]


def holds(series: Mapping[str, ReadingSeries], arm: Arm) -> list[dict[str, float]]:
    """Return the intervals in which pressure and end load are constant within noise."""
    if PRESSURE.name not in series:
        return []
    pressure = series[PRESSURE.name]
    low, high = arm.pressure_range
    values = pressure.values
    tolerances = [max(NOISE_RANGE * arm.sensors.pressure_std, RANGE_SHARE * (high - low))]
    if END_WRENCH.name in series:
        wrench = series[END_WRENCH.name]
        found, _ = nearest(pressure.stamp_ns, wrench)
        values = np.column_stack([values, wrench.values[found, :2]])
        tolerances += [max(NOISE_RANGE * arm.sensors.force_std, RANGE_SHARE * arm.weight)] * 2
    start = int(pressure.stamp_ns[0])
    return [
        {
            'from': seconds_since(start, int(pressure.stamp_ns[first])),
            'to': seconds_since(start, int(pressure.stamp_ns[last])),
            'pressure': float(np.mean(pressure.values[first : last + 1])),
        }
        for first, last in hold_intervals(pressure.stamp_ns, values, np.array(tolerances))
    ]


def implausible_readings(
    series: Mapping[str, ReadingSeries], request: UseRequest, verdicts: Verdicts
) -> list[str]:
    """Describe readings that are implausible for this arm."""
    if verdicts.contradicted:
        return [f'{verdicts.findings}: give {verdicts.options} to every verb']
    if verdicts.model_mismatch:
        return [verdicts.model_mismatch]
    if PRESSURE.name not in series:
        return []
    arm, verdict = request.arm, verdicts.pressure
    topic, values = series[PRESSURE.name].topic, series[PRESSURE.name].values[:, 0]
    low, high = arm.pressure_range
    outside = [arm.beyond_range(value) > EXTRAPOLATION for value in values.tolist()]
    beyond = float(np.mean(outside))
    if beyond == 0.0:
        return []
    return [
        f'{topic}: {100.0 * beyond:.3g} % of the readings are outside the calibrated range of '
        f'{arm.name}, {kilopascals(low):g} to {kilopascals(high):g} kPa, by more than '
        f'{100.0 * EXTRAPOLATION:g} % of it'
        + (f'; {verdict.finding}' if verdict is not None and verdict.log_odds > 0.0 else '')
    ]

"""Recordings read as calibration and diagnosis see them: header stamps matched, load and targets.

What is left out is counted in sentences; nothing is filled in.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.messages.readings import TARGETS_NAME
from pneunet_ros.recordings.recorded_series import find_series, nearest, read_series
from pneunet_ros.recordings.recording import open_recording

_AS_SHIPPED = EstimatorSettings()
_NO_OVERRIDES: Mapping[str, str] = MappingProxyType({})


def read_run(
    path: str | Path,
    targets: int,
    overrides: Mapping[str, str] = _NO_OVERRIDES,
    settings: EstimatorSettings = _AS_SHIPPED,
) -> tuple[RecordingData, tuple[str, ...]]:
    """Return a recording of pressure, end wrench and targets, and sentences on what is left out.

    A frame belongs to the pressure reading, and the end wrench, whose header stamp is nearest
    within half a median period; frames without one, and those in which no target was seen, are
    left out. Without a topic `end_wrench`, or with `wrench_required` false, nothing was attached.

    targets: how many the arm has. overrides: full topic name by last name. Raises RecordingError
    where a topic is missing or not what it must be, or where no frame is left.
    """
    recording = open_recording(path)
    topics = {'pressure': find_series(recording, 'pressure', overrides)}
    topics[TARGETS_NAME] = find_series(recording, TARGETS_NAME, overrides)
    if settings.wrench_required:
        topics['end_wrench'] = find_series(recording, 'end_wrench', overrides, required=False)
    found = {name: topic for name, topic in topics.items() if topic is not None}
    series = read_series(recording, found, settings, targets)
    for name, one in series.items():
        if not len(one.stamp_ns):
            why = '; '.join(one.sentences()) or 'the topic is empty'
            raise RecordingError(f'{path}: {found[name]} holds nothing that can be used: {why}')
    sentences = [*recording.sentences]
    for one in series.values():
        sentences += one.sentences()

    frames = series[TARGETS_NAME]
    keep = np.isfinite(frames.values[:, 0]).any(axis=1)
    _say(sentences, frames.topic, int(np.count_nonzero(~keep)), 'no target was seen')
    reading, matched = nearest(frames.stamp_ns, series['pressure'])
    _say(
        sentences,
        frames.topic,
        int(np.count_nonzero(keep & ~matched)),
        f'no {series["pressure"].topic} reading within half its period',
    )
    keep &= matched
    load = np.zeros((len(frames.stamp_ns), 3))
    wrench = series.get('end_wrench')
    if wrench is not None:
        at, matched = nearest(frames.stamp_ns, wrench)
        _say(
            sentences,
            frames.topic,
            int(np.count_nonzero(keep & ~matched)),
            f'no {wrench.topic} reading within half its period',
        )
        keep &= matched
        load = wrench.values[at]
    if not keep.any():
        raise RecordingError(f'{path}: no frame is left: {"; ".join(sentences)}')
    run = RecordingData(
        name=str(path),
        reading_stamp_ns=series['pressure'].stamp_ns,
        pressure=series['pressure'].values[:, 0],
        stamp_ns=frames.stamp_ns[keep],
        reading=reading[keep],
        loaded=wrench is not None,
        force=load[keep, :2],
        moment=load[keep, 2],
        x=frames.values[keep, 0],
        y=frames.values[keep, 1],
    )
    return run, tuple(sentences)


def _say(sentences: list[str], topic: str, count: int, why: str) -> None:
    if count:
        sentences.append(f'{topic}: {count} frame{"" if count == 1 else "s"} left out, {why}')

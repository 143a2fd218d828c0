"""Removal of frames in which pressure or load changed between two readings.

The error of linear interpolation between readings is treated as a reading error: a fit absorbs it
along the tangent of the shape, as if it were normal. If it exceeds the noise of a reading, the
frame is not a valid measurement, because its pressure or load is unknown. Such frames, and those
outside the readings, are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.noise_estimate import with_noise_of_readings
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_model import missed_load, missed_pressure, shown_instants
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise

Flags = npt.NDArray[np.bool_]


def without_unread(
    arm: Arm, *groups: Sequence[RecordingData]
) -> tuple[list[list[RecordingData]], tuple[Note, ...]]:
    """Return recordings without the frames whose readings are unknown, and a note.

    A loaded recording that has no load any more is left out as well. RecordingError if the first
    group loses all its recordings, or all without a load, or all with one.
    """
    noise = with_noise_of_readings(arm.sensors, [run for group in groups for run in group])
    read = [[(run, read_frames(arm, run, noise)) for run in group] for group in groups]
    every = [flags for group in read for _, flags in group]
    left = sum(int((~flags).sum()) for flags in every)
    if not left:
        return [[*group] for group in groups], ()
    parts = [[(run, read_part(run, flags, noise)) for run, flags in group] for group in read]
    kept = [[part for _, part in group if part is not None] for group in parts]
    lost = [run.name for group in parts for run, part in group if part is None]
    note = Note(
        f'{left} of {sum(flags.size for flags in every)} frames were left out because their '
        'pressure or load is not known: it changed between two readings, or its readings had '
        'ended' + (f'; nothing is left of {", ".join(lost)}' if lost else ''),
        reason='between_readings',
    )
    if {run.loaded for run in kept[0]} != {run.loaded for run in groups[0]}:
        raise RecordingError(
            f'{note}. Too few frames are left for a diagnosis: read pressure and load more often '
            'than frames',
            reason='between_readings',
        )
    return kept, (note,)


def read_part(run: RecordingData, flags: Flags, noise: SensorNoise) -> RecordingData | None:
    """Return these frames of a run; None if none is left, or none with its load."""
    if not flags.any():
        return None
    part = run.subset(np.flatnonzero(flags))
    lost = run.loaded and part.is_idle(noise) and not run.is_idle(noise)
    return None if lost else part


def read_frames(arm: Arm, run: RecordingData, noise: SensorNoise) -> Flags:
    """Return the frames (frames,) whose state is covered by readings."""
    if run.static or len(run.reading_stamp_ns) < 2:
        return np.ones(len(run.stamp_ns), np.bool_)
    shown = shown_instants(arm, run)
    known = missed_pressure(noise, arm, run) <= noise.pressure_std
    stds = np.array([noise.force_std, noise.force_std, noise.moment_std])
    known &= (missed_load(run, stds) <= stds).all(axis=1)
    if run.pressurized:
        known &= (shown >= run.reading_stamp_ns[0]) & (shown <= run.reading_stamp_ns[-1])
    return np.asarray(known)

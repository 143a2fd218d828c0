"""Frames that a diagnosis can use: arm at rest, pressure and load known.

The interpolation error between readings is treated as a normal reading error, which a fit absorbs
along the tangent of the shape. If it exceeds the noise of a reading, the frame is not a valid
measurement, because its pressure or load is unknown. Such frames are excluded, as are frames
before the first and after the last reading.
"""

from __future__ import annotations

from collections.abc import Sequence
import itertools

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.checks.frames_in_motion import (
    FramesInMotion,
    select_frames,
    without_motion,
)
from pneunet_ros.calibration.noise_estimate import with_noise_of_readings
from pneunet_ros.calibration.settings import GAUGE_PASCALS
from pneunet_ros.core.errors import PneunetError, RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.diagnosis.fit.base_fit import checked_runs
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.errors.noise_model import missed_load, missed_pressure, shown_instants
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.tip_pose import with_tip_target
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise

Flags = npt.NDArray[np.bool_]


def with_tips(
    model: Arm, training: Sequence[RecordingData], held_out: Sequence[RecordingData]
) -> tuple[Arm, list[RecordingData], list[RecordingData], tuple[str, ...]]:
    """Return model and recordings with the tip as last target if only the tip was seen.

    The fourth value describes the unused parts of the tip poses. Raises RecordingError if only the
    heading was measured.
    """
    runs, notes = [*training, *held_out], tuple[str, ...]()
    if all(run.tip_pose is None for run in runs):
        return model, [*training], [*held_out], notes
    if any(run.seen.any() for run in runs):
        notes = (
            Note(
                'the measured pose of the tip (tip_pose) was not used: a diagnosis uses the '
                'targets',
                reason='tip_pose_unused',
            ),
        )
    else:
        targets = model.target_arclength.size
        model, runs = with_tip_target(model, runs)
        if not any(run.seen.any() for run in runs):
            raise RecordingError(
                'only the heading of the tip was measured, and a diagnosis needs positions: '
                'measure the position of the tip or of a target as well (`calibrate` accepts '
                'the heading alone)',
                reason='heading_only',
            )
        if model.target_arclength.size > targets:
            notes = (
                Note(f'in the written models the tip is target {targets}', reason='tip_as_target'),
            )
        if any(run.heading is not None for run in runs):
            notes = (*notes, Note('the heading of the tip was not used', reason='heading_unused'))
    runs = [run.without_tip_pose() for run in runs]
    count = len(training)
    return model, runs[:count], runs[count:], notes


def at_rest(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    notes: tuple[str, ...],
    declared: PressureConvention | None = GAUGE_PASCALS,
) -> tuple[list[RecordingData], list[RecordingData], tuple[str, ...], FramesInMotion | None]:
    """Exclude frames in motion; return the recordings, the notes, and the excluded frames.

    A note on the excluded frames comes first.

    Raises RecordingError if the training recordings suffice with these frames but not without.
    """
    kept, motion = without_motion(model, training, held_out)
    if motion is None:
        return kept[0], kept[1], notes, None
    too_few = RecordingError(
        f'{motion.left_out}. Too few frames are left for a diagnosis', reason='in_motion'
    )
    no_unloaded = all(run.loaded for run in kept[0])
    if not kept[0] or (no_unloaded and not all(run.loaded for run in training)):
        raise too_few
    try:
        checked_runs(model, kept[0], declared)
    except PneunetError as error:
        checked_runs(model, training, declared)
        raise too_few from error
    return kept[0], kept[1], (motion.left_out, *notes), motion


def exclude_unknown_readings(
    arm: Arm, *groups: Sequence[RecordingData]
) -> tuple[list[list[RecordingData]], tuple[Note, ...]]:
    """Exclude the frames with unknown pressure or load; return the recordings and a note.

    As in `select_frames`, a loaded recording that loses its load is excluded as well. Raises
    RecordingError if the first group loses all its recordings, or all unloaded or all loaded ones.
    """
    runs = list(itertools.chain(*groups))
    noise = with_noise_of_readings(arm.sensors, runs)
    every = [frames_with_known_readings(arm, run, noise) for run in runs]
    left = sum(int((~flags).sum()) for flags in every)
    if not left:
        return [[*group] for group in groups], ()
    kept, lost = select_frames(groups, every, noise)
    note = Note(
        f'{left} of {sum(flags.size for flags in every)} frames were excluded because their '
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


def frames_with_known_readings(arm: Arm, run: RecordingData, noise: SensorNoise) -> Flags:
    """Return the frames (frames,) with known pressure and load."""
    if run.static or len(run.reading_stamp_ns) < 2:
        return np.ones(len(run.stamp_ns), np.bool_)
    shown = shown_instants(arm, run)
    known = missed_pressure(noise, arm, run) <= noise.pressure_std
    stds = np.array([noise.force_std, noise.force_std, noise.moment_std])
    known &= (missed_load(run, stds) <= stds).all(axis=1)
    if run.pressurized:
        known &= (shown >= run.reading_stamp_ns[0]) & (shown <= run.reading_stamp_ns[-1])
    return np.asarray(known)

"""What recordings must hold to calibrate from; the sentence says what to do where they do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pneunet_ros.calibration.consistency import check_same_arm
from pneunet_ros.calibration.settings import (
    CALIBRATION,
    CalibrationSettings,
    PRECONDITIONS,
    PreconditionSettings,
)
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm


def check_runs(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    arm: Arm,
    *,
    first: bool = True,
    settings: CalibrationSettings = CALIBRATION,
) -> None:
    """Raise RequestError or RecordingError where the recordings cannot give a calibration.

    first: nothing is known of the arm yet.
    """
    known = settings.preconditions
    if not unloaded and (first or not loaded):
        raise RequestError(
            'no unloaded recording: the curvature kappa_p0 comes from an arm without end load; '
            'name such recordings after --unloaded'
        )
    frames = sum(len(run.stamp_ns) for run in (*unloaded, *loaded))
    if first and frames < known.fewest_frames:
        raise RecordingError(
            f'{", ".join(run.name for run in (*unloaded, *loaded))}: {frames} frames with targets '
            f'and a pressure; at least {known.fewest_frames} are needed, of all recordings '
            'together'
        )
    for run in (*unloaded, *loaded):
        check_targets(run, arm, known)
        check_units(run, arm, known)
    for run in unloaded:
        check_unloaded(run, known)
    for run in loaded:
        if not run.loaded or float(np.max(np.hypot(*run.force.T))) < known.smallest_force:
            raise RecordingError(
                f'{run.name} was given as loaded, but it has no end force above '
                f'{known.smallest_force} N; name it after --unloaded'
            )
        if float(np.max(np.abs(run.force))) > known.largest_force * arm.weight:
            raise RecordingError(
                f'{run.name}: an end force of {np.max(np.abs(run.force)):.3g} N on an arm that '
                f'weighs {arm.weight:.3g} N; forces must be in N (see --arm)'
            )
        if motion(run) < known.smallest_motion:
            raise RecordingError(
                f'{run.name}: the targets hardly move, so it says nothing of the moment law; '
                'change the pressure or the load within a recording'
            )
    check_same_arm(unloaded, arm.length, settings.consistency)
    if not first:
        return
    pressures = np.concatenate([run.frame_pressure for run in unloaded])
    names = ', '.join(run.name for run in unloaded)
    moved = max(motion(run) for run in unloaded)
    highest = float(np.max(np.abs(pressures)))
    if highest < known.smallest_span and moved > known.bending_motion * arm.length:
        raise RecordingError(
            f'{names}: the pressure never exceeds {highest:.3g} Pa, and yet the arm moves by '
            f'{millimeters(moved):.3g} mm; pressure must be gauge, in Pa, not in kPa, mbar or psi'
        )
    if np.ptp(pressures) < known.smallest_span:
        raise RecordingError(
            f'{names} span {kilopascals(float(np.ptp(pressures))):.2g} kPa of pressure: kappa_p0 '
            'needs at least two pressures; record a ramp or a staircase'
        )
    if moved < known.smallest_motion:
        raise RecordingError(
            f'{names}: the targets hardly move although the '
            'pressure changes; do the target topic and the pressure belong together?'
        )


def check_unloaded(run: RecordingData, known: PreconditionSettings = PRECONDITIONS) -> None:
    """Raise RecordingError where a recording that was given as unloaded has an end force."""
    if run.loaded and float(np.max(np.hypot(*run.force.T))) > known.unloaded_force:
        raise RecordingError(
            f'{run.name} was given as unloaded, but its end force reaches '
            f'{np.max(np.hypot(*run.force.T)):.3g} N; take it from --unloaded (calibrate: name it '
            'after --loaded)'
        )


def check_targets(
    run: RecordingData, arm: Arm, known: PreconditionSettings = PRECONDITIONS
) -> None:
    """Raise RecordingError where a recording has too few targets or others."""
    if run.x.shape[1] != arm.target_arclength.size:
        raise RecordingError(
            f'{run.name} has {run.x.shape[1]} targets and the arm {arm.target_arclength.size}; '
            'recordings of different arms cannot be calibrated together (see --arm)'
        )
    if np.count_nonzero(run.seen.any(axis=0)) < min(known.fewest_targets, run.x.shape[1]):
        raise RecordingError(f'{run.name} shows fewer than {known.fewest_targets} targets')


def check_units(run: RecordingData, arm: Arm, known: PreconditionSettings = PRECONDITIONS) -> None:
    """Raise RecordingError where numbers are of a size that no arm has: another unit."""
    highest = float(np.max(np.abs(run.frame_pressure)))
    if highest > known.largest_pressure:
        raise RecordingError(
            f'{run.name}: a pressure of {highest:.3g} Pa; pressure must be gauge, in Pa'
        )
    reach = float(np.nanmax(np.hypot(run.x, run.y)))
    if reach > known.longest * arm.length:
        raise RecordingError(
            f'{run.name}: a target {reach:.3g} m from the clamp, and the arm is '
            f'{arm.length:.3g} m long; targets must be in m, in the base frame at the clamp, and '
            'of this arm (see --arm)'
        )
    middle = np.nanmedian(np.hypot(run.x[:, -1], run.y[:, -1])) if run.seen[:, -1].any() else reach
    if middle < known.nearest * arm.length:
        raise RecordingError(
            f'{run.name}: the last target lies {middle:.3g} m from the clamp, and the arm is '
            f'{arm.length:.3g} m long; is the unit right, and the first target that at the clamp?'
        )


def motion(run: RecordingData) -> float:
    """Return how far the last target that is ever seen moves (m)."""
    last = int(np.flatnonzero(run.seen.any(axis=0))[-1])
    return float(
        np.hypot(
            np.nanmax(run.x[:, last]) - np.nanmin(run.x[:, last]),
            np.nanmax(run.y[:, last]) - np.nanmin(run.y[:, last]),
        )
    )

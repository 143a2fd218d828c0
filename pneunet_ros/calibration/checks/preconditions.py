"""Preconditions of a calibration, with messages that say how to meet them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pneunet_ros.calibration.checks.consistency import check_same_arm
from pneunet_ros.calibration.settings import GAUGE_PASCALS
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.meaning.pressure_judge import (
    ANY_ACTUATOR,
    expected_of,
    judge_pressure,
    record_of,
)
from pneunet_ros.measurement.row_order import (
    CLAMP_LOOSE,
    clamp_motion,
    CLAMP_MOVES,
    CLAMP_NOISE,
    end_turns,
    numbered_from_tip,
)
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.domain import DOMAIN

# Recordings with another unit, arm or sensor are far beyond these, others far within.
# Invented: no figure of acceptance/sweep.py contains such a recording.
FEWEST_FRAMES = 3  # of all recordings together
FEWEST_TARGETS = 4  # targets that must be seen somewhere in a recording
SMALLEST_MOTION = 0.0045  # of the tip, of the length
UNLOADED_FORCE = 0.12  # of the weight: the offset of a force sensor
LARGEST_PRESSURE = 1e6  # Pa, gauge
BENDING_MOTION = 0.05  # of the tip, of the length: more than a few Pa
LARGEST_FORCE = 100.0  # of the weight
NEAREST_TIP = 0.02  # from the clamp to the last target, of the length
SHORTEST_ROW = 0.5  # of its length, in the longest frame: chords are shorter than arcs
HANGING_MOTION = 0.25  # at constant pressure, of the length: more than creep


def check_runs(
    unloaded: Sequence[RecordingData],
    loaded: Sequence[RecordingData],
    arm: Arm,
    *,
    first: bool = True,
    declared: PressureConvention | None = GAUGE_PASCALS,
) -> None:
    """Raise RequestError or RecordingError if the recordings cannot give a calibration.

    first: whether this is the first calibration of the arm; declared: as in `calibrate`.
    """
    runs = [*unloaded, *loaded]
    constant = bool(loaded) and has_one_pressure(runs, arm)
    if not unloaded and ((first and not constant) or not loaded):
        raise RequestError(
            'no unloaded recording: the curvature kappa_p0 is determined by an arm without end '
            'load; list such recordings after --unloaded',
            reason='no_unloaded',
        )
    without = [run for run in runs if not run.pressurized]
    if without and len(without) < len(runs):
        raise RecordingError(
            f'{names_of(without)}: no pressure topic, but the other recordings have one. Record '
            'the pressure (see --topic), even if it is zero',
            reason='no_pressure',
        )
    if without and not loaded:
        raise RecordingError(
            f'{names_of(without)}: no pressure topic (see --topic). For an arm without pressure, '
            'list recordings under load after --loaded',
            reason='no_pressure',
        )
    frames = sum(len(run.stamp_ns) for run in runs)
    if first and frames < FEWEST_FRAMES:
        raise RecordingError(
            f'{names_of(runs)}: {frames} frames with targets and a pressure; all recordings '
            f'together need at least {FEWEST_FRAMES}',
            reason='too_few_frames',
        )
    for run in runs:
        check_targets(run, arm)
        check_units(run, arm)
        check_clamp(run, arm)
    for run in unloaded:
        check_unloaded(run, arm)
    for run in loaded:
        check_loads(run, arm)
    check_same_arm([run for run in unloaded if run.seen.any()], arm.length)
    if first and constant and not unloaded:
        check_different_loads(loaded, arm)
    if loaded:
        check_bending(runs if constant else loaded, arm)
    if first and unloaded:
        check_pressures(unloaded, arm, declared, constant=constant)


def has_one_pressure(runs: Sequence[RecordingData], arm: Arm) -> bool:
    """Whether all recordings have one constant pressure within the sensor noise."""
    pressures = np.concatenate([run.frame_pressure for run in runs])
    return bool(np.ptp(pressures) <= same_pressure(arm))


def same_pressure(arm: Arm) -> float:
    """Return the largest spread (Pa) that sensor noise causes among readings of one pressure."""
    return DOMAIN.pressure_noise * arm.sensors.pressure_std


def check_loads(run: RecordingData, arm: Arm) -> None:
    """Raise RecordingError if a loaded recording has no load, or an implausible one."""
    if not (run.loaded and run.load.any()) or run.is_idle(arm.sensors):
        raise RecordingError(
            f'{run.name} was given as loaded, but its end force never exceeds the noise of the '
            f'force sensor, {arm.sensors.force_std:.3g} N (sensors.force_std of --arm); list it '
            'after --unloaded',
            reason='not_loaded',
        )
    if float(np.max(np.abs(run.force))) > LARGEST_FORCE * arm.weight:
        raise RecordingError(
            f'{run.name}: an end force of {np.max(np.abs(run.force)):.3g} N on an arm that '
            f'weighs {arm.weight:.3g} N; forces must be in N (see --arm)',
            reason='out_of_range',
        )


def check_bending(runs: Sequence[RecordingData], arm: Arm) -> None:
    """Raise RecordingError if the targets do not move under any load."""
    if tip_travel(runs, arm.reach) < SMALLEST_MOTION * arm.length:
        raise RecordingError(
            f'{names_of(runs)}: the targets hardly move, so they cannot determine the moment '
            'law; change the pressure or the load, within a recording or from one to the next',
            reason='targets_still',
        )


def check_different_loads(loaded: Sequence[RecordingData], arm: Arm) -> None:
    """Raise RecordingError if all frames have the same load and pressure."""
    reach, sensors = np.ptp(np.concatenate([run.load for run in loaded]), axis=0), arm.sensors
    stds = np.array([sensors.force_std, sensors.force_std, sensors.moment_std])
    if np.all(reach <= DOMAIN.pressure_noise * stds):
        raise RecordingError(
            f'{names_of(loaded)}: only one load at one pressure: rest curvature and stiffness '
            'cannot be distinguished. Record another load, or the arm without a load (--unloaded)',
            reason='one_load',
        )


def check_pressures(
    unloaded: Sequence[RecordingData],
    arm: Arm,
    declared: PressureConvention | None,
    *,
    constant: bool,
) -> None:
    """Raise RecordingError if the unloaded recordings do not vary the pressure.

    constant: whether the pressure never changes, not even in loaded recordings.
    """
    tolerance = same_pressure(arm)
    pressures = np.concatenate([run.frame_pressure for run in unloaded])
    names = names_of(unloaded)
    largest_motion = max(tip_travel([run], arm.reach) for run in unloaded)
    if declared is not None:
        bends = largest_motion > BENDING_MOTION * arm.length
        check_meaning(unloaded, declared, arm, moves=bends)
    for run in unloaded:
        moves = tip_travel([run], arm.reach)
        is_constant = np.ptp(run.frame_pressure) < tolerance
        if is_constant and moves > HANGING_MOTION * arm.length:
            raise RecordingError(
                f'{run.name}: the pressure stays at {kilopascals(run.frame_pressure[0]):.3g} '
                f'kPa, but the unloaded arm moves by {millimeters(moves):.3g} mm. Is it the '
                'pressure of this arm (--topic pressure=...), and does the sensor work?',
                reason='pressure_still',
            )
    if constant:
        return
    if np.ptp(pressures) < tolerance:
        raise RecordingError(
            f'pressure spans {kilopascals(float(np.ptp(pressures))):.2g} kPa in {names}: kappa_p0 '
            'needs at least two pressures; record a ramp or a staircase',
            reason='one_pressure',
        )
    least = SMALLEST_MOTION * arm.length
    if largest_motion < least and tip_travel(unloaded, arm.reach) < least:
        raise RecordingError(
            f'{names}: the targets hardly move although the pressure changes; do the target '
            'topic and the pressure topic belong to the same arm?',
            reason='targets_still',
        )


def check_meaning(
    runs: Sequence[RecordingData], declared: PressureConvention, arm: Arm, *, moves: bool
) -> None:
    """Raise RecordingError if the pressures of recordings almost surely have another unit.

    At the start of a calibration, the pressure range of `arm` is a guess, so the readings may be
    from any soft actuator. declared: declared meaning of the readings; moves: whether the arm
    bends.
    """
    every = [[declared.reading(one) for one in run.frame_pressure.tolist()] for run in runs]
    readings = [one for of_run in every for one in of_run]
    ends = [of_run[end] for of_run in every for end in (0, -1)]
    # Of all recordings one may begin or end without pressure, whichever is listed first.
    record = replace(record_of(range(len(readings)), readings), first=min(ends, key=abs))
    verdict = judge_pressure(record, declared, [*ANY_ACTUATOR, expected_of(arm)], moves=moves)
    if verdict is not None and verdict.contradicted:
        raise RecordingError(
            f'{names_of(runs)}: the pressure is {verdict.finding}: add {verdict.options} (or '
            '--no-judge-readings if the readings are right)',
            reason='other_pressure',
        )


def largest_force(run: RecordingData) -> float:
    """Return the largest end force (N) of a recording."""
    return float(np.max(np.hypot(*run.force.T)))


def is_under_load(run: RecordingData, arm: Arm) -> bool:
    """Whether an end force is known, or read beyond offset and noise of the force sensor."""
    if run.load_known:
        return bool(run.load.any())
    noise = run.idle_reach() * arm.sensors.force_std
    return run.loaded and largest_force(run) > UNLOADED_FORCE * arm.weight + noise


def check_unloaded(run: RecordingData, arm: Arm) -> None:
    """Raise RecordingError if a recording given as unloaded has an end force."""
    if is_under_load(run, arm):
        raise RecordingError(
            f'{run.name} was given as unloaded, but its end force reaches '
            f'{largest_force(run):.3g} N; remove it from --unloaded (calibrate: list it after '
            '--loaded)',
            reason='loaded',
        )


def check_targets(run: RecordingData, arm: Arm) -> None:
    """Raise RecordingError if a recording has too few or unexpected targets."""
    if run.x.shape[1] != arm.target_arclength.size:
        raise RecordingError(
            f'{run.name} has {run.x.shape[1]} targets, but the arm has '
            f'{arm.target_arclength.size}; recordings of different arms cannot be calibrated '
            'together (see --arm)',
            reason='wrong_targets',
        )
    seen = np.count_nonzero(run.seen, axis=0) > 0
    if run.heading is not None:
        return  # the angle of the tip shows how far the arm bends
    if np.count_nonzero(seen) < FEWEST_TARGETS and not seen[-1]:
        raise RecordingError(
            f'{run.name} shows fewer than {FEWEST_TARGETS} targets, and never the last one',
            reason='too_few_targets',
        )


def check_units(run: RecordingData, arm: Arm) -> None:
    """Raise RecordingError if lengths or forces are implausible for any arm (wrong unit)."""
    highest = float(np.max(np.abs(run.frame_pressure)))
    if highest > LARGEST_PRESSURE:
        raise RecordingError(
            f'{run.name}: a pressure of {highest:.3g} Pa; pressure must be gauge, in Pa',
            reason='out_of_range',
        )
    if not run.seen.any():
        return  # an angle has one unit and does not depend on the position
    reach = float(np.nanmax(np.hypot(run.x, run.y)))
    if reach > DOMAIN.stretch * arm.reach:
        raise RecordingError(
            f'{run.name}: a target {reach:.3g} m from the clamp, but the arm is {arm.reach:.3g} '
            'm long; targets must be in m, in the base frame at the clamp, and belong to this '
            'arm (see --arm)',
            reason='other_length',
        )
    middle = np.nanmedian(np.hypot(run.x[:, -1], run.y[:, -1])) if run.seen[:, -1].any() else reach
    if middle < NEAREST_TIP * arm.length:
        raise RecordingError(
            f'{run.name}: the last target lies {middle:.3g} m from the clamp, but the arm is '
            f'{arm.length:.3g} m long. Is the unit right, and is the first target the one at the '
            'clamp?',
            reason='other_length',
        )
    share = row_share(run, arm)
    if share < SHORTEST_ROW:
        raise RecordingError(
            f'{run.name}: the row of targets is never longer than {share:.2g} times the row in '
            'the arm file. Is the unit of the targets right, and do they belong to this arm (see '
            '--arm)?',
            reason='other_length',
        )


def row_share(run: RecordingData, arm: Arm) -> float:
    """Return the longest row of targets relative to its arclength; 1 if few are seen."""
    chords = np.hypot(np.diff(run.x, axis=1), np.diff(run.y, axis=1))
    known = np.isfinite(chords)
    arcs = np.sum(known * np.diff(arm.target_arclength), axis=1)
    is_complete = np.count_nonzero(known, axis=1) + 1 >= FEWEST_TARGETS
    if not is_complete.any():
        return 1.0
    return float(np.max(np.nansum(chords, axis=1)[is_complete] / arcs[is_complete]))


def check_clamp(run: RecordingData, arm: Arm) -> None:
    """Raise RecordingError if the first target is at the free end, or if the clamp moves."""
    places = arm.target_arclength
    if numbered_from_tip(run.points, places):
        first, last = np.degrees(end_turns(run.points, places) or (0.0, 0.0))
        raise RecordingError(
            f'{run.name}: the targets are numbered from the free end, because the arm turns by '
            f'{first:.3g} degrees at target 0 and by {last:.3g} at target {places.size - 1}, but '
            'the clamp cannot turn. Track the film again with --clamp-pixel U V (clamp_pixel in '
            'the camera file), or reverse the ids',
            reason='wrong_end',
        )
    travel = clamp_motion(run.points, run.frame_pressure, places, arm.length)
    if travel > CLAMP_LOOSE * arm.length:
        raise RecordingError(
            f'{run.name}: the first target moves by {millimeters(travel):.3g} mm as the pressure '
            'changes, but a target at the clamp cannot move. Fix the clamp, or give the arclength '
            'of this target (target_arclength of --arm)',
            reason='clamp_moves',
        )


def describe_clamp(runs: Sequence[RecordingData], arm: Arm) -> tuple[Note, ...]:
    """Report recordings in which the clamp moves slightly with the pressure."""
    places = arm.target_arclength
    least = max(CLAMP_MOVES * arm.length, CLAMP_NOISE * arm.sensors.target_std)
    clamp_motions = {
        run.name: clamp_motion(run.points, run.frame_pressure, places, arm.length) for run in runs
    }
    loose = [
        f'{name} ({millimeters(size):.2g} mm)'
        for name, size in clamp_motions.items()
        if size > least
    ]
    if not loose:
        return ()
    return (
        Note(
            f'the first target moves as the pressure changes: {", ".join(loose)}. Either the '
            'clamp gives way or the camera moved. The model includes neither and treats this '
            'motion as noise',
            reason='clamp_moves',
        ),
    )


def tip_travel(runs: Sequence[RecordingData], reach: float) -> float:
    """Return the travel (m) of the last target ever seen, over all recordings.

    reach (m) of the arm. If only the heading of the tip is known, the travel is half the arc
    length.
    """
    if not any(run.seen.any() for run in runs):
        turns = np.concatenate([run.heading for run in runs if run.heading is not None])
        return 0.5 * reach * float(np.ptp(np.unwrap(turns[np.isfinite(turns)])))
    points = np.concatenate([run.points for run in runs])
    last = int(np.flatnonzero(np.isfinite(points[:, 0]).any(axis=0))[-1])
    tip = points[:, :, last]
    return float(np.hypot(*(np.nanmax(tip, axis=0) - np.nanmin(tip, axis=0))))


def names_of(runs: Sequence[RecordingData]) -> str:
    """List the names of recordings for a sentence."""
    return ', '.join(run.name for run in runs)

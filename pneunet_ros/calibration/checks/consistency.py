"""Consistency of recordings: an unloaded arm has one shape at each pressure."""

from __future__ import annotations

from collections.abc import Sequence
import itertools

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import CONSISTENCY
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters, NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inference.adequacy import ADEQUACY
from pneunet_ros.measurement.linearization import FittedRun

# Halved or doubled, these move no figure of acceptance/sweep.py.
TIMES_PAST = 3.0  # difference of two arms, relative to that by history
SAME_PRESSURE = 0.01  # of the largest
ANOTHER_TIME = 0.2  # of a recording: frames so far apart show the history of the arm
FEWEST_PAIRS = 5  # of frames at one pressure
REST = 1.0  # s, after which a pressure line is filled
# Of the range, noise of the pressure that biases the fit: kappa_p0 of the virtual lab is off by
# 1.4 standard errors rms at 0.015, and by 2.2 at 0.023.
NOISY_PRESSURE = 0.018
EARLY = 0.25  # s by which a film may be early: the prior of camera_delay, and a frame


def check_same_arm(unloaded: Sequence[RecordingData], length: float) -> None:
    """Raise RecordingError, with both names, if unloaded recordings show different arms.

    length (m) of the arm. Hysteresis and creep make an arm differ from itself: this difference is
    measured where a recording returns to a pressure. Because of the tube, a moving arm lags behind
    its sensor, so of a run with enough frames after a rest only these are compared.
    """
    top = max((float(np.max(np.abs(run.frame_pressure))) for run in unloaded), default=0.0)
    self_distances = [tip_distance(run, run, top) for run in unloaded]
    known = [item for item in self_distances if item is not None]
    limit = 2.0 * CONSISTENCY.two_arms * length
    if known:
        limit = max(CONSISTENCY.two_arms * length, TIMES_PAST * max(known))
    for one, other in itertools.combinations(unloaded, 2):
        distance = tip_distance(one, other, top)
        if distance is not None and distance > limit:
            raise RecordingError(
                f'{one.name} and {other.name} contradict each other: at the same pressure and '
                f'without a load, the ends of the arm are {millimeters(distance):.2g} mm apart. '
                'Recordings of different arms or pressure sensors cannot be calibrated together',
                reason='inconsistent',
            )


def tip_distance(one: RecordingData, other: RecordingData, top: float) -> float | None:
    """Return the distance (m) of the last target at equal pressures; None if there are none.

    Positions are relative to the first target, so that the camera position does not matter. If a
    run is compared with itself, only frames at different times are used. top: the largest pressure
    (Pa).
    """
    first, second = chord(one), chord(other)
    frames = [has_rested(run, top) for run in (one, other)]
    # A slow ramp never rests: compare it with the rested frames of the other run.
    rested = [item if item.sum() >= FEWEST_PAIRS else np.ones_like(item) for item in frames]
    found, resting = list[Array](), list[npt.NDArray[np.bool_]]()
    for frame in range(len(one.stamp_ns)):  # all pairs at once do not fit into the memory
        pressure_change = np.abs(other.frame_pressure - one.frame_pressure[frame])
        pairs = pressure_change < SAME_PRESSURE * top
        if one is other:
            pairs &= np.abs(one.progress - one.progress[frame]) > ANOTHER_TIME
        distance = np.hypot(*(first[:, frame, None] - second))
        pairs &= np.isfinite(distance)
        found.append(distance[pairs])
        resting.append(rested[0][frame] & rested[1][pairs])
    distance, resting_pair = np.concatenate(found), np.concatenate(resting)
    distance = distance[resting_pair] if resting_pair.sum() >= FEWEST_PAIRS else distance
    return float(np.percentile(distance, 90.0)) if distance.size >= FEWEST_PAIRS else None


def has_rested(run: RecordingData, top: float) -> npt.NDArray[np.bool_]:
    """Return the frames (frames,) after a sufficiently long rest of the pressure.

    The pressure must also rest for a while after these frames, because film stamps may be early.
    top: the largest pressure (Pa).
    """
    if run.static:
        return np.ones(len(run.stamp_ns), np.bool_)
    stamps = run.reading_stamp_ns
    before, after = (round(seconds * NANOSECONDS_PER_SECOND) for seconds in (REST, EARLY))
    first, last = (
        np.searchsorted(stamps, stamps - before),
        np.searchsorted(stamps, stamps + after),
    )
    swing = [
        np.ptp(run.pressure[first[index] : max(last[index], index + 1)]) for index in run.reading
    ]
    shown = stamps[run.reading]
    known = (shown - stamps[0] >= before) & (stamps[-1] - shown >= after)
    rested: npt.NDArray[np.bool_] = known & (np.array(swing) < 2.0 * SAME_PRESSURE * top)
    return rested


def chord(run: RecordingData) -> Array:
    """Return the vector from the first to the last target among those ever seen, (2, frames) m."""
    ever = np.flatnonzero(run.seen.any(axis=0))
    first, last = ever[0], ever[-1]
    return np.stack([run.x[:, last] - run.x[:, first], run.y[:, last] - run.y[:, first]])


def describe_misfit(fit: Fit) -> list[Note]:
    """Return a sentence if the misfit is much larger than noise can explain."""
    chi_squared = fit.chi_squared / max(fit.dof, 1)
    if chi_squared < CONSISTENCY.misfit:
        return []
    few = None if outlier_recordings(fit) else misfit_of_few(fit)
    if few is not None:
        return [few]
    residual = np.concatenate([run.residual[run.solved].ravel() for run in fit.runs])
    seen = residual[np.isfinite(residual)]
    missed = 'the heading of the tip by'
    if seen.size:
        rms = float(np.sqrt(np.mean(seen**2)))
        missed = f'the targets by {millimeters(rms):.3g} mm rms per coordinate,'
    return [
        Note(
            f'the model misses {missed} '
            f'{np.sqrt(chi_squared):.2g} times the noise: an effect is missing, or the noise is '
            'correlated from frame to frame (smoothed tracks). The standard errors are too small. '
            'Run `pneunet diagnose`',
            reason='misfit',
        )
    ]


def misfit_of_few(fit: Fit) -> Note | None:
    """Return a note if only a few frames misfit; None if many do, or none."""
    counts = [run.dof > 0 for run in fit.runs]
    whitened, dof = (
        np.concatenate([values[counted] for values, counted in zip(parts, counts, strict=True)])
        for parts in ([run.whitened for run in fit.runs], [run.dof for run in fit.runs])
    )
    worst = np.argsort(-whitened / dof)[: round(ADEQUACY.outside * dof.size)]
    missed = worst[whitened[worst] > CONSISTENCY.misfit * dof[worst]]
    remaining = np.delete(np.arange(dof.size), worst)
    if not missed.size or whitened[remaining].sum() > CONSISTENCY.as_noise * dof[remaining].sum():
        return None
    run_of = np.repeat(np.arange(len(fit.runs)), [int(counted.sum()) for counted in counts])
    where = ', '.join(
        f'{count} of {fit.runs[which].run.name}'
        for which, count in zip(*np.unique(run_of[missed], return_counts=True), strict=True)
    )
    cause = 'check the targets there'
    if any(run.run.loaded for run in fit.runs):
        cause = (
            'near a load at which the arm snaps, the noise of the force sensor decides between '
            'two shapes. Reduce that noise, keep away from such loads, or check the targets there'
        )
    return Note(
        f'{missed.size} of {dof.size} frames deviate by far more than noise ({where}), the '
        f'others do not: the standard errors are too small; {cause}',
        reason='few_misfit',
    )


def describe_pressure_noise(pressure_std: float, span: float) -> list[Note]:
    """Return a sentence if the pressure noise (Pa) is large enough to bias the errors.

    span (Pa) of the pressures. Quantities proportional to pressure are underestimated on average:
    errors in variables.
    """
    if not pressure_std > NOISY_PRESSURE * span > 0.0:
        return []
    return [
        Note(
            f'the noise of the pressure is {100.0 * pressure_std / span:.2g} % of its range: the '
            'standard errors are too small (in the virtual lab by a factor of 2.2 at 2.3 %, and '
            'of 3.6 at 3 %). Average its readings before recording them, or use a better sensor',
            reason='noisy_pressure',
        )
    ]


def outlier_recordings(fit: Fit) -> list[Note]:
    """Return a note on each recording with a much larger misfit than the others.

    The few worst frames of each recording are ignored.
    """
    chi = np.array([typical_chi_squared(item) for item in fit.runs])
    notes = []
    for which, item in enumerate(fit.runs):
        rest = np.delete(chi, which)
        if rest.size and chi[which] > CONSISTENCY.outlier * max(1.0, float(np.median(rest))):
            notes.append(
                Note(
                    f'{item.run.name} does not fit the others: its chi squared per coordinate is '
                    f'{chi[which]:.3g}, that of the others is {np.median(rest):.3g}. Is it of '
                    'the same arm, with the same sensors?',
                    reason='outlier',
                )
            )
    return notes


def typical_chi_squared(run: FittedRun) -> float:
    """Return the chi squared per coordinate of a run, without its few worst frames."""
    order = np.argsort(run.whitened / np.maximum(run.dof, 1))
    kept = order[: order.size - round(ADEQUACY.outside * order.size)]
    return float(run.whitened[kept].sum()) / max(int(run.dof[kept].sum()), 1)

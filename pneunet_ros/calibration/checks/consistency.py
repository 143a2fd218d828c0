"""Consistency of recordings: unloaded and at one pressure, an arm has one shape."""

from __future__ import annotations

from collections.abc import Sequence
import itertools

import numpy as np
import numpy.typing as npt
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import CONSISTENCY, SameArmSettings
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters, NANOSECONDS_PER_SECOND
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.linearization import FittedRun


def check_same_arm(
    unloaded: Sequence[RecordingData],
    length: float,
    settings: SameArmSettings = CONSISTENCY,
) -> None:
    """Raise RecordingError, naming the two, where unloaded recordings are of different arms.

    length (m) of the arm. Hysteresis and creep make one arm differ, too: how much is seen where a
    recording comes back to a pressure. What moves lags behind its sensor by as much as the line is
    long, so that frames after a rest are compared where there are enough.
    """
    top = max((float(np.max(np.abs(run.frame_pressure))) for run in unloaded), default=0.0)
    past = [tip_distance(run, run, top, settings) for run in unloaded]
    seen = [item for item in past if item is not None]
    limit = settings.two_arms_unknown * length
    if seen:
        limit = max(settings.two_arms * length, settings.times_past * max(seen))
    for one, other in itertools.combinations(unloaded, 2):
        distance = tip_distance(one, other, top, settings)
        if distance is not None and distance > limit:
            raise RecordingError(
                f'{one.name} and {other.name} contradict each other: at the same pressure and '
                f'without a load the ends of the arm are {millimeters(distance):.2g} mm apart; '
                'recordings of different arms, or of another pressure sensor, cannot be '
                'calibrated together',
                reason='inconsistent',
            )


def tip_distance(
    one: RecordingData, other: RecordingData, top: float, settings: SameArmSettings
) -> float | None:
    """Return the distance (m) of the last target between equal pressures; None: no equal ones.

    Relative to the first target, so that the camera's place does not matter. Of a run with itself
    only frames at different times count. top: the largest pressure (Pa).
    """
    first, second = chord(one), chord(other)
    rested = [has_rested(run, top, settings) for run in (one, other)]
    found, resting = list[Array](), list[npt.NDArray[np.bool_]]()
    for frame in range(len(one.stamp_ns)):  # all pairs at once do not fit into the memory
        same = np.abs(other.frame_pressure - one.frame_pressure[frame])
        pairs = same < settings.same_pressure * top
        if one is other:
            pairs &= np.abs(one.progress - one.progress[frame]) > settings.another_time
        distance = np.hypot(*(first[:, frame, None] - second))
        pairs &= np.isfinite(distance)
        found.append(distance[pairs])
        resting.append(rested[0][frame] & rested[1][pairs])
    distance, still = np.concatenate(found), np.concatenate(resting)
    distance = distance[still] if still.sum() >= settings.fewest_pairs else distance
    return float(np.percentile(distance, 90.0)) if distance.size >= settings.fewest_pairs else None


def has_rested(run: RecordingData, top: float, settings: SameArmSettings) -> npt.NDArray[np.bool_]:
    """Return the frames (frames,) that follow a long enough rest of the pressure.

    It rests for a while after them, too: film stamps may be early, so that frames show a later
    time. top: the largest pressure (Pa).
    """
    if run.static:
        return np.ones(len(run.stamp_ns), np.bool_)
    stamps = run.reading_stamp_ns
    before, after = (
        round(seconds * NANOSECONDS_PER_SECOND) for seconds in (settings.rest, settings.clocks)
    )
    began, ended = (
        np.searchsorted(stamps, stamps - before),
        np.searchsorted(stamps, stamps + after),
    )
    swing = [np.ptp(run.pressure[began[at] : max(ended[at], at + 1)]) for at in run.reading]
    shown = stamps[run.reading]
    known = (shown - stamps[0] >= before) & (stamps[-1] - shown >= after)
    rested: npt.NDArray[np.bool_] = known & (np.array(swing) < 2.0 * settings.same_pressure * top)
    return rested


def chord(run: RecordingData) -> Array:
    """Return the vector from the first to the last target that is ever seen, (2, frames) m."""
    ever = np.flatnonzero(run.seen.any(axis=0))
    first, last = ever[0], ever[-1]
    return np.stack([run.x[:, last] - run.x[:, first], run.y[:, last] - run.y[:, first]])


def describe_misfit(fit: Fit, settings: SameArmSettings = CONSISTENCY) -> list[Note]:
    """Return a sentence where the model misses the targets by much more than noise can explain."""
    chi_squared = fit.chi_squared / max(fit.dof, 1)
    if chi_squared < settings.misfit:
        return []
    few = None if outlier_recordings(fit, settings) else misfit_of_few(fit, settings)
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
            f'{np.sqrt(chi_squared):.2g} times the noise: an effect is missing, and the standard '
            'errors are too small. Run `pneunet diagnose`',
            reason='misfit',
        )
    ]


def misfit_of_few(fit: Fit, settings: SameArmSettings) -> Note | None:
    """Return the note that only a few frames misfit; None if more do, or none."""
    counts = [run.dof > 0 for run in fit.runs]
    whitened, dof = (
        np.concatenate([values[here] for values, here in zip(parts, counts, strict=True)])
        for parts in ([run.whitened for run in fit.runs], [run.dof for run in fit.runs])
    )
    worst = np.argsort(-whitened / dof)[: round(settings.few_frames * dof.size)]
    missed = worst[whitened[worst] > settings.misfit * dof[worst]]
    others = np.delete(np.arange(dof.size), worst)
    if not missed.size or whitened[others].sum() > settings.others_fit * dof[others].sum():
        return None
    run_of = np.repeat(np.arange(len(fit.runs)), [int(here.sum()) for here in counts])
    where = ', '.join(
        f'{count} of {fit.runs[which].run.name}'
        for which, count in zip(*np.unique(run_of[missed], return_counts=True), strict=True)
    )
    cause = 'look at the targets there'
    if any(run.run.loaded for run in fit.runs):
        cause = (
            'near a load at which the arm snaps the noise of a force sensor decides between two '
            'shapes; read the force with less noise, keep away from such loads, or look at the '
            'targets there'
        )
    return Note(
        f'{missed.size} of {dof.size} frames deviate by far more than noise ({where}), unlike the '
        f'others: the standard errors are too small; {cause}',
        reason='few_misfit',
    )


def describe_pressure_noise(
    pressure_std: float, span: float, settings: SameArmSettings = CONSISTENCY
) -> list[Note]:
    """Return a sentence where the pressure (Pa) is read with so much noise that errors are biased.

    span (Pa): of the pressures. What is proportional to pressure, on average, is taken for less:
    errors in variables.
    """
    if not pressure_std > settings.noisy_pressure * span > 0.0:
        return []
    return [
        Note(
            f'the noise of the pressure is {100.0 * pressure_std / span:.2g} % of its range: the '
            'standard errors are too small (in the virtual lab by a factor of 2.2 at 2.3 %, and '
            'of 3.6 at 3 %); average its readings before they are recorded, or take a better '
            'sensor',
            reason='noisy_pressure',
        )
    ]


def outlier_recordings(fit: Fit, settings: SameArmSettings = CONSISTENCY) -> list[Note]:
    """Return a note on each recording with a much larger misfit than the others.

    A few frames of a recording, which it says worst, do not count.
    """
    chi = np.array([typical_chi_squared(item, settings) for item in fit.runs])
    notes = []
    for which, item in enumerate(fit.runs):
        others = np.delete(chi, which)
        if others.size and chi[which] > max(
            settings.outlier, settings.times_others * float(np.median(others))
        ):
            notes.append(
                Note(
                    f'{item.run.name} does not fit the others: chi squared per coordinate is '
                    f'{chi[which]:.3g}, theirs {np.median(others):.3g}; is it of the same arm, '
                    'with the same sensors?',
                    reason='outlier',
                )
            )
    return notes


def typical_chi_squared(run: FittedRun, settings: SameArmSettings) -> float:
    """Return the chi squared per coordinate of a run without a few frames, the worst."""
    order = np.argsort(run.whitened / np.maximum(run.dof, 1))
    kept = order[: order.size - round(settings.few_frames * order.size)]
    return float(run.whitened[kept].sum()) / max(int(run.dof[kept].sum()), 1)

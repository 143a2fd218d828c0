"""Inertia as a missing effect: swinging frames, with a static and a moving arm.

A diagnosis tests the statics with frames at rest. The other frames are explained either by mass
and damping, fitted to the training recordings, or not at all. Held-out recordings are predicted
with the fitted values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.calibration.motion.motion_fit import (
    fit_motion,
    MotionFit,
    predicted_motion,
    unexplained_swing,
)
from pneunet_ros.calibration.motion.motion_problem import Flags
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.units import millimeters, quantities
from pneunet_ros.diagnosis.evaluation import distances, noise_floor, removed_share
from pneunet_ros.diagnosis.investigation import Investigation
from pneunet_ros.diagnosis.result import Detectable, Diagnosis, Estimated, Misfit, NamedEffect
from pneunet_ros.diagnosis.settings import CONFIRMATION
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inference.adequacy import SIGNIFICANT_FALL
from pneunet_ros.model.uncertainty import SensorNoise

NAME = Inertia.name
NO_FALL = 'the held-out error does not fall significantly with it'


@dataclass(frozen=True, slots=True, eq=False)
class Swings:
    """Residuals of targets in recordings with motion, per run (frames, 2, targets) m.

    still: residuals of the equilibrium; left: residuals of the moving arm; swung: the moving arm
    minus the equilibrium; rest (frames,): frames in which the arm is at equilibrium.
    """

    still: tuple[Array, ...]
    left: tuple[Array, ...]
    swung: tuple[Array, ...]
    rest: tuple[Flags, ...]

    def misfit(self, residuals: Sequence[Array], at_rest: Misfit) -> Misfit:
        """Return the size of residuals relative to the noise of an arm at rest."""
        every = np.concatenate([item.ravel() for item in residuals])
        squares = every[np.isfinite(every)] ** 2
        lengths = np.concatenate([distances(item) for item in residuals])
        return Misfit(
            rms=math.sqrt(float(squares.mean())),
            p95=float(np.percentile(lengths, 95.0)),
            chi_squared=at_rest.chi_squared * float(squares.mean()) / at_rest.rms**2,
        )

    def objection(self, floor: float) -> str:
        """Return why a moving arm does not fit the swings; floor (m): rms of the noise."""
        moving = [~item for item in self.rest]
        left, swing = (mean_square(item, moving) for item in (self.left, self.swung))
        return unexplained_swing(left, floor**2, swing)

    def fall(self, floor: float) -> float:
        """Return the reduction of chi squared by the moving arm; floor (m): of noise."""
        squares = (
            one[~rest] ** 2 - other[~rest] ** 2
            for one, other, rest in zip(self.still, self.left, self.rest, strict=True)
        )
        return sum(float(np.nansum(item)) for item in squares) / floor**2


def mean_square(residuals: Sequence[Array], chosen: Sequence[Flags]) -> float:
    """Return the mean square (m^2) of residuals in some of the frames; 0 if there are none."""
    every = np.concatenate(
        [item[which].ravel() for item, which in zip(residuals, chosen, strict=True)]
    )
    known = every[np.isfinite(every)]
    return float(np.mean(known**2)) if known.size else 0.0


def with_frames_in_motion(
    found: Investigation,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    moving: Sequence[Flags],
) -> Investigation:
    """Return an investigation that also tests for missing inertia (`with_inertia`)."""
    noise = found.selection.linearization.noise
    diagnosis = with_inertia(found.diagnosis, training, held_out, moving, noise)
    at_rest = diagnosis.answer == found.diagnosis.answer
    return replace(found, diagnosis=diagnosis, trial=found.trial if at_rest else found.base)


def with_inertia(
    diagnosis: Diagnosis,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    moving: Sequence[Flags],
    noise: SensorNoise,
) -> Diagnosis:
    """Extend a diagnosis by a test for missing inertia.

    training, held_out: with the swinging frames; moving: masks of the swinging frames, per
    recording; noise: of the sensors in these recordings.
    """
    arm = diagnosis.after.arm
    if is_known(diagnosis):
        return diagnosis
    count = len(training)
    known, others = (
        swinging_runs(part, flags)
        for part, flags in ((training, moving[:count]), (held_out, moving[count:]))
    )
    if not known:
        return replace(diagnosis, detectable=detectable(diagnosis, math.inf))
    try:
        fit = fit_motion(arm, known)
    except RequestError as error:
        note = f'inertia was not fitted: {error}'
        return replace(diagnosis, notes=(*diagnosis.notes, note))
    swings = [Swings(*predicted_motion(arm, fit.motion, part)) for part in (known, others) if part]
    rested = diagnosis.after.training, diagnosis.after.held_out or diagnosis.after.training
    floors = [
        math.sqrt(max(rest.chi_squared, 1.0)) * noise_floor(arm, part, noise)[0]
        for part, rest in zip((known, others), rested, strict=True)
    ]
    objections = [one.objection(floor) for one, floor in zip(swings, floors, strict=False)]
    if others and swings[-1].fall(floors[-1]) < SIGNIFICANT_FALL:
        objections.append(NO_FALL)
    if any(objections) or diagnosis.answer == 'unknown':
        why = next((one for one in objections if one), 'the frames at rest are not explained')
        return not_named(diagnosis, fit, why)
    pairs = [
        (one.misfit(one.still, rest), one.misfit(one.left, rest))
        for one, rest in zip(swings, rested, strict=False)
    ]
    before, after = diagnosis.before, diagnosis.after
    before, after = replace(before, training=pairs[0][0]), replace(after, training=pairs[0][1])
    if others:
        before = replace(before, held_out=pairs[1][0])
        after = replace(after, held_out=pairs[1][1])
    return name_inertia(replace(diagnosis, before=before, after=after), fit, tested=bool(others))


def is_known(diagnosis: Diagnosis) -> bool:
    """Whether the model already has inertia, or the name is excluded."""
    withheld = diagnosis.settings.withheld
    return diagnosis.after.arm.inertia is not None or NAME in withheld


def not_named(diagnosis: Diagnosis, fit: MotionFit, why: str) -> Diagnosis:
    """Return a diagnosis with the reason why inertia is not named."""
    return replace(
        diagnosis,
        detectable=detectable(diagnosis, 2.0 * fit.damping_time_std),
        notes=(
            *diagnosis.notes,
            Note(f'{fit.sentence}. inertia is not named: {why}', reason='closest'),
        ),
    )


def swinging_runs(runs: Sequence[RecordingData], moving: Sequence[Flags]) -> list[RecordingData]:
    """Return the recordings in which the arm swings; only unloaded ones if there are any."""
    return unloaded_runs([run for run, flags in zip(runs, moving, strict=True) if flags.any()])


def unloaded_runs(runs: Sequence[RecordingData]) -> list[RecordingData]:
    """Return the recordings without a load, or all if there are none.

    Under a load the noise of the force sensor disturbs the predicted motion.
    """
    return [run for run in runs if not run.loaded] or [*runs]


def detectable(diagnosis: Diagnosis, smallest: float) -> Mapping[str, Detectable]:
    """Return detection limits with that of inertia, a damping time (s)."""
    time = next(item for item in quantities(Inertia) if item.name == 'damping_time')
    limit = Detectable(
        parameter=time.name,
        observable=math.isfinite(smallest),
        smallest=smallest,
        expected=time.metadata['prior'],
        unit=time.metadata['unit'],
    )
    return {**diagnosis.detectable, NAME: limit}


def name_inertia(diagnosis: Diagnosis, fit: MotionFit, *, tested: bool) -> Diagnosis:
    """Return a diagnosis that names inertia in addition to its other effects.

    The models before and after are evaluated on recordings that show the motion; tested: whether
    held-out recordings are among them.
    """
    effect = NamedEffect(
        name=NAME,
        parameters={
            'tip_mass': Estimated(value=fit.motion.tip_mass, std=fit.tip_mass_std, unit='kg'),
            'damping_time': Estimated(
                value=fit.motion.damping_time, std=fit.damping_time_std, unit='s'
            ),
        },
        probability=1.0 - (CONFIRMATION.wrong if tested else CONFIRMATION.unconfirmed),
    )
    before, after = diagnosis.before.rms, diagnosis.after.rms
    start, end = (f'{millimeters(rms):.2f}' for rms in (before, after))
    sentence = (
        f'The model lacks {NAME}: adding it reduces the model error of recordings in which the '
        f'arm moves from {start} to {end} mm rms.'
    )
    if diagnosis.effects:
        sentence = f'{diagnosis.sentence} {sentence}'
    return replace(
        diagnosis,
        answer='inseparable' if diagnosis.answer == 'inseparable' else 'named',
        sentence=sentence,
        certainty=f'{diagnosis.certainty} {fit.sentence}.',
        effects=(*diagnosis.effects, effect),
        detectable=detectable(diagnosis, 2.0 * fit.damping_time_std),
        after=replace(diagnosis.after, arm=fit.apply_to(diagnosis.after.arm)),
        closed=removed_share(before, after, diagnosis.noise_floor),
    )

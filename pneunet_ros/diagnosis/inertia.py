"""Inertia as a missing effect: swinging frames, with a static and a moving arm.

A diagnosis judges statics by frames at rest. What the others show is either the arm with its mass
and damping, which are fitted to the training recordings, or nothing of the library. Held-out
recordings are predicted by what was fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.calibration.checks.frames_in_motion import FramesInMotion
from pneunet_ros.calibration.motion_fit import fit_motion, Flags, MotionFit, predicted_motion
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.evaluation import distances, noise_floor, removed_share
from pneunet_ros.diagnosis.result import Detectable, Diagnosis, Estimated, Misfit, NamedEffect
from pneunet_ros.effects.inertia import Inertia
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise

NAME = Inertia.name


@dataclass(frozen=True, slots=True, eq=False)
class Swings:
    """Distance of targets from an arm in recordings, per run (frames, 2, targets) m.

    still: beside its equilibrium; left: beside the moving arm; swung: how far this is beside its
    equilibrium; rest (frames,): the frames in which it is there.
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
        """Explain why the moving arm fails to explain the swings; empty if it does.

        It may be beside them by what noise does (rms floor, m), and by what no arm follows its
        law.
        """
        moving = [~item for item in self.rest]
        left = mean_square(self.left, moving)
        allowed = floor**2 + Inertia.law_error**2 * mean_square(self.swung, moving)
        if left <= allowed:
            return ''
        return (
            f'targets are {millimeters(math.sqrt(left)):.2g} mm off the moving arm, and '
            f'noise alone would be {millimeters(math.sqrt(allowed)):.2g} mm'
        )

    def fall(self, floor: float) -> float:
        """Return the reduction of chi squared by the moving arm; floor (m): of noise."""
        squares = (
            one[~rest] ** 2 - other[~rest] ** 2
            for one, other, rest in zip(self.still, self.left, self.rest, strict=True)
        )
        return sum(float(np.nansum(item)) for item in squares) / floor**2


def mean_square(residuals: Sequence[Array], chosen: Sequence[Flags]) -> float:
    """Return the mean square (m^2) of residuals in some of the frames; 0 where there are none."""
    every = np.concatenate(
        [item[which].ravel() for item, which in zip(residuals, chosen, strict=True)]
    )
    known = every[np.isfinite(every)]
    return float(np.mean(known**2)) if known.size else 0.0


def with_inertia(
    diagnosis: Diagnosis,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    motion: FramesInMotion | None,
    noise: SensorNoise,
) -> Diagnosis:
    """Return a diagnosis extended by whether inertia is missing.

    training, held_out: with the frames that swing; motion: which these are, None: none;
    noise: of the sensors in these recordings.
    """
    arm = diagnosis.after.arm
    if arm.inertia is not None or NAME in diagnosis.settings.hypothesis.withheld:
        return diagnosis
    if motion is None:
        return replace(diagnosis, detectable=detectable(diagnosis, math.inf))
    count = len(training)
    known, others = (
        in_motion(part, flags)
        for part, flags in ((training, motion.moving[:count]), (held_out, motion.moving[count:]))
    )
    if not known:
        return replace(diagnosis, detectable=detectable(diagnosis, math.inf))
    try:
        fit = fit_motion(arm, known)
    except RequestError as error:
        note = f'{motion.sentence}; inertia was not fitted: {error}'
        return replace(diagnosis, notes=(*diagnosis.notes, note))
    found = replace(diagnosis, detectable=detectable(diagnosis, 2.0 * fit.damping_time_std))
    swings = [Swings(*predicted_motion(arm, fit.motion, part)) for part in (known, others) if part]
    rested = diagnosis.after.training, diagnosis.after.held_out or diagnosis.after.training
    floors = [
        math.sqrt(max(rest.chi_squared, 1.0)) * noise_floor(arm, part, noise)[0]
        for part, rest in zip((known, others), rested, strict=True)
    ]
    objections = [one.objection(floor) for one, floor in zip(swings, floors, strict=False)]
    if others and swings[-1].fall(floors[-1]) < diagnosis.settings.confirmation.fall:
        objections.append('the held-out error does not fall significantly with it')
    if any(objections) or diagnosis.answer == 'unknown':
        why = next((one for one in objections if one), 'the arm at rest is not explained')
        note = f'{fit.sentence}. inertia is not named: {why}'
        return replace(found, notes=(*diagnosis.notes, note))
    return named(found, fit, list(zip(swings, rested, strict=False)), tested=bool(others))


def in_motion(runs: Sequence[RecordingData], moving: Sequence[Flags]) -> list[RecordingData]:
    """Return the recordings of a swinging arm, only unloaded ones if there are any.

    Under a load the noise of the force sensor shakes what is expected of the arm.
    """
    shown = [run for run, flags in zip(runs, moving, strict=True) if flags.any()]
    return [run for run in shown if not run.loaded] or shown


def detectable(diagnosis: Diagnosis, smallest: float) -> Mapping[str, Detectable]:
    """Return detection limits with that of inertia, a damping time (s)."""
    limit = Detectable(
        parameter='damping_time', observable=math.isfinite(smallest), smallest=smallest, unit='s'
    )
    return {**diagnosis.detectable, NAME: limit}


def named(
    diagnosis: Diagnosis,
    fit: MotionFit,
    swings: Sequence[tuple[Swings, Misfit]],
    *,
    tested: bool,
) -> Diagnosis:
    """Return a diagnosis that names inertia in addition.

    swings: with the misfit of the same recordings where the arm is at rest.
    """
    known = diagnosis.settings.confirmation
    effect = NamedEffect(
        name=NAME,
        parameters={
            'tip_mass': Estimated(value=fit.motion.tip_mass, std=fit.tip_mass_std, unit='kg'),
            'damping_time': Estimated(
                value=fit.motion.damping_time, std=fit.damping_time_std, unit='s'
            ),
        },
        probability=1.0 - (known.wrong if tested else known.unconfirmed),
    )
    pairs = [(one.misfit(one.still, rest), one.misfit(one.left, rest)) for one, rest in swings]
    before, after = diagnosis.before, diagnosis.after
    before = replace(before, training=pairs[0][0])
    after = replace(after, training=pairs[0][1], arm=moving(after.arm, fit))
    if tested:
        before = replace(before, held_out=pairs[1][0])
        after = replace(after, held_out=pairs[1][1])
    start, end = (f'{millimeters(one.rms):.2f}' for one in (before, after))
    sentence = (
        f'The model lacks {NAME}: adding it reduces the model error of recordings in which the '
        f'arm swings from {start} to {end} mm rms.'
    )
    if diagnosis.effects:
        sentence = f'{diagnosis.sentence} {sentence}'
    return replace(
        diagnosis,
        answer='inseparable' if diagnosis.answer == 'inseparable' else 'named',
        sentence=sentence,
        certainty=f'{diagnosis.certainty} {fit.sentence}.',
        effects=(*diagnosis.effects, effect),
        before=before,
        after=after,
        closed=removed_share(before.rms, after.rms, diagnosis.noise_floor),
    )


def moving(arm: Arm, fit: MotionFit) -> Arm:
    """Return an arm with the fitted motion."""
    return replace(arm, motion=fit.motion, sources={**arm.sources, 'motion': fit.sentence})

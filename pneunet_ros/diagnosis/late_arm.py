"""Inertia as the cause of a delay, if the arm does not swing in any frame.

On slow ramps, damping delays an arm in the same way as a late camera or a slowly filling line. If
one of these is the named or the closest effect, mass and damping are fitted to all frames, the
swing is subtracted, the search is repeated, and the evidence decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from pneunet_ros.calibration.motion.motion_fit import fit_motion, MotionFit, without_swing
from pneunet_ros.calibration.motion.motion_problem import DIFFERENCE_STEP
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.evaluation import adequacy
from pneunet_ros.diagnosis.fit.augmented_model import augment_model, fit_with_effects
from pneunet_ros.diagnosis.fit.law_errors import MAY_LEAVE
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.diagnosis.fit.refit import effects_of
from pneunet_ros.diagnosis.inertia import (
    detectable,
    is_known,
    NAME,
    name_inertia,
    NO_FALL,
    not_named,
    unloaded_runs,
)
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.result import Diagnosis, Evaluation, Evidence
from pneunet_ros.diagnosis.scores.lack_of_fit import worst_p_value
from pneunet_ros.diagnosis.selection import Record, Trial
from pneunet_ros.diagnosis.settings import LEAST_EVIDENCE
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inference.adequacy import SIGNIFICANT_FALL
from pneunet_ros.measurement.moving_arm import WEIGHT_ERROR, WITHIN_95
from pneunet_ros.model.arm import Arm

LATE = CameraDelay.name, PressureLag.name  # other causes of a delay of the arm
MOST_ROUNDS = 5  # rounds of fits and searches: a missing effect biases mass and damping
TRUSTED = WITHIN_95 * WEIGHT_ERROR  # of a weight in a model file

Search = Callable[
    ..., Investigation | UnsettledInvestigation
]  # of training and held-out recordings


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """Fitted mass and damping, and the diagnosis of recordings with their swing subtracted."""

    fit: MotionFit
    found: Investigation

    @property
    def log_probability(self) -> float:
        """Log probability of the training recordings (`log_densities`)."""
        return log_densities(self.found, self.found.best)[0]


def with_late_arm(
    found: Investigation,
    search: Search,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
) -> Investigation:
    """Return an investigation that also tests inertia as the cause of a delay."""
    at_rest, rival = found.diagnosis, found.best
    if is_known(at_rest):
        return found
    moving = (
        subtract_motion(found, search, training, held_out) if is_late(at_rest, rival) else None
    )
    shown = math.inf if moving is None else 2.0 * moving.fit.damping_time_std
    at_rest = replace(at_rest, detectable=detectable(at_rest, shown))
    if moving is None:
        return replace(found, diagnosis=at_rest)
    gained = moving.log_probability - log_densities(found, rival)[0]
    row = evidence_of(moving.found.best, rival, gained)
    at_rest = replace(at_rest, evidence=(*at_rest.evidence, row))
    found = replace(found, diagnosis=at_rest)
    if gained < -LEAST_EVIDENCE:
        return found
    diagnosis = judged(found, moving, row, tested=bool(held_out))
    if gained > LEAST_EVIDENCE:
        if diagnosis.answer == 'unknown':
            notes = (*at_rest.notes, diagnosis.notes[-1])
            return replace(found, diagnosis=replace(at_rest, notes=notes))
        return replace(moving.found, diagnosis=diagnosis)
    if 'unknown' in (at_rest.answer, diagnosis.answer):
        return found
    return replace(found, diagnosis=inseparable(at_rest))


def is_late(diagnosis: Diagnosis, best: Trial) -> bool:
    """Whether a named or alternative effect delays the arm."""
    return not {*best.names, *diagnosis.alternatives}.isdisjoint(LATE)


def subtract_motion(
    found: Investigation,
    search: Search,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
) -> Moving | None:
    """Fit mass and damping, and search recordings minus the swing; None if no fit is found.

    Starts from the effects found without motion, because some of them may imitate it: a late
    camera resembles damping. The parameters of these effects are fitted too, to first order. The
    fit is repeated with the effects that the search finds, as long as the recordings become more
    probable. As for any effect, a fraction of the misfit of the model without inertia may remain.
    """
    allowed = MAY_LEAVE * found.base.record.excess
    swinging, moving, near, trial = unloaded_runs(training), None, None, found.best
    try:
        for _ in range(MOST_ROUNDS):
            arm, nearby = found_arm(trial)
            # On ramps, errors of the static model look like a part of the mass. An arm without
            # mass, delayed for another reason, would fit best with almost no weight.
            fit = fit_motion(
                arm, swinging, start_motion=near, perturbed_arms=nearby, trusted_error=TRUSTED
            )
            arm = arm_towards(arm, trial, fit.shares)
            result = search(
                *(without_swing(arm, fit.motion, part) for part in (training, held_out)),
                allowed=allowed,
            )
            if isinstance(result, UnsettledInvestigation):
                return moving
            latest = Moving(fit, result)
            gained = math.inf
            if moving is not None:
                gained = latest.log_probability - moving.log_probability
            moving = moving if gained < 0.0 else latest
            if gained <= LEAST_EVIDENCE or not (trial.names or result.best.names):
                return moving
            trial, near = result.best, fit.motion
    except PneunetError:  # no mass explains the delay, or no effect is left to search
        return moving
    return moving


def found_arm(trial: Trial) -> tuple[Arm, list[Arm]]:
    """Return the arm with the effects of a trial, and arms with each number a little larger."""
    refit = trial.refit
    arm = augment_model(refit, fit_with_effects(refit))
    steps = np.eye(refit.numbers.size) * DIFFERENCE_STEP
    return arm, [arm_towards(arm, trial, step) for step in steps]


def arm_towards(arm: Arm, trial: Trial, steps: Sequence[float] | Array) -> Arm:
    """Return the arm with the numbers of a trial changed by steps, in units of their priors."""
    hypotheses, numbers = trial.refit.hypotheses, trial.refit.numbers.copy()
    if not hypotheses:
        return arm
    numbers += np.concatenate([item.std for item in hypotheses]) * np.asarray(steps)
    known = (item for item in arm.effects if item.name not in trial.names)
    effects = (*known, *effects_of(hypotheses, numbers))
    return replace(arm, effects=effects, covariance=None)


def log_densities(found: Investigation, best: Trial) -> tuple[float, float]:
    """Return the log probability density of training recordings, and of held-out ones given them.

    The density is per coordinate in m, because recordings minus a swing are whitened by less noise
    than the original recordings.
    """
    linearization, record = found.selection.linearization, best.record
    count, unit = linearization.training, math.log(linearization.noise.target_std)
    return (
        record.log_probability - unit * sum(record.coordinates[:count]),
        record.predicted - unit * sum(record.coordinates[count:]),
    )


def judged(found: Investigation, moving: Moving, row: Evidence, *, tested: bool) -> Diagnosis:
    """Return the diagnosis with inertia named, or with the reason why it is not named.

    The previous model is evaluated on the recordings with their swing, whitened by the same noise
    as the new model; the held-out recordings must be less probable under it. row: evidence for
    inertia.
    """
    diagnosis, at_rest = moving.found.diagnosis, found.diagnosis
    if diagnosis.answer == 'unknown':
        return not_named(diagnosis, moving.fit, 'a part of the misfit remains unexplained')
    base = whiten_like(moving.found, found.base, found)
    falls = log_densities(moving.found, moving.found.best)[1] - log_densities(found, found.base)[1]
    if tested and 2.0 * falls < SIGNIFICANT_FALL:
        return not_named(replace(diagnosis, answer='unknown'), moving.fit, NO_FALL)
    whole = replace(
        diagnosis,
        certainty=f'{at_rest.certainty} This holds for the arm without motion. With '
        f'{" + ".join(row.effects)} ({row.evidence:.0f} nats) the p-value is '
        f'{row.p_value:.2g}.',
        where=at_rest.where,
        where_sentence=at_rest.where_sentence,
        heat_maps=tuple(
            replace(first, after=last.after)  # of the same recordings, so that bins are the same
            for first, last in zip(at_rest.heat_maps, diagnosis.heat_maps, strict=True)
        ),
        before=with_chi_squared(at_rest.before, base.record),
        adequacy_before=adequacy(base.record.tests),
        evidence=at_rest.evidence,
        cosines=at_rest.cosines,
    )
    return name_inertia(whole, moving.fit, tested=tested)


def whiten_like(other: Investigation, trial: Trial, found: Investigation) -> Trial:
    """Return a trial with its recordings whitened by the noise of another investigation.

    Without subtraction, a swing would be treated as noise and make other residuals look small.
    """
    known, noise = found.selection.linearization, other.selection.linearization.noise
    point = trial.refit.point
    quiet = Linearization(point, known.runs, known.training, noise)
    selection = replace(found.selection, linearization=quiet, tried={}, candidates={}, opened=None)
    return selection.test_trial(trial.refit, None) or trial


def with_chi_squared(evaluation: Evaluation, record: Record) -> Evaluation:
    """Return an evaluation with chi squared from a record."""
    count = len(evaluation.training_scores)
    chi_squared, coordinates = record.run_chi_squared, record.coordinates
    training, held_out = (
        sum(chi_squared[part]) / max(sum(coordinates[part]), 1)
        for part in (slice(count), slice(count, None))
    )
    rest = evaluation.held_out
    return replace(
        evaluation,
        training=replace(evaluation.training, chi_squared=training),
        held_out=None if rest is None else replace(rest, chi_squared=held_out),
    )


def evidence_of(best: Trial, rival: Trial, gained: float) -> Evidence:
    """Return the evidence for inertia and the effects found, relative to the previous model.

    gained: gain in log probability of the training recordings over a rival.
    """
    return Evidence(
        effects=(NAME, *best.names),
        chi_squared=rival.record.gain + 2.0 * gained,
        evidence=rival.record.evidence + gained,
        adequate=best.record.adequate,
        p_value=worst_p_value(best.record.tests),
        alike=(),
    )


def inseparable(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis stating that inertia explains the recordings as well."""
    return replace(
        diagnosis,
        answer='inseparable',
        sentence=f'{diagnosis.sentence} {NAME} explains the recordings as well; quick steps of '
        'the pressure would distinguish it.',
        alternatives=(*diagnosis.alternatives, NAME),
    )

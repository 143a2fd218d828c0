"""Inertia as the reason why an arm is late, where no frame was seen to swing.

Damping delays an arm on slow ramps, as a late camera or a line that fills slowly does. Where one
of these was found, or comes closest, mass and damping are fitted to all frames; what is left of
the recordings less the swing is searched again, and evidence decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math
from operator import attrgetter

from pneunet_ros.calibration.motion_fit import fit_motion, less_swing, MotionFit
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.augmented_model import augment_model, fit_with_effects
from pneunet_ros.diagnosis.evaluation import adequacy
from pneunet_ros.diagnosis.inertia import (
    detectable,
    is_known,
    NAME,
    named,
    NO_FALL,
    not_named,
    unloaded,
)
from pneunet_ros.diagnosis.investigation import Investigation
from pneunet_ros.diagnosis.lack_of_fit import worst_p_value
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.diagnosis.result import Diagnosis, Evaluation, Evidence, UnsettledDiagnosis
from pneunet_ros.diagnosis.selection import is_adequate, Record, Trial
from pneunet_ros.effects.camera_delay import CameraDelay
from pneunet_ros.effects.pressure_lag import PressureLag
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.moving_arm import WEIGHT_ERROR, WITHIN_95

LATE = CameraDelay.name, PressureLag.name  # what else makes an arm late
# Of mass and damping, and of what else is missing: each bends the fit of the other, that of a late
# camera by a fifth of the damping after two (acceptance/diagnosis.md).
MOST_ROUNDS = 5

Search = Callable[..., Investigation]  # of training and held-out recordings


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """Mass and damping, and what was found in recordings less the swing by them."""

    fit: MotionFit
    found: Investigation
    best: Trial

    @property
    def log_probability(self) -> float:
        """Of the training recordings (`log_densities`)."""
        return log_densities(self.found, self.best)[0]


def with_late_arm(
    found: Investigation,
    search: Search,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
) -> Investigation:
    """Return an investigation that also asks whether the arm is late because it has mass."""
    at_rest, rival = found.diagnosis, found.best
    if isinstance(at_rest, UnsettledDiagnosis) or rival is None or is_known(at_rest):
        return found
    moving = less_motion(found, search, training, held_out) if is_late(at_rest, rival) else None
    shown = math.inf if moving is None else 2.0 * moving.fit.damping_time_std
    at_rest = replace(at_rest, detectable=detectable(at_rest, shown))
    if moving is None:
        return replace(found, diagnosis=at_rest)
    gained = moving.log_probability - log_densities(found, rival)[0]
    row = evidence_of(moving.best, rival, gained)
    at_rest = replace(at_rest, evidence=(*at_rest.evidence, row))
    found = replace(found, diagnosis=at_rest)
    margin = at_rest.settings.selection.least_evidence
    if gained < -margin:
        return found
    diagnosis = judged(found, moving, row, tested=bool(held_out))
    if gained > margin:
        if diagnosis.answer == 'unknown':
            return found.noted(diagnosis.notes[-1])
        return replace(moving.found, diagnosis=diagnosis)
    if 'unknown' in (at_rest.answer, diagnosis.answer):
        return found
    return replace(found, diagnosis=inseparable(at_rest))


def is_late(diagnosis: Diagnosis, best: Trial) -> bool:
    """Whether what was found, or came closest, makes an arm late."""
    return not {*best.names, *diagnosis.alternatives}.isdisjoint(LATE)


def less_motion(
    found: Investigation,
    search: Search,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
) -> Moving | None:
    """Fit mass and damping, and search recordings less the swing; None where none fits.

    Where something is left, again beside what was found without motion, less the camera that was
    late in its stead: a line that fills slowly bends the fit of the damping too far to be found.
    """
    assert found.base is not None
    assert found.best is not None
    moving = moving_beside(found.base, found, search, training, held_out)
    others = {*found.best.names} - {CameraDelay.name}
    level = found.diagnosis.settings.lack_of_fit.level
    if not others or moving is None or is_adequate(moving.best.record.tests, level):
        return moving
    other = moving_beside(found.best, found, search, training, held_out)
    pair = [item for item in (moving, other) if item is not None]
    return max(pair, key=attrgetter('log_probability'))


def moving_beside(
    start: Trial,
    found: Investigation,
    search: Search,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
) -> Moving | None:
    """Fit mass and damping beside the effects of a trial, and search recordings less the swing.

    Again with what was found beside it, as an effect that was not known bends the fit, while the
    recordings become more probable. As of any effect, its law may leave a share of what the model
    without it leaves.
    """
    settings = found.diagnosis.settings
    margin = settings.selection.least_evidence
    moving: Moving | None = None
    assert found.base is not None
    allowed = settings.lack_of_fit.law_error * found.base.record.excess
    for _ in range(MOST_ROUNDS):
        arm = augment_model(start.refit, fit_with_effects(start.refit, settings), settings)
        if moving is None and CameraDelay.name in start.names:
            effects = tuple(item for item in arm.effects if item.name != CameraDelay.name)
            arm = replace(arm, effects=effects, covariance=None)
        near = None if moving is None else moving.fit.motion
        try:
            # On ramps, errors of the static model look like a part of the mass. An arm without
            # mass that is late for another reason would fit best with almost no weight.
            error = WITHIN_95 * WEIGHT_ERROR
            fit = fit_motion(arm, unloaded(training), near=near, trusted_error=error)
            slow = [less_swing(arm, fit.motion, part) for part in (training, held_out)]
            result = search(*slow, allowed=allowed)
        except PneunetError:  # no mass explains it, or nothing is left to search
            return moving
        if result.best is None:
            return moving
        latest = Moving(fit, result, result.best)
        gained = math.inf if moving is None else latest.log_probability - moving.log_probability
        moving = moving if moving is not None and gained < 0.0 else latest
        if not result.best.names or gained <= margin:
            return moving
        start = result.best
    return moving


def log_densities(found: Investigation, best: Trial) -> tuple[float, float]:
    """Return the log probability density of training recordings, and of held-out ones given them.

    Per coordinate in m: recordings less a swing are whitened by less noise than those as they are.
    """
    assert found.selection is not None
    linearization, record = found.selection.linearization, best.record
    count, unit = linearization.training, math.log(linearization.noise.target_std)
    return (
        record.log_probability - unit * sum(record.coordinates[:count]),
        record.predicted - unit * sum(record.coordinates[count:]),
    )


def judged(found: Investigation, moving: Moving, row: Evidence, *, tested: bool) -> Diagnosis:
    """Return the diagnosis of recordings less the swing with inertia named; or why it is not.

    What is said of the model before is of the recordings as they are, whitened by the same noise
    as the model after; held-out ones must be less probable by it. row: the evidence for inertia.
    """
    diagnosis, at_rest = moving.found.diagnosis, found.diagnosis
    assert isinstance(diagnosis, Diagnosis)
    assert isinstance(at_rest, Diagnosis)
    if diagnosis.answer == 'unknown':
        return not_named(diagnosis, moving.fit, 'what else the recordings show is not explained')
    assert found.base is not None
    base = whitened_as(moving.found, found.base, found)
    level, tests = diagnosis.settings.lack_of_fit.level, base.record.tests
    falls = log_densities(moving.found, moving.best)[1] - log_densities(found, found.base)[1]
    if tested and 2.0 * falls < diagnosis.settings.confirmation.fall:
        return not_named(replace(diagnosis, answer='unknown'), moving.fit, NO_FALL)
    whole = replace(
        diagnosis,
        certainty=f'{at_rest.certainty} That is without motion: with {" + ".join(row.effects)} '
        f'({row.evidence:.0f} nats) the p-value is {row.p_value:.2g}.',
        where=at_rest.where,
        where_sentence=at_rest.where_sentence,
        heat_maps=tuple(
            replace(first, after=last.after)  # of the same recordings, so that bins are the same
            for first, last in zip(at_rest.heat_maps, diagnosis.heat_maps, strict=True)
        ),
        before=with_chi_squared(at_rest.before, base.record),
        adequacy_before=adequacy(tests, min(tests, key=attrgetter('p_value')), level),
        evidence=at_rest.evidence,
        cosines=at_rest.cosines,
    )
    return named(whole, moving.fit, tested=tested)


def whitened_as(other: Investigation, trial: Trial, found: Investigation) -> Trial:
    """Return a trial with its recordings whitened by the noise of another investigation.

    A swing that nobody took off looks like noise: what is left beside it looks small.
    """
    assert found.selection is not None
    assert other.selection is not None
    known, noise = found.selection.linearization, other.selection.linearization.noise
    point = trial.refit.point
    quiet = Linearization(point, known.runs, known.training, noise, known.settings)
    selection = replace(found.selection, linearization=quiet, tried={}, candidates={}, opened=None)
    return selection.test_trial(trial.refit, None) or trial


def with_chi_squared(evaluation: Evaluation, record: Record) -> Evaluation:
    """Return an evaluation with chi squared as it is in a record."""
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
    """Return the evidence for inertia and what was found beside it, over the model before.

    gained: log probability of the training recordings, over that by a rival.
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
    """Return a diagnosis that says that inertia explains the recordings as well."""
    return replace(
        diagnosis,
        answer='inseparable',
        sentence=f'{diagnosis.sentence} {NAME} explains the recordings as well; quick steps of '
        'the pressure would distinguish it.',
        alternatives=(*diagnosis.alternatives, NAME),
    )

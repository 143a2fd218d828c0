"""Diagnosis: detect, localize, name, test, and evaluate a model error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from pneunet_ros.calibration.calibration import describe_thinning
from pneunet_ros.calibration.elongation import remove_fitted_elongation
from pneunet_ros.calibration.map_estimation import NEARLY
from pneunet_ros.calibration.noise_estimate import carries_time
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import EXPERIMENTS, NOISE_ESTIMATE
from pneunet_ros.core.notes import Note
from pneunet_ros.core.progress import ignore_progress, OnProgress, part_of
from pneunet_ros.diagnosis.conclusion import conclude
from pneunet_ros.diagnosis.decision import decide
from pneunet_ros.diagnosis.fit.base_fit import fit_base
from pneunet_ros.diagnosis.fit.hypothesis import hypotheses, Hypothesis
from pneunet_ros.diagnosis.fit.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.fit.refit import has_ended, Refit
from pneunet_ros.diagnosis.inertia import with_frames_in_motion
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.late_arm import with_late_arm
from pneunet_ros.diagnosis.result import Detectable, UnsettledDiagnosis
from pneunet_ros.diagnosis.scores.nonuniform_arm import nonuniform_columns, reduce_by_nonuniformity
from pneunet_ros.diagnosis.scores.score_test import detection_limits
from pneunet_ros.diagnosis.selection import Selection, Trial
from pneunet_ros.diagnosis.settings import BASE_FIT, DEFAULTS, DiagnosisSettings
from pneunet_ros.diagnosis.usable_frames import at_rest, exclude_unknown_readings, with_tips
from pneunet_ros.measurement.dataset import RecordingData, thin_runs
from pneunet_ros.model.arm import Arm

PARTS = 5  # of the work: base fit, search, evaluation; the command adds discovery and report


def investigate(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    on_progress: OnProgress = ignore_progress,
    settings: DiagnosisSettings = DEFAULTS,
) -> Investigation | UnsettledInvestigation:
    """Diagnose a model with recordings: find missing effects, or detection limits.

    The base model is refitted to the training recordings together with every hypothesis; held-out
    recordings are used for scores and tests only. See docs/diagnosis.md.

    Args:
        model: the arm, with the effects that are already known.
        training: recordings of pressure (Pa), end load (N, N m) and targets (m, base frame), at
            least one of them without a load. The position of the tip is a target if no other was
            seen; its heading is not used, and a note says so.
        held_out: other recordings in the same range of pressure and force; may be empty.
        seed: of the simulated clean data behind the thresholds.
        on_progress: called with the task, its progress, and its total (0 = unknown).
        settings: see `DiagnosisSettings`.

    Returns:
        The diagnosis with all its fits: the answer, and the model before and after, all numbers in
        SI; without numbers if the fit of the base model does not converge. A law outside the
        library may still overrule its name (`discovery.discover`), as in `pneunet diagnose`.

    Raises:
        RequestError: no training recording is without a load.
        RecordingError: a recording has too few frames, or contradicts the model.
        ModelError: the model has no shape in most of the recordings.
    """
    model = remove_fitted_elongation(
        model
    )  # an effect found by a calibration is a hypothesis like the others
    model, training, held_out, notes = with_tips(model, training, held_out)
    every = training, held_out
    training, held_out, notes, motion = at_rest(
        model, training, held_out, notes, settings.declared
    )
    search = partial(
        investigate_at_rest,
        model,
        notes=notes,
        seed=seed,
        on_progress=on_progress,
        settings=settings,
    )
    found = search(training, held_out)
    if isinstance(found, UnsettledInvestigation):
        return found
    if motion is None:
        return with_late_arm(found, search, *every)
    return with_frames_in_motion(found, *every, motion.moving)


def investigate_at_rest(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    notes: tuple[str, ...],
    seed: int,
    on_progress: OnProgress,
    settings: DiagnosisSettings,
    allowed: float = 0.0,
) -> Investigation | UnsettledInvestigation:
    """Diagnose a model with frames of the arm in equilibrium; allowed: as in `Selection`."""
    (training, held_out), unread = exclude_unknown_readings(model, training, held_out)
    notes = (*unread, *notes)
    base = fit_base(model, training, part_of(on_progress, 1, PARTS), settings.declared)
    rested, count = [*training, *held_out], len(training)
    few = thin_runs(rested, EXPERIMENTS.most_frames)
    training, held_out = few[:count], few[count:]
    notes = (*describe_thinning(few, rested), *notes)
    recordings = (sorted(training, key=lambda run: run.loaded), held_out)  # as for the base
    asked = hypotheses(model, settings.withheld)
    selection = Selection(
        linearization=linearize(base, *recordings),
        hypotheses=considered_hypotheses(asked, training),
        seed=seed,
        on_progress=part_of(on_progress, 2, PARTS),
        settings=settings,
        allowed=allowed,
    )
    first = selection.fit_base()
    if not is_settled(first.refit):
        return UnsettledInvestigation(diagnosis=unsettled_diagnosis(seed, notes, settings))
    best = selection.fit_rivals(first, selection.select_forward(first))
    detectable = limits_of(selection, first, asked)
    verdict = decide(selection, first, best, detectable)
    if verdict.mimicked:
        detectable = {name: replace(item, observable=False) for name, item in detectable.items()}
    part_of(on_progress, 3, PARTS)('evaluation before and after', 0, 0)
    notes = (*notes_on_time(selection, recordings[0]), *notes)
    verdict = replace(verdict, notes=(*verdict.notes, *notes))
    diagnosis = conclude(selection, first, best, verdict, detectable, recordings)
    return Investigation(
        diagnosis=diagnosis,
        selection=selection,
        base=first,
        best=best,
        trial=verdict.trial if diagnosis.answer == verdict.answer else first,
        recordings=recordings,
        notes=notes,
    )


def limits_of(
    selection: Selection, first: Trial, asked: Sequence[Hypothesis]
) -> Mapping[str, Detectable]:
    """Return the detection limits of effects, allowing for nonuniform bending."""
    uneven = nonuniform_columns(first.refit.linearization)
    candidates = reduce_by_nonuniformity(
        selection.score_candidates(first), first.refit.gaussian, uneven
    )
    return detection_limits(asked, candidates)


def is_settled(fit: Refit) -> bool:
    """Whether a further step would gain very little, in absolute terms or relative to the misfit.

    Convergence of the cost is not required: if the model lacks a strong effect, the cost may
    change from one linearization to the next.
    """
    nearly = 0.5 * NEARLY**2
    return fit.gain < nearly or has_ended(fit)


def unsettled_diagnosis(
    seed: int, notes: Sequence[str], settings: DiagnosisSettings
) -> UnsettledDiagnosis:
    """Return a diagnosis stating that the base model could not be fitted."""
    return UnsettledDiagnosis(
        sentence=(
            'The model could not be fitted to the training recordings: the search did not '
            'converge, so the model error cannot be assessed.'
        ),
        notes=(
            'check the length, targets, units and moment law of the model, and run `pneunet '
            'check` on the recordings; a calibration from the unloaded recordings alone shows '
            'which recording does not fit',
            *notes,
        ),
        seed=seed,
        settings=settings,
    )


def considered_hypotheses(
    asked: Sequence[Hypothesis], training: Sequence[RecordingData]
) -> tuple[Hypothesis, ...]:
    """Return the effects that may be named, except those equivalent to a pressure scale.

    Effects with memory are included only if a recording has enough frames in time to show them.
    """
    in_time = any(carries_time(run) for run in training)
    return tuple(
        item
        for item in asked
        if not item.confounded_with_pressure_scale and (in_time or not item.has_memory)
    )


def linearize(
    fit: Fit, training: Sequence[RecordingData], held_out: Sequence[RecordingData]
) -> Linearization:
    """Linearize all recordings, thinned, around the base fit."""
    point = LinearizationPoint(
        parameters=fit.parameters, values=fit.values, placement=fit.placement, origin=fit.origin
    )
    runs = [run.thin(BASE_FIT.frames) for run in (*training, *held_out)]
    noise = fit.parameters.frame.sensors
    return Linearization(point, runs, len(training), noise)


def notes_on_time(selection: Selection, training: Sequence[RecordingData]) -> tuple[str, ...]:
    """List the time-dependent effects that static recordings cannot show."""
    if any(carries_time(run) for run in training):
        return ()
    arm = selection.linearization.point.arm
    asked = hypotheses(arm, selection.settings.withheld)
    names = [item.name for item in asked if item.has_memory]
    why = f'no training recording has {NOISE_ESTIMATE.fewest} frames'
    if all(run.static for run in training):
        why = 'frames are static, so their stamps carry no time'
    return (
        Note(
            f'{why}: time-dependent effects were not considered ({", ".join(names)})',
            reason='no_time',
        ),
    )

"""Diagnosis: detect, localize, name, test, and evaluate a model error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np
from pneunet_ros.calibration.calibration import describe_thinning
from pneunet_ros.calibration.checks.frames_in_motion import FramesInMotion, without_motion
from pneunet_ros.calibration.elongation import without_fitted
from pneunet_ros.calibration.result import Fit
from pneunet_ros.calibration.settings import MAP_ESTIMATION
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.progress import OnProgress, part_of, say_nothing
from pneunet_ros.core.settings import check_changeable
from pneunet_ros.diagnosis.augmented_model import (
    augment_model,
    describe_effects,
    direction_notes,
    fit_with_effects,
    parameter_shifts,
)
from pneunet_ros.diagnosis.base_fit import fit_base
from pneunet_ros.diagnosis.confirmation import Confirmer, error_rises
from pneunet_ros.diagnosis.evaluation import adequacy, misfit, noise_floor, removed_share, scores
from pneunet_ros.diagnosis.experiment_design import propose_experiment
from pneunet_ros.diagnosis.hypothesis import carries_time, hypotheses, Hypothesis
from pneunet_ros.diagnosis.inertia import with_frames_in_motion
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.lack_of_fit import is_adequate, worst_p_value, worst_test
from pneunet_ros.diagnosis.late_arm import with_late_arm
from pneunet_ros.diagnosis.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.localization import (
    collect_frames,
    describe_misfit,
    heat_maps,
    misfit_shares,
)
from pneunet_ros.diagnosis.nonuniform_arm import beside_nonuniform, nonuniform_columns
from pneunet_ros.diagnosis.reading_noise import with_reading_noise
from pneunet_ros.diagnosis.refit import has_ended, Refit
from pneunet_ros.diagnosis.result import (
    Detectable,
    Diagnosis,
    Evaluation,
    Evidence,
    UnsettledDiagnosis,
)
from pneunet_ros.diagnosis.score_test import Candidate, detection_limits, effect_cosines
from pneunet_ros.diagnosis.selection import Added, evidence_margin, Record, Selection, Trial
from pneunet_ros.diagnosis.settings import (
    BASE_FIT,
    CHANGEABLE_IN_DIAGNOSIS,
    DEFAULTS,
    DiagnosisSettings,
    SCORE_TEST,
    SELECTION,
)
from pneunet_ros.diagnosis.unread_frames import without_unread
from pneunet_ros.diagnosis.verdict import (
    closest_set,
    describe_certainty,
    describe_verdict,
    Verdict,
)
from pneunet_ros.measurement.dataset import RecordingData, thinned
from pneunet_ros.measurement.tip_pose import with_tip_target
from pneunet_ros.model.arm import Arm

PARTS = 5  # of the work: base fit, search, evaluation; of the command also discovery and report


def diagnose(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    executor: Executor | None = None,
    on_progress: OnProgress = say_nothing,
    settings: DiagnosisSettings = DEFAULTS,
) -> Diagnosis | UnsettledDiagnosis:
    """Diagnose a model with recordings: find its missing effects, or the detection limits.

    The base model is refitted to the training recordings together with every hypothesis; held-out
    ones are used for scores and tests only. See docs/diagnosis.md.

    Args:
        model: the arm, with the effects that are already known.
        training: recordings of pressure (Pa), end load (N, N m) and targets (m, base frame), at
            least one of them without a load. The position of the tip is a target if no other was
            seen; its heading is not used, and a note says so.
        held_out: other recordings in the same range of pressure and force; may be empty.
        seed: of the simulated clean data behind the thresholds.
        executor: runs the simulations; None: this process.
        on_progress: called with the task, its progress, and its total (0 = unknown).
        settings: only those in `CHANGEABLE_IN_DIAGNOSIS` can differ from the default.

    Returns:
        The answer, with the model before and after, all numbers in SI; without numbers if the fit
        of the base model does not converge. A law outside the library may still overrule its name
        (`discovery.discover`), as in `pneunet diagnose`.

    Raises:
        RequestError: no training recording is without a load, or a setting is fixed.
        RecordingError: a recording has too few frames, or contradicts the model.
        ModelError: the model has no shape in most of the recordings.
    """
    return investigate(
        model,
        training,
        held_out,
        seed=seed,
        executor=executor,
        on_progress=on_progress,
        settings=settings,
    ).diagnosis


def investigate(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    executor: Executor | None = None,
    on_progress: OnProgress = say_nothing,
    settings: DiagnosisSettings = DEFAULTS,
) -> Investigation | UnsettledInvestigation:
    """Diagnose like `diagnose`; return the diagnosis with all its fits."""
    check_changeable(settings, CHANGEABLE_IN_DIAGNOSIS)
    model = without_fitted(model)  # what a calibration found is a hypothesis as others are
    model, training, held_out, notes = with_tips(model, training, held_out)
    every = training, held_out
    training, held_out, notes, motion = at_rest(model, training, held_out, notes)
    search = partial(
        investigate_at_rest,
        model,
        notes=notes,
        seed=seed,
        executor=executor,
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
    executor: Executor | None,
    on_progress: OnProgress,
    settings: DiagnosisSettings,
    allowed: float = 0.0,
) -> Investigation | UnsettledInvestigation:
    """Diagnose a model with frames of the arm in equilibrium; allowed: as in `Selection`."""
    (training, held_out), unread = without_unread(model, training, held_out)
    notes = (*unread, *notes)
    base = fit_base(model, training, part_of(on_progress, 1, PARTS), settings.calibration)
    rested, count = [*training, *held_out], len(training)
    few = thinned(rested, settings.calibration.experiments.most_frames)
    training, held_out = few[:count], few[count:]
    notes = (*describe_thinning(few, rested), *notes)
    recordings = (sorted(training, key=lambda run: run.loaded), held_out)  # as the base was fitted
    asked = hypotheses(tuple(effect.name for effect in model.effects), settings.hypothesis)
    selection = Selection(
        linearization=linearize(base, *recordings),
        hypotheses=considered_hypotheses(asked, training),
        seed=seed,
        on_progress=part_of(on_progress, 2, PARTS),
        map_function=map if executor is None else executor.map,
        settings=settings,
        allowed=allowed,
    )
    first = selection.fit_base()
    if not is_settled(first.refit):
        return UnsettledInvestigation(diagnosis=unsettled(seed, notes, settings))
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
    uneven = nonuniform_columns(
        first.refit.linearization, selection.settings.calibration.resolution
    )
    candidates = beside_nonuniform(selection.score_candidates(first), first.refit.gaussian, uneven)
    return detection_limits(asked, candidates)


def is_settled(fit: Refit) -> bool:
    """Whether a further step would gain almost nothing, absolutely or relative to the misfit.

    Convergence of the cost is not required: if the model lacks a strong effect, the cost may
    change from one linearization to the next.
    """
    nearly = 0.5 * MAP_ESTIMATION.nearly**2
    return fit.gain < nearly or has_ended(fit)


def unsettled(seed: int, notes: Sequence[str], settings: DiagnosisSettings) -> UnsettledDiagnosis:
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

    Effects with memory are included only if a recording can show them: enough frames in time.
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


def conclude(
    selection: Selection,
    first: Trial,
    best: Trial,
    verdict: Verdict,
    detectable: Mapping[str, Detectable],
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]],
) -> Diagnosis:
    """Evaluate the models before and after on the recordings, and put the result together.

    A name is withdrawn if its model is surely worse on held-out recordings.
    """
    added = verdict.trial is not first
    runs, noise = selection.linearization.runs, selection.linearization.noise
    candidates = selection.score_candidates(first)
    before = after = evaluate(first, runs, recordings)
    if added:
        refit = with_reading_noise(verdict.trial.refit, selection.seed)
        verdict = replace(verdict, trial=replace(verdict.trial, refit=refit))
        after = evaluate(verdict.trial, runs, recordings)
        pair = before.held_out_scores, after.held_out_scores
        objection = error_rises(*pair)
        if objection:
            notes = (*closest_notes(verdict.trial.record, (objection,)), *verdict.notes)
            verdict, after = Verdict(answer='unknown', trial=first, notes=notes), before
            added = False
    floor, floor_std = noise_floor(after.arm, recordings[1] or recordings[0], noise)
    frames, frames_after = (
        collect_frames(
            trial.refit,
            harmless=trial is verdict.trial
            and verdict.answer != 'unknown'
            and is_adequate(trial.record.tests),
        )
        for trial in (first, verdict.trial)
    )
    left, worst = verdict.trial.record.tests, worst_test(first.record.tests)
    same = next((item for item in left if item.name == worst.name), worst)
    cosines = effect_cosines(first.refit.gaussian, candidates)
    wanted = wanted_candidates(verdict, candidates, detectable)
    rivals = wanted if verdict.alternatives else ()
    removed = removed_share(before.rms, after.rms, floor)
    effects = describe_effects(verdict.trial.refit, verdict.probability)
    return Diagnosis(
        answer=verdict.answer,
        sentence=describe_verdict(verdict, before, after, (floor, floor_std)),
        certainty=describe_certainty(selection, first, best),
        effects=effects,
        alternatives=verdict.alternatives,
        where=misfit_shares(frames),
        where_sentence=describe_misfit(frames),
        heat_maps=heat_maps(frames, frames_after),
        before=before,
        after=after,
        noise_floor=floor,
        noise_floor_std=floor_std,
        closed=None if first.record.adequate else removed,
        adequacy_before=adequacy(first.record.tests),
        adequacy_after=adequacy(left),
        adequacy_same=adequacy(left, same),
        detectable=detectable,
        shift=parameter_shifts(before.fit, after.fit) if added else {},
        evidence=collect_evidence(selection, candidates, cosines),
        cosines=cosines,
        proposal=''
        if verdict.mimicked  # more targets would tell, and no recording
        else propose_experiment(first.refit, wanted, rivals),
        notes=(*verdict.notes, *direction_notes(before.arm, effects)),
        seed=selection.seed,
        settings=selection.settings,
    )


def decide(
    selection: Selection, first: Trial, best: Trial, detectable: Mapping[str, Detectable]
) -> Verdict:
    """Decide on the answer from the base model, the best set of effects, and all trials."""
    if not best.record.adequate:
        notes = closest_notes(closest_set(selection))
        return Verdict(answer='unknown', trial=first, notes=notes)
    if not best.names:
        observable = any(item.observable for item in detectable.values())
        return Verdict(answer='none' if observable else 'unobservable', trial=first)
    confirmer = Confirmer.of(selection, first.record)
    uneven = confirmer.nonuniform_arm(best.record)
    if uneven:
        notes = closest_notes(best.record, uneven)
        return Verdict(answer='unobservable', trial=first, mimicked=best.names, notes=notes)
    rivals = [
        item
        for item in selection.tried.values()
        if item.adequate
        and item.plausible
        and item.gain > 0.0
        and item is not best.record
        and not confirmer.refutations(item)
    ]
    alike = tuple(
        item.names
        for item in sorted(rivals, key=lambda item: -item.evidence)
        if passes_alike(item, best.record) and not set(item.names) <= set(best.names)
    )
    verdict = Verdict(answer='inseparable' if alike else 'named', trial=best, alike=alike)
    objections = confirmer.objections(best.record, verdict.alternatives)
    untested = confirmer.untested(best.record)
    if objections:
        notes = closest_notes(best.record, objections)
        return Verdict(answer='unknown', trial=first, unconfirmed=best.names, notes=notes)
    return replace(
        verdict,
        probability=effect_probabilities([best.record, *rivals], confirmed=not untested),
        notes=(*untested, *notes_on_rest(selection, best)),
    )


def take_back(investigation: Investigation, objection: str) -> Diagnosis:
    """Return the diagnosis with its name withdrawn: the answer is `unknown`.

    objection: the reason, added to the notes.
    """
    named, selection = investigation.diagnosis, investigation.selection
    first, best = investigation.base, investigation.trial
    library = {item.name for item in selection.hypotheses}
    tried = {names: item for names, item in selection.tried.items() if names <= library}
    selection = replace(selection, tried=tried)
    missing = ' and '.join(item.name for item in named.effects)  # inertia is in no set tried
    closest = closest_notes(best.record, (objection,)) or (
        Note(f'{missing} is not named: {objection}', reason='closest'),
    )
    notes = (*closest, *investigation.notes)
    verdict = Verdict(answer='unknown', trial=first, notes=notes)
    diagnosis = conclude(
        selection, first, best, verdict, named.detectable, investigation.recordings
    )
    names = ' or '.join((missing, *named.alternatives))
    sentence = (
        f'The model lacks an effect: {names} would explain it, but another law explains it better.'
    )
    return replace(diagnosis, sentence=f'{sentence} See the notes for the numbers.')


def passes_alike(rival: Record, best: Record) -> bool:
    """Whether an adequate rival without more effects explains the recordings as well.

    The comparison is by evidence or by chi squared alone; in the latter case only the prior
    separates the two.
    """
    if len(rival.names) > len(best.names):
        return False
    most, other = comparable([best, rival])
    least = most.evidence - evidence_margin(most.evidence)
    return other.evidence > least or other.gain > most.gain - 2.0 * SELECTION.least_evidence


def comparable(records: Sequence[Record]) -> list[Added]:
    """Return the gain of sets over the set that all of them extend, or over the base."""
    added = [item.added for item in records if item.added is not None]
    if len(added) == len(records) and len({item.names for item in added}) == 1:
        return added
    return [Added(names=(), evidence=item.evidence, gain=item.gain) for item in records]


def effect_probabilities(records: Sequence[Record], *, confirmed: bool = True) -> dict[str, float]:
    """Return the probability that each effect is missing, over all candidate sets.

    Evidence is weighted by the accuracy of the laws, as for the answer. No probability exceeds the
    success rate of names in blind trials; confirmed: every requirement for the name was tested.
    """
    logs = np.array([item.evidence for item in comparable(records)])
    margin = evidence_margin(float(logs.max()))
    weights = np.exp((logs - logs.max()) * SELECTION.least_evidence / margin)
    known = DEFAULTS.confirmation
    weights *= (1.0 - (known.wrong if confirmed else known.unconfirmed)) / weights.sum()
    names = sorted({name for item in records for name in item.names})
    pairs = list(zip(weights, records, strict=True))
    return {
        name: float(sum(weight for weight, item in pairs if name in item.names)) for name in names
    }


def evaluate(
    trial: Trial,
    thinned: Sequence[RecordingData],
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]],
) -> Evaluation:
    """Evaluate the model of a trial on training and held-out recordings.

    thinned: the runs of the trial, with known chi squared.
    """
    fit = fit_with_effects(trial.refit)
    arm = augment_model(trial.refit, fit)
    training, held_out = recordings
    count = len(training)
    every = scores(arm, [*training, *held_out])
    chi_squared = trial.record.run_chi_squared
    return Evaluation(
        arm=arm,
        fit=fit,
        training=misfit(every[:count], chi_squared[:count], thinned[:count]),
        held_out=misfit(every[count:], chi_squared[count:], thinned[count:]) if held_out else None,
        training_scores=every[:count],
        held_out_scores=every[count:],
    )


def wanted_candidates(
    verdict: Verdict, candidates: Sequence[Candidate], detectable: Mapping[str, Detectable]
) -> list[Candidate]:
    """Return the effects that the next recording should show: rivals, or unseen ones."""
    if verdict.alternatives:
        names = (*verdict.trial.names, *verdict.alternatives)
        return [item for item in candidates if item.name in names]
    return [item for item in candidates if not detectable[item.name].observable]


def collect_evidence(
    selection: Selection, candidates: Sequence[Candidate], cosines: Mapping[tuple[str, str], float]
) -> tuple[Evidence, ...]:
    """Return all trials, best first; effects that were not refitted are ranked by their score."""
    least = SCORE_TEST.same_class
    same_class = [pair for pair, cosine in cosines.items() if abs(cosine) > least]
    trials = sorted(selection.tried.values(), key=lambda item: -item.evidence)
    rows = [
        (item.names, item.gain, item.evidence, item.adequate, worst_p_value(item.tests))
        for item in trials
        if item.names
    ]
    fitted = {names for names, *_ in rows}
    rows += [
        ((item.name,), item.gain, float('nan'), False, float('nan'))
        for item in candidates
        if (item.name,) not in fitted
    ]
    return tuple(
        Evidence(
            effects=names,
            chi_squared=gain,
            evidence=evidence,
            adequate=adequate,
            p_value=p_value,
            alike=alike_effects(names, same_class),
        )
        for names, gain, evidence, adequate, p_value in rows
    )


def alike_effects(
    names: tuple[str, ...], same_class: Sequence[tuple[str, str]]
) -> tuple[str, ...]:
    """Return the other effects that differ from these only in size."""
    pairs = [pair for pair in same_class if set(pair) & set(names)]
    return tuple(sorted({name for pair in pairs for name in pair} - set(names)))


def closest_notes(best: Record, objections: Sequence[str] = ()) -> tuple[str, ...]:
    """Describe the closest explanation, and why it is not named."""
    if not best.names:
        return ()
    if not objections:
        objections = (f'it fails the lack-of-fit test of {worst_test(best.tests).name}',)
    names = ' + '.join(best.names)
    said = f'reduces chi squared by {best.gain:.0f}' if best.gain > 0.0 else 'explains nothing'
    return (
        Note(
            f'closest is {names}, which {said}; it is not named: {"; ".join(objections)}',
            reason='closest',
        ),
    )


def notes_on_rest(selection: Selection, best: Trial) -> tuple[str, ...]:
    """Describe other possibly missing effects, too faint next to a strong effect to be named."""
    item = selection.significant_candidate(best)
    if item is None:
        return ()
    names = ' + '.join(best.names)
    return (
        Note(
            f'{item.name} in addition to {names} would reduce chi squared by another '
            f'{item.gain:.0f}, more than the law error of {names} explains. Both together fail '
            f'the tests, so {item.name} is not named; recordings that show less of {names} would '
            'decide',
            reason='too_faint',
        ),
    )


def notes_on_time(selection: Selection, training: Sequence[RecordingData]) -> tuple[str, ...]:
    """List the time-dependent effects that static recordings cannot show."""
    settings = selection.settings.hypothesis
    if any(carries_time(run) for run in training):
        return ()
    known = {effect.name for effect in selection.linearization.point.arm.effects}
    names = [item.name for item in hypotheses(tuple(known), settings) if item.has_memory]
    why = f'no training recording has {settings.fewest_in_time} frames'
    if all(run.static for run in training):
        why = 'frames are static, so their stamps carry no time'
    return (
        Note(
            f'{why}: time-dependent effects were not considered ({", ".join(names)})',
            reason='no_time',
        ),
    )


def at_rest(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    notes: tuple[str, ...],
) -> tuple[list[RecordingData], list[RecordingData], tuple[str, ...], FramesInMotion | None]:
    """Return recordings without frames in motion; a note on these comes first.

    Also returns these frames.

    RecordingError if no training recording without a load is left.
    """
    kept, motion = without_motion(model, training, held_out)
    if motion is None:
        return kept[0], kept[1], notes, None
    if all(run.loaded for run in kept[0]) and not all(run.loaded for run in training):
        raise RecordingError(
            f'{motion.left_out}. Too few frames are left for a diagnosis', reason='in_motion'
        )
    return kept[0], kept[1], (motion.left_out, *notes), motion


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

"""The conclusion: evaluation of the models before and after, and assembly of the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from pneunet_ros.calibration.settings import IDENTIFIABILITY
from pneunet_ros.core.notes import Note
from pneunet_ros.diagnosis.confirmation import error_increase
from pneunet_ros.diagnosis.decision import closest_notes
from pneunet_ros.diagnosis.evaluation import adequacy, misfit, noise_floor, removed_share, scores
from pneunet_ros.diagnosis.fit.augmented_model import (
    augment_model,
    describe_effects,
    direction_notes,
    fit_with_effects,
    parameter_shifts,
)
from pneunet_ros.diagnosis.fit.reading_noise import with_reading_noise
from pneunet_ros.diagnosis.investigation import Investigation
from pneunet_ros.diagnosis.localization import (
    collect_frames,
    describe_misfit,
    heat_maps,
    misfit_shares,
)
from pneunet_ros.diagnosis.result import Detectable, Diagnosis, Evaluation, Evidence
from pneunet_ros.diagnosis.scores.lack_of_fit import is_adequate, worst_p_value, worst_test
from pneunet_ros.diagnosis.scores.score_test import Candidate, effect_cosines
from pneunet_ros.diagnosis.selection import Selection, Trial
from pneunet_ros.diagnosis.verdict import describe_certainty, describe_verdict, Verdict
from pneunet_ros.measurement.dataset import RecordingData


def conclude(
    selection: Selection,
    first: Trial,
    best: Trial,
    verdict: Verdict,
    detectable: Mapping[str, Detectable],
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]],
) -> Diagnosis:
    """Evaluate the models before and after on the recordings, and assemble the result.

    A name is withdrawn if its model is significantly worse on held-out recordings.
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
        objection = error_increase(*pair)
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
        notes=(*verdict.notes, *direction_notes(before.arm, effects)),
        seed=selection.seed,
        settings=selection.settings,
    )


def withdraw_name(investigation: Investigation, objection: str) -> Diagnosis:
    """Return the diagnosis with its name withdrawn: the answer is `unknown`.

    objection: the reason, added to the notes.
    """
    named, selection = investigation.diagnosis, investigation.selection
    first, best = investigation.base, investigation.trial
    library = {item.name for item in selection.hypotheses}
    tried = {names: item for names, item in selection.tried.items() if names <= library}
    selection = replace(selection, tried=tried)
    missing = ' and '.join(item.name for item in named.effects)  # no set includes inertia
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


def collect_evidence(
    selection: Selection, candidates: Sequence[Candidate], cosines: Mapping[tuple[str, str], float]
) -> tuple[Evidence, ...]:
    """Return all trials, best first; effects that were not refitted are ranked by their score."""
    same_class = [pair for pair, size in cosines.items() if abs(size) > IDENTIFIABILITY.confounded]
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
            alike=similar_effects(names, same_class),
        )
        for names, gain, evidence, adequate, p_value in rows
    )


def similar_effects(
    names: tuple[str, ...], same_class: Sequence[tuple[str, str]]
) -> tuple[str, ...]:
    """Return the effects that cannot be distinguished from these except by size."""
    pairs = [pair for pair in same_class if set(pair) & set(names)]
    return tuple(sorted({name for pair in pairs for name in pair} - set(names)))

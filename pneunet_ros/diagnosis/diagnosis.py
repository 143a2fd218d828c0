"""Find what a model lacks: detect, localize, name, test, and evaluate before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from pneunet_ros.core.progress import OnProgress, say_nothing
from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.augmented_model import (
    augment_model,
    describe_effects,
    fit_with_effects,
    parameter_shifts,
)
from pneunet_ros.diagnosis.base_fit import BaseFit, fit_base
from pneunet_ros.diagnosis.evaluation import misfit, noise_floor, removed_share, scores
from pneunet_ros.diagnosis.experiment_design import propose_experiment
from pneunet_ros.diagnosis.hypothesis import hypotheses, Hypothesis
from pneunet_ros.diagnosis.lack_of_fit import LackOfFit
from pneunet_ros.diagnosis.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.localization import (
    collect_frames,
    describe_misfit,
    heat_maps,
    misfit_shares,
)
from pneunet_ros.diagnosis.result import (
    Adequacy,
    Answer,
    Detectable,
    Diagnosis,
    Evaluation,
    Evidence,
)
from pneunet_ros.diagnosis.score_test import Candidate, detection_limits, effect_cosines
from pneunet_ros.diagnosis.selection import evidence_margin, Record, Selection, Trial
from pneunet_ros.diagnosis.settings import (
    DEFAULTS,
    DiagnosisSettings,
    SelectionSettings,
)
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The answer: the model that holds, and effects that cannot be distinguished from its own.

    probability: how probable it is that each effect is missing.
    """

    answer: Answer
    trial: Trial
    alternatives: tuple[str, ...] = ()
    probability: Mapping[str, float]


def diagnose(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    executor: Executor | None = None,
    on_progress: OnProgress = say_nothing,
    settings: DiagnosisSettings = DEFAULTS,
) -> Diagnosis:
    """Diagnose a model by recordings: what it lacks, or what the recordings could have shown.

    The base model is refitted to the training recordings together with every hypothesis; held-out
    ones are used for scores and tests only. docs/diagnosis.md says how.

    Args:
        model: the arm, with the effects that are known already.
        training: recordings of pressure (Pa), end load (N, N m) and targets (m, base frame), at
            least one of them without a load.
        held_out: others, in the same range of pressure and force; may be empty.
        seed: of the simulated clean data behind the thresholds.
        executor: where they are simulated; here if None.
        on_progress: called with what is done, how far, and of how much (0 = unknown).
        settings: the numbers by which it decides.

    Returns:
        The answer, with the model before and after; all numbers in SI.

    Raises:
        RequestError: no training recording is without a load.
        RecordingError: a recording has too few frames, or contradicts the model.
        ModelError: the model has no shape in most of the recordings.

    """
    base = fit_base(model, training, on_progress, settings.base_fit, settings.calibration)
    recordings = (sorted(training, key=lambda run: run.loaded), held_out)  # as the base was fitted
    known = tuple(effect.name for effect in base.frame.effects)
    asked = hypotheses(known, settings.hypothesis)
    selection = Selection(
        linearization=linearize(base, *recordings, settings),
        hypotheses=considered_hypotheses(asked, training),
        seed=seed,
        on_progress=on_progress,
        map_function=map if executor is None else executor.map,
        settings=settings,
    )
    first = selection.fit_base()
    best = selection.select_forward(first)
    candidates = selection.score_candidates(first)
    detectable = detection_limits(asked, candidates, settings.score_test)
    verdict = decide(selection, first, best, detectable)
    on_progress('evaluation before and after', 0, 0)
    return conclude(selection, first, best, verdict, detectable, recordings)


def considered_hypotheses(
    asked: Sequence[Hypothesis], training: Sequence[RecordingData]
) -> tuple[Hypothesis, ...]:
    """Return the effects that may be named: static frames tell nothing of one with a memory."""
    static = all(run.static for run in training)
    return tuple(
        item
        for item in asked
        if not item.confounded_with_pressure_scale and not (static and item.has_memory)
    )


def linearize(
    base: BaseFit,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    settings: DiagnosisSettings,
) -> Linearization:
    """Linearize all recordings, thinned, around the base fit."""
    fit = base.fit
    point = LinearizationPoint(
        parameters=fit.parameters, values=fit.values, placement=fit.placement
    )
    runs = [run.thin(settings.base_fit.frames) for run in (*training, *held_out)]
    return Linearization(point, runs, len(training), base.noise.noise, settings.linearization)


def conclude(
    selection: Selection,
    first: Trial,
    best: Trial,
    verdict: Verdict,
    detectable: Mapping[str, Detectable],
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]],
) -> Diagnosis:
    """Evaluate the models before and after on the recordings, and put the result together."""
    settings, added = selection.settings, verdict.trial is not first
    runs, noise = selection.linearization.runs, selection.linearization.noise
    candidates, level = selection.score_candidates(first), settings.lack_of_fit.level
    before = after = evaluate(first, runs, recordings, settings)
    if added:
        after = evaluate(verdict.trial, runs, recordings, settings)
    floor = noise_floor(after.arm, recordings[1] or recordings[0], noise)
    frames, frames_after = (
        collect_frames(trial.refit, settings.localization) for trial in (first, verdict.trial)
    )
    cosines = effect_cosines(first.refit.gaussian, candidates, settings.score_test)
    wanted = wanted_candidates(verdict, candidates, detectable)
    rivals = wanted if verdict.alternatives else ()
    removed = removed_share(before.rms, after.rms, floor)
    return Diagnosis(
        answer=verdict.answer,
        sentence=describe_verdict(verdict, before.rms, after.rms),
        effects=describe_effects(
            verdict.trial.refit, verdict.probability, settings.augmented_model
        ),
        alternatives=verdict.alternatives,
        where=misfit_shares(frames),
        where_sentence=describe_misfit(frames),
        heat_maps=heat_maps(frames, frames_after),
        before=before,
        after=after,
        noise_floor=floor,
        closed=None if first.record.adequate else removed,
        adequacy_before=worst_test(first.record.tests, level),
        adequacy_after=worst_test(verdict.trial.record.tests, level),
        detectable=detectable,
        shift=parameter_shifts(before.fit, after.fit) if added else {},
        evidence=collect_evidence(selection, candidates, cosines),
        cosines=cosines,
        proposal=propose_experiment(first.refit, wanted, rivals, settings),
        notes=write_notes(first, best, verdict),
        seed=selection.seed,
        settings=settings,
    )


def decide(
    selection: Selection, first: Trial, best: Trial, detectable: Mapping[str, Detectable]
) -> Verdict:
    """Decide on the answer by the base model, the best set of effects, and all that was tried."""
    if not best.record.adequate:
        return Verdict(answer='unknown', trial=first, probability={})
    if not best.names:
        observable = any(item.observable for item in detectable.values())
        answer: Answer = 'none' if observable else 'unobservable'
        return Verdict(answer=answer, trial=first, probability={})
    settings = selection.settings.selection
    rivals = [
        item
        for item in selection.tried.values()
        if item.adequate and item.plausible and item is not best.record
    ]
    least = best.record.evidence - evidence_margin(best.record.evidence, settings)
    others = {
        name
        for item in rivals
        if item.dof <= best.record.dof and item.evidence > least
        for name in item.names
    }
    alternatives = tuple(sorted(others - set(best.names)))
    return Verdict(
        answer='inseparable' if alternatives else 'named',
        trial=best,
        alternatives=alternatives,
        probability=effect_probabilities([best.record, *rivals], settings),
    )


def effect_probabilities(
    records: Sequence[Record], settings: SelectionSettings = DEFAULTS.selection
) -> dict[str, float]:
    """Return how probable it is that each effect is missing, over sets that may be the answer.

    Evidence counts by what laws of effects are worth, as it does for the answer.
    """
    logs = np.array([item.evidence for item in records])
    margin = evidence_margin(float(logs.max()), settings)
    weights = np.exp((logs - logs.max()) * settings.least_evidence / margin)
    weights /= weights.sum()
    names = sorted({name for item in records for name in item.names})
    pairs = list(zip(weights, records, strict=True))
    return {
        name: float(sum(weight for weight, item in pairs if name in item.names)) for name in names
    }


def evaluate(
    trial: Trial,
    thinned: Sequence[RecordingData],
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]],
    settings: DiagnosisSettings,
) -> Evaluation:
    """Evaluate the model of a trial on training and held-out recordings.

    thinned: the runs of the trial, of which chi squared is known already.
    """
    fit = fit_with_effects(trial.refit, settings)
    arm = augment_model(trial.refit, fit, settings)
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


def worst_test(tests: Sequence[LackOfFit], level: float) -> Adequacy:
    """Return the test with the least p-value, at the level of all of them together."""
    worst = min(tests, key=lambda item: item.p_value)
    return Adequacy(
        statistic=worst.statistic,
        threshold=worst.threshold(level / len(tests)),
        p_value=min(1.0, worst.p_value * len(tests)),
    )


def wanted_candidates(
    verdict: Verdict, candidates: Sequence[Candidate], detectable: Mapping[str, Detectable]
) -> list[Candidate]:
    """Return the effects that the next recording should show: rivals, else unseen ones."""
    if verdict.alternatives:
        names = (*verdict.trial.names, *verdict.alternatives)
        return [item for item in candidates if item.name in names]
    return [item for item in candidates if not detectable[item.name].observable]


def collect_evidence(
    selection: Selection,
    candidates: Sequence[Candidate],
    cosines: Mapping[tuple[str, str], float],
) -> tuple[Evidence, ...]:
    """Return what was tried, the best first; effects that were not refitted by their score."""
    least = selection.settings.score_test.same_class
    same_class = [pair for pair, cosine in cosines.items() if abs(cosine) > least]
    trials = sorted(selection.tried.values(), key=lambda item: -item.evidence)
    rows = [(item.names, item.gain, item.evidence, item.adequate) for item in trials if item.names]
    fitted = {names for names, *_ in rows}
    rows += [
        ((item.name,), item.gain, float('nan'), False)
        for item in candidates
        if (item.name,) not in fitted
    ]
    return tuple(
        Evidence(
            effects=names,
            chi_squared=gain,
            evidence=evidence,
            adequate=adequate,
            alike=alike_effects(names, same_class),
        )
        for names, gain, evidence, adequate in rows
    )


def alike_effects(
    names: tuple[str, ...], same_class: Sequence[tuple[str, str]]
) -> tuple[str, ...]:
    """Return the other effects that differ from these in nothing but their size."""
    pairs = [pair for pair in same_class if set(pair) & set(names)]
    return tuple(sorted({name for pair in pairs for name in pair} - set(names)))


def write_notes(first: Trial, best: Trial, verdict: Verdict) -> tuple[str, ...]:
    """Return what else one should know."""
    notes = []
    if verdict.answer == 'unknown' and best.names:
        worst = min(best.record.tests, key=lambda item: item.p_value)
        notes.append(
            f'{" + ".join(best.names)} reduces chi squared most, by {best.record.gain:.0f}, but '
            f'fails the lack-of-fit test of {worst.name}: it is not what is missing, or not alone'
        )
    if not first.refit.converged:
        notes.append('the fit of the base model has not converged')
    return tuple(notes)


def describe_verdict(verdict: Verdict, before: float, after: float) -> str:
    """Return the answer in one sentence; before, after: model error (m, rms)."""
    names = ' and '.join(verdict.trial.names)
    reduced = (
        f'adding {"it" if len(verdict.trial.names) == 1 else "them"} reduces the model error from '
        f'{millimeters(before):.2f} to {millimeters(after):.2f} mm rms.'
    )
    match verdict.answer:
        case 'none':
            return 'The residuals are consistent with noise: no effect is missing that is visible.'
        case 'unobservable':
            return 'No effect of the library is observable in these recordings.'
        case 'unknown':
            return 'The model lacks something, and no effect of the library explains it.'
        case 'named':
            return f'The model lacks {names}: {reduced}'
    others = ' or '.join(verdict.alternatives)
    return (
        f'The model lacks {names} or {others}, which cannot be distinguished with these data: '
        f'{reduced}'
    )

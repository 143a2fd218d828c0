"""Find what a model lacks: detect, localize, name, test, and show the gap before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.units import millimeters
from pneunet_ros.diagnosis.augmented import augmented, fitted, named, shifts
from pneunet_ros.diagnosis.base_fit import Each, FRAMES, refitted
from pneunet_ros.diagnosis.detectability import cosines, detection_limits
from pneunet_ros.diagnosis.evaluation import closed, misfit, noise_floor, scores
from pneunet_ros.diagnosis.experiment_design import propose_experiment
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.hypothesis import hypotheses
from pneunet_ros.diagnosis.lack_of_fit import Group
from pneunet_ros.diagnosis.linearization import Linearization, LinearizationPoint
from pneunet_ros.diagnosis.localization import frames_of, heat_maps, sentence_of, shares
from pneunet_ros.diagnosis.refit import Refit
from pneunet_ros.diagnosis.result import Adequacy, Answer, Diagnosis, Evaluation, Evidence
from pneunet_ros.diagnosis.score_test import Candidate
from pneunet_ros.diagnosis.selection import LEAST_EVIDENCE, LEVEL, margin, Record, Selection, Trial
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

SAME = 0.98  # cosine of effects that are one class on these recordings


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The answer, with what cannot be told from it and how probable each effect is."""

    answer: Answer
    trial: Trial
    alternatives: tuple[str, ...]
    probability: Mapping[str, float]


def diagnose(
    frame: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    executor: Executor | None = None,
    each: Each = lambda what, done, total: None,
) -> Diagnosis:
    """Diagnose a model by recordings; `frame` has the effects that are known already.

    The base model is refitted to the training recordings together with every hypothesis; held-out
    ones are used for scores and tests only. seed: of the simulated clean data behind the
    thresholds; executor: where they are simulated, here if None. Raises RequestError and
    RecordingError where the recordings are not fit for it.
    """
    base = refitted(frame, training, each)
    ordered = sorted(training, key=lambda run: run.loaded)  # as the base was fitted
    runs = [run.thinned(FRAMES) for run in ordered]
    point = LinearizationPoint(
        parameters=base.fit.parameters, values=base.fit.values, placement=base.fit.placement
    )
    whole = (*runs, *(run.thinned(FRAMES) for run in held_out))
    design = Linearization(point, whole, len(runs), base.noise.noise)
    known = tuple(effect.name for effect in base.frame.effects)
    asked = hypotheses(without=known)
    selection = Selection(
        design=design,
        hypotheses=tuple(item for item in asked if not item.confounded_with_pressure_scale),
        seed=seed,
        each=each,
        mapped=map if executor is None else executor.map,
    )
    first = selection.base()
    best = selection.forward(first)
    found = selection.following(first)
    visible = detection_limits(asked, found)
    alike = cosines(first.refit.linear, found)
    some = any(item.observable for item in visible.values())
    verdict = decide(selection, first, best, some)
    each('the gap', 0, 0)
    after = verdict.trial
    before_fit = fitted(first.refit)
    after_fit = before_fit if after is first else fitted(after.refit)
    before_design, before_linear = selection.wholly(first.refit)
    after_design, after_linear = selection.wholly(after.refit)
    sides = [
        side(first.refit, before_fit, before_design, before_linear, (ordered, held_out)),
        side(after.refit, after_fit, after_design, after_linear, (ordered, held_out)),
    ]
    frames = [frames_of(item.refit.design, item.refit.linear) for item in (first, after)]
    floor = noise_floor(sides[1].arm, held_out or ordered, base.noise.noise)
    gaps = [item.held_out or item.training for item in sides]
    wished = [item for item in found if not visible[item.hypothesis.name].observable]
    if verdict.alternatives:
        names = (*after.names, *verdict.alternatives)
        wished = [item for item in found if item.hypothesis.name in names]
    advice = propose_experiment(first.refit, wished, wished if verdict.alternatives else ())
    effects = named(after.refit, verdict.probability)
    return Diagnosis(
        answer=verdict.answer,
        sentence=sentence(verdict, gaps[0].rms, gaps[1].rms),
        effects=effects,
        alternatives=verdict.alternatives,
        where=shares(frames[0]),
        where_sentence=sentence_of(frames[0]),
        heat_maps=heat_maps(*frames),
        before=sides[0],
        after=sides[1],
        noise_floor=floor,
        closed=None if first.record.adequate else closed(gaps[0].rms, gaps[1].rms, floor),
        adequacy_before=adequacy(first.record.groups),
        adequacy_after=adequacy(after.record.groups),
        detectable=visible,
        shift={} if after is first else shifts(before_fit, after_fit),
        evidence=evidence(selection, found, alike),
        cosines=alike,
        proposal=advice,
        notes=notes(first, best, verdict),
        seed=seed,
    )


def decide(selection: Selection, first: Trial, best: Trial, some: bool) -> Verdict:
    """Decide on the answer; some: an effect could have been seen at all."""
    nothing = Verdict(answer='none', trial=first, alternatives=(), probability={})
    if not best.names:
        if not first.record.adequate:
            return Verdict(answer='unknown', trial=first, alternatives=(), probability={})
        if some:
            return nothing
        return Verdict(answer='unobservable', trial=first, alternatives=(), probability={})
    if not best.record.adequate:
        return Verdict(answer='unknown', trial=first, alternatives=(), probability={})
    rivals = [
        trial
        for trial in possible(selection, best)
        if trial.dof <= best.record.dof
        and trial.evidence > best.record.evidence - margin(best.record.evidence)
    ]
    others = sorted({name for trial in rivals for name in trial.names} - set(best.names))
    return Verdict(
        answer='inseparable' if others else 'named',
        trial=best,
        alternatives=tuple(others),
        probability=probabilities([best.record, *possible(selection, best)]),
    )


def possible(selection: Selection, best: Trial) -> list[Record]:
    """Return what else may be the answer: sets that leave nothing over, of usual sizes."""
    tried = selection.tried.values()
    return [item for item in tried if item.adequate and item.plausible and item is not best.record]


def probabilities(records: Sequence[Record]) -> dict[str, float]:
    """Return how probable it is that each effect is missing, over sets that may be the answer.

    Evidence counts by what laws of effects are worth, as it does for the answer (`margin`).
    """
    logs = np.array([item.evidence for item in records])
    weight = np.exp((logs - logs.max()) * LEAST_EVIDENCE / margin(float(logs.max())))
    weight /= weight.sum()
    names = sorted({name for item in records for name in item.names})
    return {
        name: float(sum(w for w, item in zip(weight, records, strict=True) if name in item.names))
        for name in names
    }


def side(
    refit: Refit,
    fit: Fit,
    design: Linearization,
    linear: GaussianModel,
    recordings: tuple[Sequence[RecordingData], Sequence[RecordingData]],
) -> Evaluation:
    """Return a model beside all recordings: training and held-out ones."""
    arm = augmented(refit, fit)
    training, held_out = recordings
    every = scores(arm, [*training, *held_out])
    first, rest = every[: len(training)], every[len(training) :]
    runs = range(design.training), range(design.training, len(design.blocks))
    return Evaluation(
        arm=arm,
        fit=fit,
        training=misfit(first, linear, runs[0], design),
        held_out=misfit(rest, linear, runs[1], design) if rest else None,
        training_scores=first,
        held_out_scores=rest,
    )


def adequacy(groups: Sequence[Group]) -> Adequacy:
    """Return the test of the worst of the groups, at the level of all of them together."""
    worst = min(groups, key=lambda item: item.p_value)
    return Adequacy(
        statistic=worst.statistic,
        threshold=worst.threshold(LEVEL / len(groups)),
        p_value=min(1.0, worst.p_value * len(groups)),
    )


def evidence(
    selection: Selection, found: Sequence[Candidate], alike: Mapping[tuple[str, str], float]
) -> tuple[Evidence, ...]:
    """Return what was tried, the best first; effects that were not refitted by their score."""
    trials = sorted(selection.tried.values(), key=lambda item: -item.evidence)
    out = [
        Evidence(
            effects=item.names,
            chi_squared=item.gain,
            evidence=item.evidence,
            adequate=item.adequate,
            alike=look_alikes(item.names, alike),
        )
        for item in trials
        if item.names
    ]
    fitted_alone = {item.names[0] for item in trials if len(item.names) == 1}
    out += [
        Evidence(
            effects=(item.hypothesis.name,),
            chi_squared=item.gain,
            evidence=float('nan'),
            adequate=False,
            alike=look_alikes((item.hypothesis.name,), alike),
        )
        for item in found
        if item.hypothesis.name not in fitted_alone
    ]
    return tuple(out)


def look_alikes(names: tuple[str, ...], alike: Mapping[tuple[str, str], float]) -> tuple[str, ...]:
    """Return the effects that act as one of these does on these recordings, but for its size."""
    pairs = [pair for pair, cosine in alike.items() if abs(cosine) > SAME]
    both = {name for pair in pairs if set(pair) & set(names) for name in pair}
    return tuple(sorted(both - set(names)))


def notes(first: Trial, best: Trial, verdict: Verdict) -> tuple[str, ...]:
    """Return what else one should know."""
    out = []
    if verdict.answer == 'unknown' and best.names:
        left = min(best.record.groups, key=lambda item: item.p_value)
        out.append(
            f'{" + ".join(best.names)} explains most (chi squared falls by '
            f'{best.record.gain:.0f}), but something is left beside it ({left.name}): it is not '
            'what is missing, or not alone'
        )
    if not first.refit.converged:
        out.append('the fit of the base model has not settled')
    return tuple(out)


def sentence(verdict: Verdict, before: float, after: float) -> str:
    """Return the answer in one sentence."""
    names = ' and '.join(verdict.trial.names)
    gap = f'from {millimeters(before):.2f} to {millimeters(after):.2f} mm rms'
    match verdict.answer:
        case 'none':
            return 'Nothing is missing that these recordings could show.'
        case 'unobservable':
            return 'These recordings could not have shown any effect of the library.'
        case 'unknown':
            return 'Something is missing, and it is no effect of the library.'
        case 'named':
            return f'What is missing is {names}: with it the gap falls {gap}.'
    others = ' or '.join(verdict.alternatives)
    return (
        f'What is missing is {names} or {others}, which these recordings cannot tell apart: with '
        f'it the gap falls {gap}.'
    )

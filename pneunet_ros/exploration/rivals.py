"""Effects that may still be missing, and their probabilities.

Rivals are the effects of the library, each added to the effects named so far, and the hypothesis
that nothing more is missing.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.result import UnsettledDiagnosis
from pneunet_ros.diagnosis.scores.score_test import Candidate
from pneunet_ros.diagnosis.selection import evidence_margin, Selection, Trial
from pneunet_ros.diagnosis.settings import LEAST_EVIDENCE

NOTHING = 'nothing'  # the rival with no missing effect besides the named ones


def named_effects(investigation: Investigation | UnsettledInvestigation) -> frozenset[str]:
    """Return the named effects; none if the answer is another one."""
    diagnosis = investigation.diagnosis
    if isinstance(diagnosis, UnsettledDiagnosis) or diagnosis.answer != 'named':
        return frozenset()
    return frozenset(item.name for item in diagnosis.effects)


def trial_to_extend(investigation: Investigation) -> Trial:
    """Return the trial that rivals extend: the named one, or the base.

    Effects that cannot be distinguished are rivals of each other, on top of the base.
    """
    return investigation.trial if investigation.diagnosis.answer == 'named' else investigation.base


def rival_candidates(selection: Selection, trial: Trial) -> list[Candidate]:
    """Return the effects that may be missing in addition to those of a trial.

    Effects that were unobservable so far are tried at the middle of their range, without
    information.
    """
    scored = selection.score_candidates(trial)
    known = {*trial.names, *(item.name for item in scored)}
    unseen = []
    for item in selection.hypotheses:
        if item.name not in known:
            starts = item.starts()
            which, tried = starts[len(starts) // 2]
            unseen.append(
                Candidate(
                    hypothesis=item,
                    which=which,
                    tried=tried,
                    gain=0.0,
                    start=tried,
                    information=0.0,
                    direction=(),
                )
            )
    return [*scored, *unseen]


def rival_probabilities(investigation: Investigation | UnsettledInvestigation) -> dict[str, float]:
    """Return the probability of each effect, and of none, to be missing.

    Each is on top of the named effects, or alone without any. A fitted effect is weighted by its
    evidence, others by their score, as if points were linear in them. An effect that was
    unobservable so far is as probable as no effect.
    """
    if isinstance(investigation, UnsettledInvestigation):
        return {}
    selection, trial = investigation.selection, trial_to_extend(investigation)
    logs = {NOTHING: 0.0}
    for item in rival_candidates(selection, trial):
        fitted = selection.tried.get(frozenset([*trial.names, item.name]))
        logs[item.name] = (
            linear_evidence(item) if fitted is None else fitted.over(trial.record).evidence
        )
    values = np.array(list(logs.values()))
    sharpness = LEAST_EVIDENCE / evidence_margin(float(values.max()))
    weights = np.exp(sharpness * (values - values.max()))
    return dict(zip(logs, (weights / weights.sum()).tolist(), strict=True))


def size_moments(item: Candidate) -> tuple[float, float]:
    """Return mean and variance of an effect size, in units of the tried one."""
    coordinate = item.hypothesis.coordinates[item.which]
    tried = abs(float(item.tried[item.which]))
    variance = 1.0 / ((tried / coordinate.std) ** 2 + item.information)
    mean = variance * math.sqrt(item.gain * item.information)
    return mean, variance


def linear_evidence(item: Candidate) -> float:
    """Return the gain in log probability by an effect, for a prior of its size."""
    coordinate = item.hypothesis.coordinates[item.which]
    prior = (coordinate.std / abs(float(item.tried[item.which]))) ** 2
    mean, variance = size_moments(item)
    return 0.5 * (mean**2 / variance - math.log(prior / variance))

"""Effects that may still be missing, and their probabilities.

Rivals are the effects of the library, each added to the effects named so far, and the hypothesis
that nothing more is missing.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.diagnosis.investigation import Investigation
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.diagnosis.score_test import Candidate
from pneunet_ros.diagnosis.selection import evidence_margin, Selection, Trial

NOTHING = 'nothing'  # the rival that nothing is missing, beside what is named


def named_effects(investigation: Investigation) -> frozenset[str]:
    """Return the names of the effects that are named; none where the answer is another one."""
    diagnosis = investigation.diagnosis
    if not isinstance(diagnosis, Diagnosis) or diagnosis.answer != 'named':
        return frozenset()
    return frozenset(item.name for item in diagnosis.effects)


def trial_in_question(investigation: Investigation) -> Trial | None:
    """Return the trial that rivals extend: the named one, else the base; None if there is no fit.

    Where effects cannot be distinguished each is a rival of the other, on top of the base.
    """
    return investigation.trial if investigation.diagnosis.answer == 'named' else investigation.base


def rival_candidates(selection: Selection, trial: Trial) -> list[Candidate]:
    """Return the effects that may be missing in addition to those of a trial.

    Effects that are unobservable so far are tried at the middle of their range, with no
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


def rival_probabilities(investigation: Investigation) -> dict[str, float]:
    """Return the probability of each effect, and of none, to be missing.

    Each on top of what is named, alone where nothing is. Of an effect that was fitted by its
    evidence; else by its score, as if points were linear in it. An effect that no recording could
    have shown so far is as probable as none.
    """
    selection, trial = investigation.selection, trial_in_question(investigation)
    if selection is None or trial is None:
        return {}
    logs = {NOTHING: 0.0}
    for item in rival_candidates(selection, trial):
        fitted = selection.tried.get(frozenset([*trial.names, item.name]))
        logs[item.name] = (
            linear_evidence(item) if fitted is None else fitted.over(trial.record).evidence
        )
    values = np.array(list(logs.values()))
    settings = selection.settings.selection
    sharpness = settings.least_evidence / evidence_margin(float(values.max()), settings)
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
    """Return the log probability that an effect gains, over a prior of its size."""
    coordinate = item.hypothesis.coordinates[item.which]
    prior = (coordinate.std / abs(float(item.tried[item.which]))) ** 2
    mean, variance = size_moments(item)
    return 0.5 * (mean**2 / variance - math.log(prior / variance))

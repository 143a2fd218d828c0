"""Which effects are missing: scores, joint refits, evidence; forward, then backward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.diagnosis.base_fit import Each
from pneunet_ros.diagnosis.gaussian_model import GaussianModel
from pneunet_ros.diagnosis.hypothesis import Hypothesis
from pneunet_ros.diagnosis.lack_of_fit import Group, groups_of, Mapped
from pneunet_ros.diagnosis.linearization import Linearization
from pneunet_ros.diagnosis.refit import finished, Refit, refit, Refitting, split
from pneunet_ros.diagnosis.score_test import Candidate, clean_score, score_effects

MOST_EFFECTS = 3
SHORTLIST = 5  # hypotheses that are refitted, in order of their score
FINALISTS = 2  # of these, refitted to the end
NEAR = 0.3  # of the best improvement, what a finalist must reach after its first round
WORTH_A_FIT = 4.0  # of chi squared by the score
MOST_OF_IT = 0.5  # of what is left beside one effect, that may be left beside two
HOPELESS = 0.2  # of what the base leaves; invented, as those above
ROUNDS = 5
LEAST_EVIDENCE = 3.0  # log probability of recordings predicted from the others
PLAUSIBLE = 4.0  # standard deviations of the prior: twice its range
LAW_EVIDENCE = 0.02  # of the evidence: less does not tell two laws apart; invented
LEAST_GAIN = 16.0  # of chi squared: four standard deviations
LEVEL = 0.002  # of a false alarm of the omnibus tests together
LAW_ERROR = 0.2  # of what the base leaves, that the law of an effect may miss; invented
NEXT_GAIN = 0.02  # of what is explained, that one more effect must explain; invented


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """What came of effects that were fitted jointly.

    evidence over the base, in log probability; gain in chi squared; groups: what is left beside
    them; plausible: no size is far beyond its prior range.
    """

    names: tuple[str, ...]
    dof: int
    evidence: float
    gain: float
    groups: tuple[Group, ...]
    adequate: bool
    plausible: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """Effects that were fitted jointly, ready to go on from."""

    record: Record
    refit: Refit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return self.record.names


@dataclass(slots=True, kw_only=True)
class Selection:
    """The search over sets of effects, and all that was tried."""

    design: Linearization
    hypotheses: tuple[Hypothesis, ...]
    seed: int
    each: Each
    mapped: Mapped = map
    tried: dict[frozenset[str], Record] = field(default_factory=dict)
    scores: dict[frozenset[str], list[Candidate]] = field(default_factory=dict)

    def base(self) -> Trial:
        """Fit the model without any further effect."""
        self.each('the base model', 0, 0)
        found = refit(self.design.of_training(), (), np.zeros(0), ROUNDS)
        if found is None:
            raise ModelError('the model has no shape in most of the training recordings')
        return self.recorded(found, None)

    def recorded(self, found: Refit, base: Trial | None) -> Trial:
        """Test a joint fit, and keep what came of it."""
        groups = groups_of(*self.wholly(found), self.seed, self.mapped)
        before = () if base is None else base.record.groups
        reference = found if base is None else base.refit
        record = Record(
            names=found.names,
            dof=found.numbers.size,
            evidence=found.linear.evidence() - reference.linear.evidence(),
            gain=2.0 * (reference.cost - found.cost),
            groups=groups,
            adequate=clean(groups, before),
            plausible=plausible(found),
        )
        self.tried[frozenset(record.names)] = record
        return Trial(record=record, refit=found)

    def forward(self, base: Trial) -> Trial:
        """Add effects one by one while that helps; return the best set found."""
        best = base
        if best.record.adequate and not self.more(best):
            return best
        for count in range(MOST_EFFECTS):
            better = self.extended(base, best, thorough=count == 0)
            if better is None or (count and not worth_adding(best, better)):
                return best
            best = self.backward(base, better)
            if best.record.adequate and not self.more(best):
                return best
            if count and excess(best) > HOPELESS * excess(base):
                return best  # two effects that leave so much: a third would only hide it
        return best

    def following(self, trial: Trial) -> list[Candidate]:
        """Return what may come beside the effects of a trial."""
        key = frozenset(trial.names)
        if key not in self.scores:
            self.each('scores beside ' + (' + '.join(trial.names) or 'the base model'), 0, 0)
            self.scores[key] = score_effects(trial.refit, self.hypotheses)
        return self.scores[key]

    def more(self, trial: Trial) -> bool:
        """Whether another effect has a significant score beside these."""
        following = self.following(trial)
        by_chance = clean_score(trial.refit.linear, following, LEVEL, self.seed)
        needed = max(by_chance, LEAST_GAIN)
        if clean(trial.record.groups, ()):
            needed = max(needed, NEXT_GAIN * trial.record.gain)
        return bool(following) and following[0].gain > needed

    def extended(self, base: Trial, trial: Trial, *, thorough: bool) -> Trial | None:
        """Return the best set with one effect more; None where none is good enough.

        thorough: where no set is adequate, fit all likely effects; small steps may mislead.
        """
        following = self.following(trial)
        most = following[0].gain if following else 0.0
        clear = sum(item.gain >= NEAR * most for item in following)
        likely = sum(item.gain > WORTH_A_FIT for item in following)
        stops = [clear, max(clear, SHORTLIST), *([likely] if thorough else [])]
        chosen: Trial | None = None
        done = 0
        for stop in stops:
            found = self.finalists(base, trial, following[done:stop])
            chosen = best_of(trial, [*([] if chosen is None else [chosen]), *found])
            done = stop
            if chosen is not None and chosen.record.adequate:
                return chosen
        return chosen

    def finalists(self, base: Trial, trial: Trial, following: Sequence[Candidate]) -> list[Trial]:
        """Refit once with each candidate, and those that come near the best to the end."""
        first = []
        for place, item in enumerate(following):
            together = (*trial.refit.hypotheses, item.hypothesis)
            self.each(' + '.join(one.name for one in together), place, len(following))
            numbers = np.concatenate([trial.refit.numbers, item.start])
            found = refit(trial.refit.design, together, numbers, 1)
            if found is not None:
                first.append(found)
        improvement = [trial.refit.cost - item.cost for item in first]
        needed = max(NEAR * max(improvement, default=0.0), 0.25 * LEAST_GAIN)
        order = np.argsort([-value for value in improvement])[:FINALISTS].tolist()
        chosen = [first[place] for place in order if improvement[place] >= needed]
        del first  # designs are large
        out = []
        for place, found in enumerate(chosen):
            self.each('to the end: ' + ' + '.join(found.names), place, len(chosen))
            out.append(self.recorded(finished(found, ROUNDS), base))
        return out

    def wholly(self, found: Refit) -> tuple[Linearization, GaussianModel]:
        """Return all recordings around a refit, held-out ones too, as a linear problem.

        Scores of fields in held-out recordings are then those of what the training ones predict of
        them: V^-1 of all, with fields of some, is that of these given the others.
        """
        design = self.design.at(found.point)
        search = Refitting(design, found.hypotheses, len(design.blocks))
        at = search.residuals(found.base, found.numbers)
        linear = None if at is None else search.linear(found.base, found.numbers, at)
        if linear is None:
            raise ModelError(
                'a held-out recording has no shape with the model of the training ones'
            )
        return design, linear

    def backward(self, base: Trial, trial: Trial) -> Trial:
        """Leave out effects without which the recordings are predicted as well."""
        while len(trial.names) > 1:
            least = trial.record.evidence - LEAST_EVIDENCE
            without = [self.without(base, trial, name, least) for name in trial.names]
            kept = [item for item in without if item is not None]
            if not kept:
                return trial
            trial = max(kept, key=lambda item: item.record.evidence)
        return trial

    def without(self, base: Trial, trial: Trial, name: str, least: float) -> Trial | None:
        """Return the set without one of its effects; None where its evidence is not enough."""
        left = tuple(item for item in trial.refit.hypotheses if item.name != name)
        known = self.tried.get(frozenset(item.name for item in left))
        if known is not None and known.evidence < least:
            return None
        numbers = [
            item.numbers(effect)
            for item, effect in zip(trial.refit.hypotheses, trial.refit.effects, strict=True)
            if item.name != name
        ]
        first = refit(trial.refit.design, left, np.concatenate(numbers), ROUNDS)
        if first is None:
            return None
        found = self.recorded(first, base)
        return found if found.record.evidence >= least else None


def best_of(trial: Trial, found: Sequence[Trial]) -> Trial | None:
    """Return the most probable of the sets that are better than the one they extend.

    Adequate and plausible ones come first; of those alike, the one with the fewest numbers.
    """
    better = [
        item
        for item in found
        if item.record.evidence > trial.record.evidence + LEAST_EVIDENCE
        and item.record.gain > trial.record.gain + LEAST_GAIN
    ]
    likely = [item for item in better if item.record.plausible]
    adequate = [item for item in likely if item.record.adequate]
    chosen = adequate or [item for item in better if item.record.adequate] or likely or better
    most = max((item.record.evidence for item in chosen), default=0.0)
    alike = [item for item in chosen if item.record.evidence >= most - margin(most)]
    return min(alike, key=lambda item: (item.record.dof, -item.record.evidence), default=None)


def worth_adding(trial: Trial, better: Trial) -> bool:
    """Whether one effect more is another effect, and not what the law of the first one misses.

    It explains a good part of what the first does, or most of what is left.
    """
    more = better.record.gain - trial.record.gain
    if more > NEXT_GAIN * trial.record.gain and better.record.adequate:
        return True
    return excess(better) < MOST_OF_IT * excess(trial)


def excess(trial: Trial) -> float:
    """Return the most that is left in any group of fields, beyond what clean data have."""
    return max((item.excess for item in trial.record.groups), default=0.0)


def plausible(found: Refit) -> bool:
    """Whether no size of the effects is far beyond its prior range."""
    parts = split(found.hypotheses, found.numbers)
    return all(
        bool(np.all(np.abs(numbers - item.mean) <= PLAUSIBLE * item.std))
        for item, numbers in zip(found.hypotheses, parts, strict=True)
    )


def margin(evidence: float) -> float:
    """Return by how much evidence must differ to count; no law of an effect is exact."""
    return max(LEAST_EVIDENCE, LAW_EVIDENCE * evidence)


def clean(groups: Sequence[Group], before: Sequence[Group]) -> bool:
    """Whether nothing is left but what clean data have, or what a law of an effect may miss."""
    allowed = LAW_ERROR * max((item.excess for item in before), default=0.0)
    level = LEVEL / max(len(groups), 1)
    return bool(groups) and all(item.p_value > level or item.excess < allowed for item in groups)

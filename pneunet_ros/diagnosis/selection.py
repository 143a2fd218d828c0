"""Which effects are missing: scores, joint refits, evidence; forward, then backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.diagnosis.adequacy import Group, groups_of, Mapped
from pneunet_ros.diagnosis.candidates import Candidate, candidates
from pneunet_ros.diagnosis.design import Design
from pneunet_ros.diagnosis.hypothesis import Hypothesis
from pneunet_ros.diagnosis.linear import Linear
from pneunet_ros.diagnosis.refit import finished, Refit, refit, Refitting, split
from pneunet_ros.errors import ModelError

MOST_EFFECTS = 3
SHORTLIST = 5  # hypotheses that are refitted, in order of their score
FINALISTS = 3  # of these, refitted to the end
NEAR = 0.3  # of the best improvement, what a finalist must reach after its first round
ROUNDS = 5
LEAST_EVIDENCE = 3.0  # log probability of recordings predicted from the others
PLAUSIBLE = 4.0  # standard deviations of the prior: twice its range
LAW_EVIDENCE = 0.02  # of the evidence: less does not tell two laws apart; invented
LEAST_GAIN = 16.0  # of chi squared: four standard deviations
LEVEL = 0.002  # of a false alarm of the omnibus tests together
LAW_ERROR = 0.05  # of what an effect explains: no law is better than this; invented

Each = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """Effects that were fitted jointly: evidence over the base, and what is left beside them.

    evidence in log probability; gain in chi squared; design, whole: all recordings,
    held-out ones too, and their linear problem; groups: the omnibus tests on it.
    """

    refit: Refit
    design: Design
    whole: Linear
    evidence: float
    gain: float
    groups: tuple[Group, ...]
    adequate: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return self.refit.names

    @property
    def plausible(self) -> bool:
        """Whether no size is far beyond its prior range."""
        parts = split(self.refit.hypotheses, self.refit.numbers) if self.names else []
        return all(
            bool(np.all(np.abs(numbers - item.mean) <= PLAUSIBLE * item.std))
            for item, numbers in zip(self.refit.hypotheses, parts, strict=True)
        )


@dataclass(slots=True, kw_only=True)
class Selection:
    """The search over sets of effects, and all that was tried."""

    design: Design
    hypotheses: tuple[Hypothesis, ...]
    seed: int
    each: Each
    mapped: Mapped = map
    tried: dict[frozenset[str], Trial] = field(default_factory=dict)
    scores: dict[frozenset[str], list[Candidate]] = field(default_factory=dict)

    def base(self) -> Trial:
        """Fit the model without any further effect."""
        self.each('the base model', 0, 0)
        found = refit(self.design.of_training(), (), np.zeros(0), ROUNDS)
        if found is None:
            raise AssertionError('the base model has shapes where it was fitted')
        design, whole = self.wholly(found)
        groups = groups_of(design, whole, self.seed, self.mapped)
        trial = Trial(
            refit=found,
            design=design,
            whole=whole,
            evidence=0.0,
            gain=0.0,
            groups=groups,
            adequate=clean(groups, ()),
        )
        self.tried[frozenset()] = trial
        return trial

    def forward(self) -> Trial:
        """Add effects one by one while that helps; return the best set found."""
        best = self.tried[frozenset()]
        if best.adequate and not self.more(best):
            return best
        for _ in range(MOST_EFFECTS):
            better = self.extended(best)
            if better is None:
                return best
            best = self.backward(better)
            if best.adequate and not self.more(best):
                return best
        return best

    def following(self, trial: Trial) -> list[Candidate]:
        """Return what may come beside the effects of a trial."""
        key = frozenset(trial.names)
        if key not in self.scores:
            self.each('scores beside ' + (' + '.join(trial.names) or 'the base model'), 0, 0)
            self.scores[key] = candidates(trial.refit, self.hypotheses)
        return self.scores[key]

    def more(self, trial: Trial) -> bool:
        """Whether another effect has a significant score beside these."""
        following = self.following(trial)
        needed = max(LEAST_GAIN, LAW_ERROR * trial.gain)
        return bool(following) and following[0].gain > needed

    def extended(self, trial: Trial) -> Trial | None:
        """Return the best set with one effect more; None where none is good enough."""
        following = self.following(trial)
        most = following[0].gain if following else 0.0
        # Where nothing is right yet, scores of small steps may mislead: then fit more of them.
        clear = sum(item.gain >= NEAR * most for item in following)
        found: list[Trial] = []
        chosen = None
        done = 0
        for stop in (clear, max(clear, SHORTLIST), len(following)):
            found += self.finalists(trial, following[done:stop])
            done = stop
            chosen = self.best_of(trial, found)
            if chosen is not None and chosen.adequate:
                return chosen
        return chosen

    def best_of(self, trial: Trial, found: Sequence[Trial]) -> Trial | None:
        """Return the most probable of the sets that are better than the one they extend."""
        better = [
            item
            for item in found
            if item.evidence > trial.evidence + LEAST_EVIDENCE
            and item.gain > trial.gain + LEAST_GAIN
        ]
        likely = [item for item in better if item.plausible]
        adequate = [item for item in likely if item.adequate]
        chosen = adequate or [item for item in better if item.adequate] or likely or better
        most = max((item.evidence for item in chosen), default=0.0)
        alike = [item for item in chosen if item.evidence >= most - margin(most)]
        return min(alike, key=lambda item: (item.refit.numbers.size, -item.evidence), default=None)

    def finalists(self, trial: Trial, following: Sequence[Candidate]) -> list[Trial]:
        """Refit once with each candidate, and those that come near the best to the end."""
        first = []
        for place, item in enumerate(following):
            name = ' + '.join((*trial.names, item.hypothesis.name))
            self.each(name, place, len(following))
            together = (*trial.refit.hypotheses, item.hypothesis)
            key = frozenset(one.name for one in together)
            if key in self.tried:
                continue
            numbers = np.concatenate([trial.refit.numbers, item.start])
            found = refit(trial.refit.design, together, numbers, 1)
            if found is not None:
                first.append(found)
        improvement = [trial.refit.cost - item.cost for item in first]
        most = max(improvement, default=0.0)
        order = np.argsort([-value for value in improvement])[:FINALISTS]
        out = []
        for place in order.tolist():
            if improvement[place] < max(NEAR * most, 0.25 * LEAST_GAIN):
                continue
            self.each('to the end: ' + ' + '.join(first[place].names), place, len(order))
            out.append(self.completed(first[place]))
        known = [
            self.tried[key]
            for item in following
            if (key := frozenset((*trial.names, item.hypothesis.name))) in self.tried
        ]
        return [*out, *(item for item in known if item not in out)]

    def completed(self, first: Refit) -> Trial:
        """Refit to the end, with evidence and tests."""
        found = finished(first, ROUNDS)
        base = self.tried[frozenset()]
        design, whole = self.wholly(found)
        groups = groups_of(design, whole, self.seed, self.mapped)
        trial = Trial(
            refit=found,
            design=design,
            whole=whole,
            evidence=found.linear.evidence() - base.refit.linear.evidence(),
            gain=2.0 * (base.refit.cost - found.cost),
            groups=groups,
            adequate=clean(groups, base.groups),
        )
        self.tried[frozenset(found.names)] = trial
        return trial

    def wholly(self, found: Refit) -> tuple[Design, Linear]:
        """Return all recordings around a refit, held-out ones too, as a linear problem.

        Of a held-out recording nothing is fitted but what every recording has of its own.
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

    def backward(self, trial: Trial) -> Trial:
        """Leave out effects without which the recordings are predicted as well."""
        while len(trial.names) > 1:
            without = [self.without(trial, name) for name in trial.names]
            kept = [item for item in without if item is not None]
            best = max(kept, key=lambda item: item.evidence, default=None)
            if best is None or best.evidence < trial.evidence - LEAST_EVIDENCE:
                return trial
            trial = best
        return trial

    def without(self, trial: Trial, name: str) -> Trial | None:
        """Return the set without one of its effects."""
        left = tuple(item for item in trial.refit.hypotheses if item.name != name)
        key = frozenset(item.name for item in left)
        if key not in self.tried:
            numbers = [
                item.numbers(effect)
                for item, effect in zip(trial.refit.hypotheses, trial.refit.effects, strict=True)
                if item.name != name
            ]
            first = refit(trial.refit.design, left, np.concatenate(numbers), 0)
            if first is None:
                return None
            self.completed(first)
        return self.tried[key]


def margin(evidence: float) -> float:
    """Return by how much evidence must differ to count; no law of an effect is exact."""
    return max(LEAST_EVIDENCE, LAW_EVIDENCE * evidence)


def clean(groups: Sequence[Group], before: Sequence[Group]) -> bool:
    """Whether nothing is left but what clean data have, or what a law of an effect may miss."""
    allowed = LAW_ERROR * max((item.excess for item in before), default=0.0)
    level = LEVEL / max(len(groups), 1)
    return bool(groups) and all(item.p_value > level or item.excess < allowed for item in groups)

"""Joint fit of a law with the base model, as the effect that will be in its file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis, hypothesis
from pneunet_ros.diagnosis.fit.refit import Refit, refit
from pneunet_ros.diagnosis.selection import Selection, Trial
from pneunet_ros.discovery.covariates import CONSTANT
from pneunet_ros.discovery.kinds import Kind
from pneunet_ros.discovery.law import Law
from pneunet_ros.discovery.proposed_effect import effect_class, Parameter, POSITION
from pneunet_ros.discovery.search import Search
from pneunet_ros.discovery.settings import HELD, IDLE, LAW, MOST_TERMS, ROUNDS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """A law as an effect, fitted jointly with the model.

    terms of the law, and the corresponding parameters of the effect; trial: the fit with its
    residuals, whose last hypothesis is this effect.
    """

    kind: Kind
    terms: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    trial: Trial

    @property
    def evidence(self) -> float:
        """Log probability of every recording predicted from the others, over the base."""
        return self.trial.record.evidence

    @property
    def numbers(self) -> Array:
        """The fitted numbers of this effect, as in its hypothesis."""
        fit = self.trial.refit
        return fit.numbers[-fit.hypotheses[-1].size :]

    @property
    def stds(self) -> Array:
        """Their standard errors."""
        return np.asarray(np.sqrt(np.diag(self.trial.refit.covariance))[-self.numbers.size :])

    @property
    def position(self) -> float | None:
        """The place (s / l) of the cause; None if its kind has no place."""
        if self.kind.positions is None:
            return None
        return float(getattr(self.trial.refit.effects[-1], POSITION))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFits:
    """Joint fits of laws on top of a trial.

    first: the model without effects; base: the model to which laws are added; search: around the
    base.
    """

    selection: Selection
    first: Trial
    base: Trial
    search: Search

    def propose(self, law: Law) -> Proposal | None:
        """Fit a law with a fixed position, and add missing terms.

        None if the arm has no shape with it.
        """
        return self.lengthened(self.fit(law.cause.kind, law.terms, self.start(law)))

    def propose_constant(self, kind: Kind) -> Proposal | None:
        """Fit a constant amplitude, and add missing terms.

        A calibration absorbs a part of any cause and most of a constant one, and the remainder
        resembles a law. The position is fixed at first, and several positions are tried.
        """
        if CONSTANT not in self.search.covariates or 'constant' not in kind.follows:
            return None
        start = np.zeros(1)
        if kind.positions is None:
            return self.lengthened(self.fit(kind, (CONSTANT,), start))
        low, high = kind.positions
        steps = np.arange(HELD) + 0.5
        held = [
            self.fit(kind, (CONSTANT,), np.append(start, np.log(position)), hold_position=True)
            for position in (low + steps / steps.size * (high - low)).tolist()
        ]
        found = [item for item in held if item is not None]
        for item in sorted(found, key=lambda item: item.evidence, reverse=True):
            free = self.fit(kind, item.terms, item.numbers, item.trial.refit)
            if free is not None:
                return self.lengthened(free)
        return None

    def lengthened(self, proposal: Proposal | None) -> Proposal | None:
        """Extend a fit by missing terms while the gain is sufficient."""
        for _ in range(ROUNDS):
            if proposal is None:
                return None
            longer = self.with_missing_terms(proposal)
            if longer is None:
                break
            proposal = longer
        return proposal

    def with_missing_terms(self, proposal: Proposal) -> Proposal | None:
        """Return the fit with missing terms; None if the gain is too small."""
        missing = self.missing_terms(proposal)
        if not missing:
            return None
        numbers = np.insert(proposal.numbers, len(proposal.terms), np.zeros(len(missing)))
        terms = (*proposal.terms, *missing)
        better = self.fit(proposal.kind, terms, numbers, proposal.trial.refit)
        least = proposal.evidence + LAW.least_gain
        return None if better is None or better.evidence < least else better

    def remove_unnecessary_terms(self, proposal: Proposal) -> Proposal:
        """Remove terms that are not needed to predict the recordings.

        With a wrong position or base, a law appears to have more terms than it has.
        """
        while len(proposal.terms) > 1:
            count = len(proposal.terms)
            ratios = np.abs(proposal.numbers[:count]) / proposal.stds[:count]
            weakest = int(np.argmin(ratios))
            if ratios[weakest] > IDLE:
                break
            terms = (*proposal.terms[:weakest], *proposal.terms[weakest + 1 :])
            numbers = np.delete(proposal.numbers, weakest)
            shorter = self.fit(proposal.kind, terms, numbers, proposal.trial.refit)
            least = proposal.evidence - LAW.least_gain
            if shorter is None or shorter.evidence < least:
                break
            proposal = shorter
        return proposal

    def start(self, law: Law) -> Array:
        """Return the start values of the fit of a law."""
        kind = law.cause.kind
        sizes = [
            kind.natives[term].prior
            if term in kind.natives
            else kind.prior / self.search.covariates[term].scale
            for term in law.terms
        ]
        numbers = law.coefficients * np.array(sizes)
        if law.cause.position is None:
            return np.asarray(numbers)
        return np.append(numbers, np.log(law.cause.position))

    def fit(
        self,
        kind: Kind,
        terms: tuple[str, ...],
        numbers: Array,
        start_fit: Refit | None = None,
        *,
        hold_position: bool = False,
    ) -> Proposal | None:
        """Fit jointly from these start values until converged, possibly at a fixed position.

        None if the arm has no shape with it in a training or held-out recording.
        """
        parameters = self.search.parameters(kind, terms)
        added = hypothesis(effect_class(self.search.source(kind, parameters)), self.search.size)
        if hold_position:
            added = with_held_position(added, float(numbers[-1]))
        known = self.base.refit
        found = refit(
            known.linearization if start_fit is None else start_fit.linearization,
            (*known.hypotheses, added),
            np.concatenate([known.numbers, numbers]),
        )
        trial = None if found is None else self.selection.test_trial(found, self.first)
        if trial is None:
            return None
        return Proposal(kind=kind, terms=terms, parameters=parameters, trial=trial)

    def missing_terms(self, proposal: Proposal) -> tuple[str, ...]:
        """Return terms of the kind that the fit with the law still lacks."""
        room = MOST_TERMS - len(proposal.terms)
        if room <= 0:
            return ()
        search = Search(proposal.trial.refit)
        law = search.law(proposal.kind, proposal.position, search.runs)
        if law is None:
            return ()
        runnable = [
            term
            for term in law.terms
            if term not in proposal.terms
            and (term in proposal.kind.natives or self.follows(proposal.kind, term))
        ]
        return tuple(runnable[:room])

    def follows(self, kind: Kind, term: str) -> bool:
        """Whether an effect of a kind can follow a term, which must vary around the first fit."""
        covariate = self.search.covariates.get(term)
        return covariate is not None and covariate.meaning.group in kind.follows


def with_held_position(free: Hypothesis, number: float) -> Hypothesis:
    """Return a hypothesis with fixed position, the last of its numbers."""
    position = replace(free.coordinates[-1], low=number, high=number)
    return replace(free, coordinates=(*free.coordinates[:-1], position))

"""Diagnosis by a single evidence: explain, relinearize with the strongest effect, and repeat.

Beside today's `diagnose()` it has no shortlist, no finalists, no backward elimination and no name
that is taken back: effects and kinds of discovery compete as columns of one marginal likelihood.
The gate (lack of fit) and held-out recordings stay the last word.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.diagnosis.conclusion import conclude
from pneunet_ros.diagnosis.confirmation import Confirmer
from pneunet_ros.diagnosis.decision import closest_notes, effect_probabilities
from pneunet_ros.diagnosis.diagnosis import (
    considered_hypotheses,
    is_settled,
    limits_of,
    linearize,
    unsettled_diagnosis,
)
from pneunet_ros.diagnosis.fit.base_fit import fit_base
from pneunet_ros.diagnosis.fit.hypothesis import hypotheses
from pneunet_ros.diagnosis.fit.refit import refit
from pneunet_ros.diagnosis.investigation import Investigation, UnsettledInvestigation
from pneunet_ros.diagnosis.selection import evidence_margin, Selection, Trial
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings, LEAST_EVIDENCE, SCORE_TEST
from pneunet_ros.diagnosis.usable_frames import at_rest, with_tips
from pneunet_ros.diagnosis.verdict import Verdict
from pneunet_ros.discovery.covariates import ELAPSED
from pneunet_ros.discovery.joint_fit import JointFits
from pneunet_ros.discovery.law import Law
from pneunet_ros.discovery.library_words import is_equivalent_to
from pneunet_ros.discovery.proposed_effect import PREFIX
from pneunet_ros.discovery.search import Search
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm

from evidence.dictionary import Columns
from evidence.sparse import Dictionary, explain, Explanation

MOST_EFFECTS = 3
OVERRULES = 0.1  # of the evidence: as `LawConfirmationSettings.beside_named`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Around:
    """The dictionary around a trial, and what explains the training recordings best there."""

    trial: Trial
    columns: Columns
    items: Dictionary
    best: Explanation
    search: Search


class Engine:
    """One search by evidence, on the linear problem of a selection."""

    def __init__(self, selection: Selection, first: Trial) -> None:
        self.selection, self.first = selection, first
        self.runs = tuple(range(selection.linearization.training))
        self.kinds: dict[frozenset[str], str] = {}

    def around(self, trial: Trial) -> Around:
        """Explain what a trial leaves, its laws open."""
        problem = self.selection.open_laws(trial)[1]
        search = Search(trial.refit)
        columns = Columns(trial.refit, problem, self.selection.hypotheses, search)
        items = columns.dictionary(self.runs)
        best = explain(items)
        return Around(trial=trial, columns=columns, items=items, best=best, search=search)

    def extended(self, place: Around, cause: str, found: Explanation) -> Trial | None:
        """Return the joint fit with one cause more, from where the explanation has it."""
        own = [which for which in found.columns if place.items.causes[which] == cause]
        chosen, root = list(found.columns), np.sqrt(np.array(found.variances))
        inner = place.items.information[np.ix_(chosen, chosen)]
        posterior = root[:, None] * inner * root + np.eye(len(chosen))
        sizes = root * np.linalg.solve(posterior, root * place.items.score[chosen])
        coefficients = dict(zip(chosen, sizes.tolist(), strict=True))
        top = max(own, key=lambda which: abs(coefficients[which]))
        meaning, trial = place.columns.meanings[top], place.trial
        if meaning.cause is None:
            return self.with_effect(trial, place, top, coefficients[top])
        kept = {
            place.columns.meanings[which].term: coefficients[which]
            for which in own
            if place.columns.meanings[which].cause is meaning.cause
            and place.columns.meanings[which].term != ELAPSED
        }
        if not kept:
            return None
        law = Law(
            cause=meaning.cause,
            terms=tuple(kept),
            coefficients=np.array(list(kept.values())),
            covariance=np.eye(len(kept)),
            left_out_gain=0.0,
            explained=0.0,
            std=1.0,
        )
        fits = JointFits(
            selection=self.selection, first=self.first, base=trial, search=place.search
        )
        proposal = fits.propose(law)
        return None if proposal is None else proposal.trial

    def with_effect(self, trial: Trial, place: Around, top: int, size: float) -> Trial | None:
        """Return the joint fit with an effect of the library."""
        meaning = place.columns.meanings[top]
        item = meaning.hypothesis
        assert item is not None and meaning.numbers is not None
        start: Array = meaning.numbers.copy()
        value = size * item.std[meaning.which]
        if not item.is_linear:
            tried = meaning.numbers[meaning.which]
            value = tried * np.clip(
                value / tried, 1.0 / SCORE_TEST.largest_step, SCORE_TEST.largest_step
            )
        start[meaning.which] = value
        start = np.clip(start, item.low, item.high)
        known = trial.refit
        fit = refit(
            known.linearization, (*known.hypotheses, item), np.concatenate([known.numbers, start])
        )
        return None if fit is None else self.selection.test_trial(fit, self.first, trial)

    def strongest(self, place: Around) -> list[tuple[str, Explanation]]:
        """Return the strongest cause, and who would stand in its place if that is as likely."""
        first = place.best.strongest
        if first is None or place.best.weights[first] <= 0.0:
            return []
        library = not first.startswith('kind ')
        second, rival = self.rival(place, first)
        pairs = [(first, place.best)]
        lost = place.best.evidence - second.evidence
        near = max(evidence_margin(place.best.evidence), OVERRULES * place.best.evidence)
        if rival is not None and (lost < near or not library):
            pairs.append((rival, second))
        if all(cause.startswith('kind ') for cause, _ in pairs):
            kinds = [item for item in place.items.causes if item.startswith('kind ')]
            third = explain(place.items, kinds)
            if third.strongest is not None:
                pairs.append((third.strongest, third))
        return pairs

    def rival(self, place: Around, first: str) -> tuple[Explanation, str | None]:
        """Return what explains most without a cause, nor the same cause in other words."""
        without = [first]
        while True:
            found = explain(place.items, without)
            rival = found.strongest
            if rival is None or not self.says(place, found, rival, first):
                return found, rival
            without.append(rival)

    def search(self) -> tuple[Trial, list[Trial], Around]:
        """Add causes while they carry evidence; return the last trial, and its rivals."""
        trial, rivals = self.first, []
        place = base = self.around(trial)
        for count in range(MOST_EFFECTS):
            if trial.record.adequate and not self.carries(place, first=count == 0):
                break
            fitted = [
                item
                for cause, found in self.strongest(place)
                if (item := self.extended(place, cause, found)) is not None
            ]
            better = [
                item
                for item in fitted
                if item.record.over(trial.record).evidence > LEAST_EVIDENCE
                and item.record.evidence - trial.record.evidence > LEAST_EVIDENCE
            ]
            if not better:
                break
            better.sort(key=self.rank(trial), reverse=True)
            if (
                trial.names
                and not better[0].record.adequate
                and (2.0 * better[0].record.excess > trial.record.excess)
            ):
                break
            trial, rivals = better[0], better[1:]
            place = self.around(trial)
        return trial, rivals, base

    def says(self, place: Around, found: Explanation, cause: str, name: str) -> bool:
        """Whether a kind of an explanation is an effect in other words."""
        meanings = [place.columns.meanings[item] for item in found.columns
                    if place.items.causes[item] == cause]  # fmt: skip
        kinds = [(item.cause.kind.name, item.term) for item in meanings if item.cause is not None]
        return any(is_equivalent_to(kind, [term], [name]) for kind, term in kinds)

    def rank(self, known: Trial) -> Callable[[Trial], tuple[bool, float]]:
        """Return how to order trials: those that pass first, then by evidence.

        What is no effect of the library must be more probable by what laws of effects are worth.
        """
        library = {item.name for item in self.selection.hypotheses}

        def key(item: Trial) -> tuple[bool, float]:
            evidence = item.record.over(known.record).evidence
            if not {*item.names} <= library:
                evidence -= max(OVERRULES * evidence, 10.0)
            return item.record.adequate, evidence

        return key

    def carries(self, place: Around, *, first: bool) -> bool:
        """Whether a cause carries evidence beside a trial that passes the gate."""
        best = place.best
        if best.strongest is None:
            return False
        least = LEAST_EVIDENCE
        return best.weights[best.strongest] > least


def investigate(
    model: Arm,
    training: Sequence[RecordingData],
    held_out: Sequence[RecordingData],
    *,
    seed: int = 0,
    settings: DiagnosisSettings = DEFAULTS,
) -> tuple[Investigation | UnsettledInvestigation, tuple[str, ...]]:
    """Diagnose as `pneunet_ros.diagnosis.diagnosis.investigate` does, by one evidence.

    The second value: kinds of discovery of which a law passes the gate, the likeliest first.
    """
    model, training, held_out, notes = with_tips(model, training, held_out)
    training, held_out, notes, _ = at_rest(model, training, held_out, notes)
    base = fit_base(model, training, lambda *_: None, settings.declared)
    recordings = (sorted(training, key=lambda run: run.loaded), held_out)
    asked = hypotheses(model, settings.withheld)
    selection = Selection(
        linearization=linearize(base, *recordings),
        hypotheses=considered_hypotheses(asked, training),
        seed=seed,
        on_progress=lambda *_: None,
        settings=settings,
    )
    first = selection.fit_base()
    if not is_settled(first.refit):
        return UnsettledInvestigation(diagnosis=unsettled_diagnosis(seed, notes, settings)), ()
    engine = Engine(selection, first)
    best, rivals, around = engine.search()
    detectable = limits_of(selection, first, asked)
    verdict = decided(engine, best, rivals, around, detectable)
    diagnosis = conclude(selection, first, best, verdict, detectable, recordings)
    investigation = Investigation(
        diagnosis=diagnosis,
        selection=selection,
        base=first,
        best=best,
        trial=verdict.trial,
        recordings=recordings,
        notes=notes,
    )
    return investigation, law_kinds(best, rivals)


def law_kinds(best: Trial, rivals: Sequence[Trial]) -> tuple[str, ...]:
    """Return the kinds of the laws that pass and are as likely as the best, that one first."""
    if not best.record.adequate or not best.names or not best.names[-1].startswith(PREFIX):
        return ()
    least = best.record.evidence - evidence_margin(best.record.evidence)
    alike = [item for item in rivals if item.record.adequate and item.record.evidence > least]
    return tuple(item.names[-1].removeprefix(PREFIX) for item in (best, *alike))


def decided(engine: Engine, best: Trial, rivals: list[Trial], base: Around, detectable) -> Verdict:
    """Return the answer: the gate, the language that carries it, held out, recordings left out."""
    first, selection = engine.first, engine.selection
    library = {item.name for item in selection.hypotheses}
    if not best.names:
        if best.record.adequate:
            seen = any(item.observable for item in detectable.values())
            return Verdict(answer='none' if seen else 'unobservable', trial=first)
        return Verdict(answer='unknown', trial=first)
    if not best.record.adequate or not {*best.names} <= library:
        return Verdict(answer='unknown', trial=first, notes=closest_notes(best.record))
    confirmer = Confirmer.of(selection, first.record)
    margin = evidence_margin(best.record.evidence)
    alike = tuple(
        item.names
        for item in rivals
        if item.record.adequate and {*item.names} <= library
        and item.record.evidence > best.record.evidence - margin
        and not confirmer.refutations(item.record)
    )  # fmt: skip
    verdict = Verdict(answer='inseparable' if alike else 'named', trial=best, alike=alike)
    objections = confirmer.objections(best.record, verdict.alternatives)
    objections = (*objections, *left_out(engine, best, verdict, base))
    if objections:
        notes = closest_notes(best.record, objections)
        return Verdict(answer='unknown', trial=first, unconfirmed=best.names, notes=notes)
    probability = effect_probabilities([best.record])
    return replace(verdict, probability=probability)


def left_out(engine: Engine, best: Trial, verdict: Verdict, base: Around) -> tuple[str, ...]:
    """Object where another cause is the strongest without one of the training recordings."""
    allowed = {*best.names, *verdict.alternatives}
    found = []
    for which in engine.runs if len(engine.runs) > 1 else ():
        items = base.columns.dictionary(tuple(run for run in engine.runs if run != which))
        with_names = explain(items, {item for item in items.causes if item not in allowed})
        other = explain(items, allowed)
        if other.strongest is None or other.strongest in allowed:
            continue
        if any(engine.says(base, other, other.strongest, name) for name in allowed):
            continue
        if other.evidence > with_names.evidence + evidence_margin(best.record.evidence):
            found.append(f'without recording {which} the name would be {other.strongest}')
    return tuple(found)

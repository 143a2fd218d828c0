"""Selection of missing effects by score tests, joint refits and evidence, forward and backward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.progress import OnProgress
from pneunet_ros.diagnosis.fit.hypothesis import Hypothesis
from pneunet_ros.diagnosis.fit.law_errors import LawErrors, MAY_LEAVE, OpenLaws
from pneunet_ros.diagnosis.fit.linearization import Linearization
from pneunet_ros.diagnosis.fit.refit import (
    BASE_ROUNDS,
    linearize_all_runs,
    Refit,
    refit,
    settle,
    split_numbers,
)
from pneunet_ros.diagnosis.scores.lack_of_fit import is_adequate, lack_of_fit_tests, LackOfFit
from pneunet_ros.diagnosis.scores.nonuniform_arm import nonuniform_columns, with_columns
from pneunet_ros.diagnosis.scores.score_test import Candidate, largest_clean_score, score_effects
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings, LEAST_EVIDENCE, SELECTION
import scipy

# No figure of acceptance/sweep.py moves when one of these is halved or doubled.
MOST_EFFECTS = 3  # that may be missing together
SHORTLIST = 5  # candidates to fit, in order of their score
WORTH_A_FIT = 4.0  # chi squared: smallest score of a candidate for a fit
FINALIST_GAIN = 0.25  # smallest gain of a finalist, relative to `SelectionSettings.least_gain`
ABSENT = 3.0  # sigma: an effect below it is removed, and the others are fitted again
LAW_EVIDENCE = 0.02  # share of evidence up to which two laws are indistinguishable
PLAUSIBLE = 4.0  # prior std, from the prior mean to a size
PARTIAL = 0.5  # of the gain of a more probable set: a smaller gain is negligible


@dataclass(frozen=True, slots=True, kw_only=True)
class Added:
    """Evidence and chi-squared gain of a set of effects over another one (names).

    The law errors of the other set are subtracted.
    """

    names: tuple[str, ...]
    evidence: float
    gain: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Record:
    """Result of effects that were fitted jointly.

    dof: number of their parameters; evidence over the base, in log probability; gain in chi
    squared, with prior and volume of the errors; tests: of the remaining misfit; plausible:
    whether no size is far beyond its prior range. outside_prior: sentences on parameters outside
    their prior range. run_chi_squared: of the whitened residuals of each run, including held-out
    runs, and coordinates: their number. log_probability: of the training runs; without: with each
    run left out in turn, both linearized at the fit to all runs; predicted: of the held-out runs
    given the training runs; nonuniform: of the training runs if the arm may bend unevenly, None if
    its curvature is free along the arm. added: gain over the set to which the last effect was
    added.
    """

    names: tuple[str, ...]
    dof: int
    evidence: float
    gain: float
    tests: tuple[LackOfFit, ...]
    adequate: bool
    plausible: bool
    run_chi_squared: tuple[float, ...] = ()
    coordinates: tuple[int, ...] = ()
    outside_prior: tuple[str, ...] = ()
    log_probability: float = 0.0
    without: tuple[float, ...] = ()
    predicted: float = 0.0
    nonuniform: float | None = None
    added: Added | None = None

    def over(self, other: Record) -> Added:
        """Return the gain of the set over another one."""
        if self.added is not None and self.added.names == other.names:
            return self.added
        return Added(
            names=other.names, evidence=self.evidence - other.evidence, gain=self.gain - other.gain
        )

    @property
    def excess(self) -> float:
        """The largest excess in any test over clean data."""
        return max((item.excess for item in self.tests), default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """A joint fit of effects, ready for refinement."""

    record: Record
    refit: Refit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects."""
        return self.record.names


@dataclass(slots=True, kw_only=True)
class Selection:
    """The search over sets of effects, and all sets that were tried.

    allowed: excess allowed for the law of an effect that was subtracted from the recordings.
    """

    linearization: Linearization
    hypotheses: tuple[Hypothesis, ...]
    seed: int
    on_progress: OnProgress
    settings: DiagnosisSettings = DEFAULTS
    allowed: float = 0.0
    tried: dict[frozenset[str], Record] = field(default_factory=dict)
    candidates: dict[frozenset[str], list[Candidate]] = field(default_factory=dict)
    opened: tuple[frozenset[str], LawErrors, OpenLaws] | None = None

    def fit_base(self) -> Trial:
        """Fit the model without any further effect."""
        self.on_progress('the base model', 0, 0)
        training = self.linearization.of_training()
        base = refit(training, (), np.zeros(0), BASE_ROUNDS)
        if base is None:
            raise ModelError(
                'the model has no equilibrium in most of the training recordings',
                reason='no_equilibrium',
            )
        trial = self.test_trial(base, None)
        if trial is None:
            raise ModelError(
                'in a held-out recording the model of the training recordings has no '
                'equilibrium: include its loads and pressures in the training, or omit it',
                reason='no_equilibrium',
            )
        return trial

    def open_laws(self, trial: Trial) -> tuple[LawErrors, OpenLaws]:
        """Return the law errors of a trial, and its linear problem with them.

        Only the last result is cached, because it is large.
        """
        key = frozenset(trial.names)
        if self.opened is None or self.opened[0] != key:
            fit = trial.refit
            errors = LawErrors.of(fit.linearization, fit)
            problem = OpenLaws.of(fit.gaussian, fit.linearization.blocks, errors)
            self.opened = key, errors, problem
        return self.opened[1:]

    def test_trial(
        self, trial: Refit, base: Trial | None, known: Trial | None = None
    ) -> Trial | None:
        """Test a joint fit on all recordings, and store the result.

        known: the set to which an effect was added. None if the arm has no shape in a held-out
        recording with that effect.
        """
        all_runs = self.linearization.at(trial.point)
        at_fit = linearize_all_runs(all_runs, trial)
        if at_fit is None:
            return None
        nonuniform = nonuniform_columns(trial.linearization)
        gaussian = at_fit[1]
        tests = lack_of_fit_tests(all_runs, gaussian, self.seed)
        reference = trial if base is None else base.refit
        law_excess = 0.0 if base is None else MAY_LEAVE * base.record.excess
        record = Record(
            names=trial.names,
            dof=trial.numbers.size,
            evidence=trial.gaussian.evidence() - reference.gaussian.evidence(),
            gain=2.0 * (reference.cost - trial.cost),
            tests=tests,
            adequate=is_adequate(tests, max(self.allowed, law_excess)),
            plausible=is_plausible(trial, PLAUSIBLE),
            run_chi_squared=gaussian.squares,
            coordinates=tuple(2 * int(run.seen.sum()) for run in all_runs.runs),
            outside_prior=parameters_outside_prior(trial),
            log_probability=trial.gaussian.log_probability(),
            without=tuple(
                trial.gaussian.without(run).log_probability() for run in range(all_runs.training)
            ),
            predicted=(
                gaussian.log_probability()
                - gaussian.subset(range(all_runs.training)).log_probability()
            ),
            nonuniform=(
                with_columns(trial.gaussian, nonuniform).log_probability() if nonuniform else None
            ),
            added=None if known is None or not known.names else self.added(trial, known),
        )
        self.tried[frozenset(record.names)] = record
        return Trial(record=record, refit=trial)

    def added(self, trial: Refit, known: Trial) -> Added:
        """Return the gain of a fit over a set, beyond the law errors of that set."""
        errors, before = self.open_laws(known)
        after = OpenLaws.of(trial.gaussian, trial.linearization.blocks, errors)
        return Added(
            names=known.names,
            evidence=after.gaussian.evidence() - before.gaussian.evidence(),
            gain=2.0 * (before.cost - after.cost),
        )

    def select_forward(self, base: Trial) -> Trial:
        """Add effects one by one while the fit improves; return the best set."""
        best = base
        for count in range(MOST_EFFECTS):
            if best.record.adequate and self.significant_candidate(best) is None:
                return best
            better = self.add_effect(base, best, thorough=count == 0)
            if better is None or (count and not is_worth_adding(best, better)):
                return best
            best = self.eliminate_backward(base, better)
            if not best.names:
                return best
        return best

    def fit_rivals(self, base: Trial, best: Trial) -> Trial:
        """Replace the strongest effect of a set by rivals of similar score; return the best fit.

        The other effects are kept, because each was chosen among its own rivals.
        """
        if not best.names:
            return best
        candidates = self.score_candidates(base)
        scores = dict.fromkeys(best.names, 0.0) | {item.name: item.gain for item in candidates}
        strongest = max(best.names, key=scores.__getitem__)
        least = scores[strongest] - 2.0 * LEAST_EVIDENCE
        pairs = zip(best.refit.hypotheses, best.refit.effects, strict=True)
        rest = [(item, effect) for item, effect in pairs if item.name != strongest]
        numbers = [item.numbers(effect) for item, effect in rest]
        sets = [best]
        for item in candidates:
            hypotheses = (item.hypothesis, *(other for other, _ in rest))
            names = frozenset(other.name for other in hypotheses)
            if item.gain < least or names in self.tried or len(names) < len(hypotheses):
                continue
            fit = refit(
                base.refit.linearization, hypotheses, np.concatenate([item.start, *numbers])
            )
            rival = None if fit is None else self.test_trial(fit, base)
            if rival is not None:
                sets.append(rival)
        return choose_best(base, sets) or best

    def score_candidates(self, trial: Trial) -> list[Candidate]:
        """Return the effects that may be added to a trial, scored once."""
        key = frozenset(trial.names)
        if key not in self.candidates:
            names = ' + '.join(trial.names) or 'the base model'
            self.on_progress(f'score tests on top of {names}', 0, 0)
            problem = self.open_laws(trial)[1]
            self.candidates[key] = score_effects(trial.refit, self.hypotheses, problem)
        return self.candidates[key]

    def significant_candidate(self, trial: Trial) -> Candidate | None:
        """Return the effect with the best score in addition to these.

        None if noise, or the law errors of these effects, would explain the score.
        """
        candidates = self.score_candidates(trial)
        if not candidates:
            return None
        noise = largest_clean_score(self.open_laws(trial)[1].gaussian, candidates, self.seed)
        needed = max(SELECTION.least_gain, noise)
        return candidates[0] if candidates[0].gain > needed else None

    def add_effect(self, base: Trial, trial: Trial, *, thorough: bool) -> Trial | None:
        """Return the best set with one more effect; None if none is good enough.

        thorough: if no set is adequate, fit all likely effects, because small steps may mislead.
        """
        candidates = self.score_candidates(trial)
        largest = candidates[0].gain if candidates else 0.0
        clear = sum(item.gain >= SELECTION.near * largest for item in candidates)
        likely = sum(item.gain > WORTH_A_FIT for item in candidates)
        stops = [clear, max(clear, SHORTLIST), *([likely] if thorough else [])]
        best: Trial | None = None
        done = 0
        for stop in stops:
            finalists = self.fit_finalists(base, trial, candidates[done:stop])
            best = choose_best(trial, [*([] if best is None else [best]), *finalists])
            done = stop
            if best is not None and best.record.adequate:
                break
        return best

    def fit_finalists(
        self, base: Trial, trial: Trial, candidates: Sequence[Candidate]
    ) -> list[Trial]:
        """Refit once with each candidate, then fit the best candidates to convergence.

        A strong effect may not have converged after one refit; its score estimates the gain.
        """
        known, first, gains = trial.refit, [], []
        for place, item in enumerate(candidates):
            hypotheses = (*known.hypotheses, item.hypothesis)
            self.on_progress(
                ' + '.join(effect.name for effect in hypotheses), place, len(candidates)
            )
            numbers = np.concatenate([known.numbers, item.start])
            fit = refit(known.linearization, hypotheses, numbers, 1)
            if fit is not None:
                first.append(fit)
                gains.append(max(known.cost - fit.cost, 0.5 * item.gain))
        needed = max(
            SELECTION.near * max(gains, default=0.0), FINALIST_GAIN * SELECTION.least_gain
        )
        order = np.argsort([-gain for gain in gains])[: SELECTION.finalists].tolist()
        chosen = [first[place] for place in order if gains[place] >= needed]
        del first  # linearizations are large
        finalists = []
        for place, fit in enumerate(chosen):
            self.on_progress('until settled: ' + ' + '.join(fit.names), place, len(chosen))
            settled = settle(fit)
            finalist = self.test_trial(settled, base, known=trial)
            if finalist is not None:
                finalists.append(finalist)
        return finalists

    def eliminate_backward(self, base: Trial, trial: Trial) -> Trial:
        """Remove effects that are not needed to predict the recordings.

        The last effect is also removed if its size does not differ significantly from zero.
        """
        while len(trial.names) > 1:
            least = trial.record.evidence - LEAST_EVIDENCE
            without = [self.leave_out(base, trial, name, least) for name in trial.names]
            kept = [item for item in without if item is not None]
            if not kept:
                return trial
            trial = max(kept, key=lambda item: item.record.evidence)
        return base if is_absent(trial.refit, trial.names[0], ABSENT) else trial

    def leave_out(self, base: Trial, trial: Trial, name: str, least: float) -> Trial | None:
        """Return the set without one of its effects; None if its evidence is insufficient."""
        pairs = zip(trial.refit.hypotheses, trial.refit.effects, strict=True)
        rest = [(item, effect) for item, effect in pairs if item.name != name]
        known = self.tried.get(frozenset(item.name for item, _ in rest))
        absent = is_absent(trial.refit, name, ABSENT)
        if known is not None and known.evidence < least and not absent:
            return None
        hypotheses = tuple(item for item, _ in rest)
        numbers = np.concatenate([item.numbers(effect) for item, effect in rest])
        fit = refit(trial.refit.linearization, hypotheses, numbers)
        if fit is None:
            return None
        smaller = self.test_trial(fit, base)
        return smaller if smaller is not None and smaller.record.evidence >= least else None


def choose_best(trial: Trial, extended: Sequence[Trial]) -> Trial | None:
    """Return the most probable set that is better than the set it extends.

    Adequate and plausible sets come first, unless a more probable one fits far better and could
    become adequate with one more effect. Among sets of similar evidence, the one with fewest
    parameters is chosen.
    """
    over = {item: item.record.over(trial.record) for item in extended}
    better = [
        item
        for item, added in over.items()
        if added.evidence > LEAST_EVIDENCE and added.gain > SELECTION.least_gain
    ]
    plausible = [item for item in better if item.record.plausible]
    if plausible:
        top = max(plausible, key=lambda item: over[item].evidence)
        least = PARTIAL * over[top].gain
        better = [item for item in better if over[item].gain >= least]
    plausible = [item for item in better if item.record.plausible]
    adequate = [item for item in better if item.record.adequate]
    both = [item for item in plausible if item.record.adequate]
    chosen = both or adequate or plausible or better
    most = max((over[item].evidence for item in chosen), default=0.0)
    least = most - evidence_margin(most)
    alike = [item for item in chosen if over[item].evidence >= least]

    def rank(item: Trial) -> tuple[bool, int, float]:
        return bool(item.record.outside_prior), item.record.dof, -over[item].evidence

    return min(alike, key=rank, default=None)


def is_worth_adding(trial: Trial, better: Trial) -> bool:
    """Whether one more effect explains all or most of the remaining misfit."""
    record = better.record
    return record.adequate or 2.0 * record.excess < trial.record.excess


def is_absent(fit: Refit, name: str, most: float) -> bool:
    """Whether the sizes of an effect are within this many standard errors of zero.

    Tested jointly, with correlations. Such an effect explains nothing; it only helped the fit to
    leave a poor local minimum.
    """
    first = 0
    for item, numbers in zip(
        fit.hypotheses, split_numbers(fit.hypotheses, fit.numbers), strict=True
    ):
        if item.name == name:
            sizes = numbers[list(item.sizes)]
            places = first + np.array(item.sizes)
            covariance = fit.covariance[np.ix_(places, places)]
            far = float(sizes @ np.linalg.solve(covariance, sizes))
            return far <= float(scipy.stats.chi2.isf(2.0 * scipy.stats.norm.sf(most), sizes.size))
        first += item.size
    return False


def is_plausible(fit: Refit, most: float) -> bool:
    """Whether all effect sizes are within this many deviations of their prior means."""
    parts = split_numbers(fit.hypotheses, fit.numbers)
    return all(
        bool(np.all(np.abs(numbers - item.mean) <= most * item.std))
        for item, numbers in zip(fit.hypotheses, parts, strict=True)
    )


def parameters_outside_prior(fit: Refit) -> tuple[str, ...]:
    """Return a note on every parameter outside its prior range by two standard errors.

    The standard errors include the law error.
    """
    stds = np.split(np.sqrt(np.diag(fit.covariance)), np.cumsum([i.size for i in fit.hypotheses]))
    parts = split_numbers(fit.hypotheses, fit.numbers)
    return tuple(
        f'{item.name}.{coordinate.parameter} = {coordinate.value(float(number)):.3g} '
        f'{coordinate.unit} lies outside its prior range'
        for item, numbers, errors in zip(fit.hypotheses, parts, stds, strict=False)
        for coordinate, number, error in zip(item.coordinates, numbers, errors, strict=True)
        if abs(number - coordinate.mean)
        - 2.0 * np.hypot(error, 0.0 if coordinate.shape else item.kind.law_error * number)
        > (coordinate.std if coordinate.shape else coordinate.end)
    )


def evidence_margin(evidence: float) -> float:
    """Return the smallest significant difference of evidence, given that no law is exact."""
    return max(LEAST_EVIDENCE, LAW_EVIDENCE * evidence)

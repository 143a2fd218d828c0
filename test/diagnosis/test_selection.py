"""The search over sets of effects: scripted fits in, the set that is chosen out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from pneunet_ros.diagnosis import selection
from pneunet_ros.diagnosis.scores.lack_of_fit import is_adequate, LackOfFit
from pneunet_ros.diagnosis.scores.score_test import Candidate
from pneunet_ros.diagnosis.selection import (
    choose_best,
    evidence_margin,
    is_absent,
    is_worth_adding,
    Record,
    Selection,
    Trial,
)
from pneunet_ros.effects.pressure_lag import PressureLag
import pytest
from support.lab_designs import asked

BASE = 1000.0  # excess that the base model leaves


def lack(excess: float) -> LackOfFit:
    """Return a test of ten fields that leave so much."""
    return LackOfFit(name='any', statistic=10.0 + excess, dof=10, mean=10.0, std=20**0.5)


def trial(
    names: str, evidence: float, excess: float = 0.0, *, dof: int = 0, plausible: bool = True
) -> Trial:
    """Return a set of effects after its fit; its gain in chi squared is what it takes away."""
    tests = (lack(excess),)
    record = Record(
        names=tuple(names.split()),
        dof=dof or len(names.split()),
        evidence=evidence,
        gain=BASE - excess,
        tests=tests,
        adequate=is_adequate(tests),
        plausible=plausible,
    )
    nothing: Any = fit_of()
    return Trial(record=record, refit=nothing)


class Scripted(Selection):
    """The search where the fit of every set is known; candidates score what their fit gains."""

    def __init__(self, *trials: Trial) -> None:
        nothing: Any = None
        super().__init__(linearization=nothing, hypotheses=(), seed=0, on_progress=nothing)
        self.sets = {frozenset(item.names): item for item in trials}
        self.fitted: list[str] = []

    def score_candidates(self, trial: Trial) -> list[Candidate]:
        known = frozenset(trial.names)
        names = [name for item in self.sets if item > known for name in item - known
                 if item == known | {name}]  # fmt: skip
        gains = [self.sets[known | {name}].record.gain - trial.record.gain for name in names]
        order = np.argsort([-gain for gain in gains])
        return [candidate(names[place], gains[place]) for place in order]

    def fit_finalists(
        self, base: Trial, trial: Trial, candidates: Sequence[Candidate]
    ) -> list[Trial]:
        self.fitted += [item.name for item in candidates]
        return [self.sets[frozenset((*trial.names, item.name))] for item in candidates]

    def leave_out(self, base: Trial, trial: Trial, name: str, least: float) -> Trial | None:
        smaller = self.sets.get(frozenset(trial.names) - {name})
        return smaller if smaller and smaller.record.evidence >= least else None

    def chosen(self) -> tuple[str, ...]:
        """Return the names that the search ends with, from the empty set on."""
        return self.select_forward(self.sets[frozenset()]).names


def candidate(name: str, gain: float) -> Candidate:
    """Return an effect of this score."""
    return Candidate(
        hypothesis=asked(name), which=0, tried=np.ones(1), gain=gain, start=np.ones(1),
        information=1.0, direction=(),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def no_chance(monkeypatch):
    """Let clean data have no score, so that the least gain decides."""
    monkeypatch.setattr(selection, 'largest_clean_score', lambda *rest: 0.0)


def test_where_nothing_is_left_and_nothing_scores_nothing_is_fitted():
    search = Scripted(trial('', 0.0, 0.0))
    assert search.chosen() == ()
    assert search.fitted == []


def test_one_effect_that_explains_all_is_enough():
    search = Scripted(trial('', 0.0, BASE), trial('gravity', 400.0), trial('creep', 100.0, 700.0))
    assert search.chosen() == ('gravity',)


def test_where_no_effect_explains_much_the_best_is_still_returned_for_the_notes():
    search = Scripted(trial('', 0.0, BASE), trial('creep', 100.0, 700.0))
    assert search.chosen() == ('creep',)
    assert Scripted(trial('', 0.0, BASE), trial('creep', 2.0, 700.0)).chosen() == ()


def test_two_effects_are_added_one_by_one(monkeypatch):
    search = Scripted(
        trial('', 0.0, BASE),
        trial('gravity', 300.0, 400.0),
        trial('creep', 200.0, 600.0),
        trial('gravity creep', 480.0),
    )
    assert search.chosen() == ('gravity', 'creep')
    monkeypatch.setattr(selection, 'MOST_EFFECTS', 1)
    assert Scripted(*search.sets.values()).chosen() == ('gravity',)


def test_the_first_effect_is_left_out_where_the_second_makes_it_needless():
    search = Scripted(
        trial('', 0.0, BASE),
        trial('gravity', 300.0, 300.0),
        trial('creep', 299.0, 310.0),
        trial('gravity creep', 301.0, 100.0),
    )
    # gravity and creep add little evidence to gravity: not better by what counts.
    assert search.chosen() == ('gravity',)
    stronger = Scripted(
        trial('', 0.0, BASE),
        trial('gravity', 300.0, 300.0),
        trial('creep', 399.0, 310.0),
        trial('gravity creep', 401.0, 100.0),
    )
    stronger.candidates.clear()
    assert stronger.eliminate_backward(
        stronger.sets[frozenset()], stronger.sets[frozenset({'gravity', 'creep'})]
    ).names == ('creep',)


def test_a_second_effect_that_only_mends_the_law_of_the_first_is_not_added():
    first, second = trial('gravity', 400.0, 100.0), trial('gravity creep', 420.0, 80.0)
    assert not is_worth_adding(first, second)
    assert is_worth_adding(first, trial('gravity creep', 420.0, 40.0))
    assert is_worth_adding(first, trial('gravity creep', 420.0, 0.0))
    assert Scripted(trial('', 0.0, BASE), first, second).chosen() == ('gravity',)


def test_adequate_and_plausible_sets_come_first_and_small_ones_of_like_evidence():
    base = trial('', 0.0, BASE)
    wild = trial('gravity', 500.0, plausible=False)
    left = trial('creep', 450.0, 300.0)
    good = trial('hysteresis', 400.0)
    assert choose_best(base, [wild, left, good]) is good
    assert choose_best(base, [wild, left]) is wild
    assert choose_best(base, [left]) is left
    # What explains less than half of it is not preferred because little was there to be left.
    half = replace(good, record=replace(good.record, evidence=100.0, gain=0.4 * left.record.gain))
    assert choose_best(base, [half]) is half
    assert choose_best(base, [left, half]) is left
    assert choose_best(base, [trial('creep', 2.0, 300.0)]) is None
    small = trial('load_offset', 395.0)
    large = trial('softening', 400.0, dof=2)
    assert choose_best(base, [large, small]) is small
    assert choose_best(base, [large, trial('load_offset', 380.0)]) is large


def test_what_evidence_counts():
    assert evidence_margin(10.0) == 3.0
    assert evidence_margin(5000.0) == pytest.approx(100.0)


def test_adequate_is_every_test_at_a_share_of_the_level_or_within_what_a_law_may_miss():
    assert not is_adequate(())
    assert is_adequate((lack(0.0), lack(5.0)))
    assert not is_adequate((lack(0.0), lack(100.0)))
    assert is_adequate((lack(0.0), lack(100.0)), allowed=101.0)


def fit_of(**numbers: list[float]) -> Any:
    """Return the numbers of effects that were fitted, each with a standard error of 0.1."""
    values = np.concatenate([np.zeros(0), *numbers.values()])
    return SimpleNamespace(
        gaussian=None,
        hypotheses=tuple(asked(name) for name in numbers),
        numbers=values,
        covariance=0.01 * np.eye(values.size),
    )


def test_an_effect_without_a_size_is_absent():
    both = fit_of(creep=[0.5, 2.0], pressure_lag=[0.0])
    assert is_absent(both, 'pressure_lag', 1.0)
    assert not is_absent(both, 'creep', 3.0)
    # A time constant is no size: it may be anything where there is no amplitude.
    assert is_absent(fit_of(creep=[-0.09, 2.0]), 'creep', 1.0)
    assert not is_absent(fit_of(gravity=[0.0, 0.16]), 'gravity', 1.0)


def test_sizes_that_are_known_together_alone_are_not_absent():
    both = fit_of(creep=[0.5, 2.0], gravity=[0.2, 0.2])
    assert is_absent(both, 'gravity', 3.0)
    both.covariance[2:, 2:] = 0.01 * np.array([[1.0, -0.9], [-0.9, 1.0]])
    assert not is_absent(both, 'gravity', 3.0)


def test_a_single_effect_without_a_size_is_no_answer():
    base, found = trial('', 0.0, BASE), trial('creep', 900.0)
    settings = Scripted()
    assert settings.eliminate_backward(base, found) is found
    faint = replace(found, refit=fit_of(creep=[0.2, 2.0]))
    assert settings.eliminate_backward(base, faint) is base


def test_what_led_out_of_a_poor_minimum_is_left_out_however_poor_the_rest_was(monkeypatch):
    whole, smaller = trial('creep pressure_lag', 900.0), trial('creep', 899.0)
    monkeypatch.setattr(selection, 'refit', lambda *rest: smaller.refit)
    monkeypatch.setattr(Selection, 'test_trial', lambda *rest: smaller)
    for lag, left in ((0.0, smaller), (0.5, None)):
        fit = fit_of(creep=[0.5, 2.0], pressure_lag=[lag])
        fit.effects = (asked('creep').effect(np.array([0.5, 2.0])), PressureLag())
        fit.linearization = None
        search = Scripted()
        search.tried[frozenset({'creep'})] = trial('creep', 100.0).record
        found = Selection.leave_out(
            search, whole, Trial(record=whole.record, refit=fit), 'pressure_lag', 897.0
        )
        assert found is left


def test_the_strongest_of_two_effects_is_held_against_what_scores_as_well(monkeypatch):
    both = trial('force_misalignment gravity', 85.0, 20.0)
    both.refit.hypotheses = (asked('force_misalignment'), asked('gravity'))
    both.refit.effects = tuple(
        item.effect(np.full(item.size, 0.01)) for item in both.refit.hypotheses
    )
    search = Scripted(
        trial('', 0.0, 300.0),
        trial('force_misalignment', 53.0, 100.0),
        trial('camera_rotation', 52.0, 103.0),  # scores as well
        trial('gravity', 20.0, 240.0),
        trial('load_offset', 30.0, 200.0),  # does not
        both,
        trial('camera_rotation gravity', 89.0, 10.0),
    )
    for item in search.sets.values():
        item.refit.linearization = None
    fitted: list[list[str]] = []

    def refitted(_: Any, hypotheses: Sequence[Any], *rest: Any) -> frozenset[str]:
        fitted.append([item.name for item in hypotheses])
        return frozenset(fitted[-1])

    monkeypatch.setattr(selection, 'refit', refitted)
    monkeypatch.setattr(Selection, 'test_trial', lambda self, names, *rest: self.sets[names])
    search.tried[frozenset(both.names)] = both.record
    base = search.sets[frozenset()]
    assert search.fit_rivals(base, both).names == ('camera_rotation', 'gravity')
    assert fitted == [['camera_rotation', 'gravity']]
    worse = trial('camera_rotation gravity', 84.0, 25.0)
    search.sets[frozenset(worse.names)] = worse
    assert search.fit_rivals(base, both) is both
    search.sets[frozenset(worse.names)] = None
    assert search.fit_rivals(base, both) is both
    assert search.fit_rivals(base, base) is base


def test_an_effect_that_has_not_arrived_after_one_refit_is_fitted_until_settled(monkeypatch):
    costs = {'gravity': 990.0, 'camera_rotation': 740.0, 'creep': 980.0}
    scores = {'gravity': 1100.0, 'camera_rotation': 490.0, 'creep': 10.0}
    monkeypatch.setattr(
        selection,
        'refit',
        lambda _, hypotheses, *rest: SimpleNamespace(
            cost=costs[hypotheses[-1].name], names=(hypotheses[-1].name,)
        ),
    )
    monkeypatch.setattr(selection, 'settle', lambda fit, *rest: fit)
    monkeypatch.setattr(Selection, 'test_trial', lambda self, fit, base, known: fit.names)
    search, known = Scripted(), trial('', 0.0, BASE)
    search.on_progress = lambda *rest: None
    known.refit.cost, known.refit.hypotheses = 1000.0, ()
    known.refit.numbers, known.refit.linearization = np.zeros(0), None
    candidates = [candidate(name, score) for name, score in scores.items()]
    found = Selection.fit_finalists(search, known, known, candidates)
    assert found == [('gravity',), ('camera_rotation',)]
    # With one of them a held-out recording has no shape: it is no answer, and the other may be.
    monkeypatch.setattr(
        Selection,
        'test_trial',
        lambda self, fit, base, known: None if fit.names == ('gravity',) else fit.names,
    )
    found = Selection.fit_finalists(search, known, known, candidates)
    assert found == [('camera_rotation',)]

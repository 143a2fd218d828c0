"""The search over sets of effects as plain logic: what fits and scores give is invented.

A world says of every set of effects what it would cost, explain and leave; the search is real.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
from pneunet_ros.core.errors import ModelError
from pneunet_ros.diagnosis import selection
import pytest

CLEAN, DIRTY = 0.5, 1e-9  # p-values of what is left


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a set of effects gives: gain and evidence over the base, what is left, its sizes."""

    gain: float = 0.0
    evidence: float = 0.0
    excess: float = 0.0
    size: float = 1.0  # of every effect, in deviations of its prior

    @property
    def test(self) -> SimpleNamespace:
        return SimpleNamespace(p_value=DIRTY if self.excess else CLEAN, excess=self.excess)


def explains(gain, **given):
    """Return an outcome of which the evidence goes with the gain."""
    return Outcome(**{'gain': gain, 'evidence': 0.5 * gain - 2.0, **given})


@dataclass(kw_only=True)
class World:
    """Outcomes by set of effects, written 'a b'; scores by the set they are on top of.

    A set that stands nowhere has no fit. numbers: how many an effect has, where not one.
    """

    outcomes: Mapping[str, Outcome]
    scores: Mapping[str, Mapping[str, float]]
    numbers: Mapping[str, int] = field(default_factory=dict)
    chance: float = 9.0  # what the largest score reaches in clean data
    fits: list[str] = field(default_factory=list)
    settled: list[str] = field(default_factory=list)

    def hypothesis(self, name):
        count = self.numbers.get(name, 1)
        return SimpleNamespace(
            name=name,
            size=count,
            mean=np.zeros(count),
            std=np.ones(count),
            numbers=lambda effect: np.ones(count),
        )

    def refit(self, design, hypotheses, numbers, rounds, *settings):
        names = tuple(item.name for item in hypotheses)
        assert len(numbers) == sum(item.size for item in hypotheses)
        self.fits.append(' '.join(sorted(names)))
        outcome = self.outcomes.get(self.fits[-1])
        if outcome is None:
            return None
        return SimpleNamespace(
            names=names,
            hypotheses=hypotheses,
            effects=names,
            numbers=outcome.size * np.ones(len(numbers)),
            cost=1000.0 - 0.5 * outcome.gain,
            outcome=outcome,
            **{DESIGN: design, LINEAR: SimpleNamespace(evidence=lambda: outcome.evidence)},
        )

    def settle(self, fit, *settings):
        self.settled.append(' '.join(sorted(fit.names)))
        return fit

    def score(self, fit, hypotheses, *settings):
        scores = self.scores.get(' '.join(sorted(fit.names)), {})
        candidates = [
            SimpleNamespace(hypothesis=item, gain=scores[item.name], start=np.ones(item.size))
            for item in hypotheses
            if item.name in scores
        ]
        return sorted(candidates, key=lambda item: -item.gain)


# The seam: what the search calls, by the names that it has there.
DESIGN, LINEAR = 'design', 'linear'


def search(world, monkeypatch):
    """Search a world; returns the base and the best set."""
    replaced = {
        'refit': world.refit,
        'finished': world.settle,
        'score_effects': world.score,
        'clean_score': lambda *_: world.chance,
        'groups_of': lambda fit, *_: (fit.outcome.test,),
    }
    for name, stub in replaced.items():
        monkeypatch.setattr(selection, name, stub)
    monkeypatch.setattr(selection.Selection, 'wholly', lambda self, fit: (fit, None))
    names = sorted({name for scores in world.scores.values() for name in scores})
    searched = selection.Selection(
        design=SimpleNamespace(of_training=lambda: None),
        hypotheses=tuple(world.hypothesis(name) for name in names),
        seed=0,
        each=lambda *_: None,
    )
    base = searched.base()
    return base, searched.forward(base)


@pytest.fixture
def best(monkeypatch):
    """Give a function that searches a world and returns the names found, in order."""

    def run(world):
        return ' '.join(sorted(search(world, monkeypatch)[1].names))

    return run


def test_where_nothing_is_missing_nothing_is_fitted(best):
    world = World(outcomes={'': Outcome()}, scores={'': {'a': 15.0, 'b': 2.0}})
    assert best(world) == ''
    assert world.fits == ['']


@pytest.mark.parametrize(
    ('score', 'chance', 'named'),
    [(15.9, 9.0, ''), (16.1, 9.0, 'a'), (24.0, 25.0, ''), (26.0, 25.0, 'a')],
)
def test_a_clear_score_counts_also_where_the_model_is_adequate(best, score, chance, named):
    outcomes = {'': Outcome(), 'a': explains(40.0)}
    assert best(World(outcomes=outcomes, scores={'': {'a': score}}, chance=chance)) == named


def test_a_base_without_shapes_is_an_error(best):
    with pytest.raises(ModelError, match='no shape'):
        best(World(outcomes={}, scores={}))


def test_one_effect_that_explains_all_is_the_answer(best):
    world = World(
        outcomes={
            '': Outcome(excess=900.0),
            'a': explains(900.0),
            'b': explains(400.0, excess=400),
        },
        scores={'': {'a': 800.0, 'b': 500.0}},
    )
    assert best(world) == 'a'
    assert world.settled == ['a', 'b']  # one round of both, and both to the end
    assert 'a b' not in world.fits


def test_a_gain_without_evidence_and_evidence_without_gain_do_not_count(best):
    for outcome in (Outcome(gain=40.0, evidence=2.9), Outcome(gain=15.0, evidence=9.0)):
        world = World(outcomes={'': Outcome(excess=50.0), 'a': outcome}, scores={'': {'a': 40.0}})
        assert best(world) == ''


def test_a_fit_that_fails_is_passed_over(best):
    outcomes = {'': Outcome(excess=900.0), 'b': explains(800.0)}
    assert best(World(outcomes=outcomes, scores={'': {'a': 900.0, 'b': 850.0}})) == 'b'


def test_two_are_fitted_to_the_end_of_those_that_come_near_the_best(best):
    gains = {'a': 500.0, 'b': 600.0, 'c': 400.0, 'd': 100.0}
    outcomes = {name: explains(gain) for name, gain in gains.items()}
    world = World(outcomes={'': Outcome(excess=900.0), **outcomes}, scores={'': gains})
    assert best(world) == 'b'
    assert world.settled == ['b', 'a']
    assert world.fits[1:] == ['b', 'a', 'c']  # d is not near: not begun as another is adequate


def test_where_no_likely_one_is_enough_all_are_fitted(best):
    """Small steps may mislead: the one with the smallest score is it."""
    scores = {name: 900.0 - place for place, name in enumerate('abcde')} | {'z': 5.0, 'y': 3.0}
    wrong = {name: explains(300.0, excess=300.0) for name in 'abcde'}
    outcomes = {'': Outcome(excess=900.0), **wrong, 'z': explains(880.0)}
    world = World(outcomes=outcomes, scores={'': scores})
    assert best(world) == 'z'
    assert 'y' not in world.fits  # of a score that chance has


def test_beside_an_effect_only_the_shortlist_is_fitted(best):
    further = {name: 100.0 - place for place, name in enumerate('bcdef')} | {'z': 20.0}
    world = World(
        outcomes={
            '': Outcome(excess=900.0),
            'a': explains(500.0, excess=400.0),
            'a z': explains(900.0),
        },
        scores={'': {'a': 500.0}, 'a': further},
    )
    assert best(world) == 'a'
    assert set(world.fits) == {'', 'a', *(f'a {name}' for name in 'bcdef')}


def test_two_effects_are_found_one_after_the_other(best):
    world = World(
        outcomes={
            '': Outcome(excess=900.0),
            'a': explains(500.0, excess=400.0),
            'b': explains(300.0, excess=600.0),
            'a b': explains(900.0),
        },
        scores={'': {'a': 500.0, 'b': 300.0}, 'a': {'b': 380.0}, 'b': {'a': 500.0}},
    )
    assert best(world) == 'a b'


def test_what_stood_in_for_two_is_left_out_again(best):
    world = World(
        outcomes={
            '': Outcome(excess=900.0),
            'x': explains(600.0, excess=300.0),
            'a x': explains(700.0, excess=140.0),
            'a': explains(699.0, excess=140.0),
            'a b': explains(900.0),
        },
        scores={'': {'x': 600.0}, 'x': {'a': 250.0}, 'a': {'b': 190.0}},
    )
    assert best(world) == 'a b'
    assert 'b x' not in world.fits


@pytest.mark.parametrize(
    ('gain', 'excess', 'named'),
    [
        (1015.0, 0.0, 'a'),  # adequate, but 1.5 % of what the first explains
        (1025.0, 0.0, 'a b'),
        (1100.0, 60.0, 'a'),  # a tenth more, but most of what was left still is
        (1017.0, 40.0, 'a b'),  # less than half of it
    ],
)
def test_a_second_effect_is_no_correction_of_the_law_of_the_first(best, gain, excess, named):
    world = World(
        outcomes={
            '': Outcome(excess=300.0),
            'a': explains(1000.0, excess=100.0),
            'a b': explains(gain, excess=excess),
        },
        scores={'': {'a': 1000.0}, 'a': {'b': 50.0}},
    )
    if gain == 1015.0:
        world.outcomes['a'] = explains(1000.0, excess=0.0)
    assert best(world) == named


def test_what_a_law_may_miss_is_no_lack(best):
    """A fifth of what the base leaves."""
    for excess, named in ((150.0, 'a'), (250.0, 'a b')):
        world = World(
            outcomes={
                '': Outcome(excess=1000.0),
                'a': explains(800.0, excess=excess),
                'a b': explains(1000.0),
            },
            scores={'': {'a': 800.0}, 'a': {'b': 10.0}},
        )
        assert best(world) == named


@pytest.mark.parametrize(('left', 'named'), [(190.0, 'a b c'), (250.0, 'a b')])
def test_no_third_effect_where_two_leave_much(best, left, named):
    world = World(
        outcomes={
            '': Outcome(excess=1000.0),
            'a': explains(1000.0, excess=600.0),
            'a b': explains(1500.0, excess=left),
            'a b c': explains(1800.0),
            'a b c d': explains(2000.0),
        },
        scores={'': {'a': 900.0}, 'a': {'b': 400.0}, 'a b': {'c': 200.0}, 'a b c': {'d': 90.0}},
    )
    assert best(world) == named


def test_three_are_the_most(best):
    sets = ['', 'a', 'a b', 'a b c', 'a b c d']
    left = [1000.0, 450.0, 190.0, 80.0, 0.0]
    world = World(
        outcomes={
            key: Outcome(gain=900.0 * place, evidence=400.0 * place, excess=excess)
            for place, (key, excess) in enumerate(zip(sets, left, strict=True))
        },
        scores={key: {name: 900.0} for key, name in zip(sets, 'abcd', strict=False)},
    )
    assert best(world) == 'a b c'
    assert 'a b c d' not in world.fits


def test_sizes_beyond_belief_come_last(best):
    outcomes = {
        '': Outcome(excess=900.0),
        'a': explains(900.0, size=4.1),
        'b': explains(500.0, size=3.9),
    }
    scores = {'': {'a': 900.0, 'b': 800.0}}
    assert best(World(outcomes=outcomes, scores=scores)) == 'b'
    del outcomes['b']
    assert best(World(outcomes=outcomes, scores=scores)) == 'a'


def test_of_those_that_explain_alike_the_simpler_one(best):
    """Two per cent of the evidence do not tell two laws apart."""
    for gain, named in ((1005.0, 'b'), (1100.0, 'a')):
        world = World(
            outcomes={'': Outcome(excess=900.0), 'a': explains(gain), 'b': explains(1000.0)},
            scores={'': {'a': 900.0, 'b': 890.0}},
            numbers={'a': 2},
        )
        assert best(world) == named


def test_everything_that_was_tested_is_remembered(monkeypatch):
    world = World(
        outcomes={'': Outcome(excess=900.0), 'a': explains(900.0), 'b': explains(800.0, size=9.0)},
        scores={'': {'a': 800.0, 'b': 790.0}},
    )
    base, found = search(world, monkeypatch)
    assert (base.names, found.names) == ((), ('a',))
    record = found.record
    assert (record.gain, record.evidence, record.dof) == (900.0, 448.0, 1)
    assert record.adequate
    assert record.plausible
    assert not base.record.adequate

"""The trials of `explore` and of odd arms: what is hidden, and how an answer is counted."""

from __future__ import annotations

from blind.hidden import HIDEABLE
from explore_trials import hidden_arm, verdict
from outlier_arms import fleet, MOVED, tried
import pytest


def test_seeds_go_through_all_effects_and_hide_the_same_again():
    names = [hidden_arm(seed)[0] for seed in range(len(HIDEABLE))]
    assert sorted(names) == sorted(HIDEABLE)
    name, scenario = hidden_arm(5)
    assert [effect.name for effect in scenario.effects if effect.name == name] == [name]
    assert repr(hidden_arm(5)[1].effects) == repr(scenario.effects)


@pytest.mark.parametrize(
    ('answer', 'effects', 'said'),
    [
        ('named', ['creep'], 'right'),
        ('named', ['creep', 'gravity'], 'with another'),
        ('named', ['gravity'], 'wrong'),
        ('unknown', [], 'unknown'),
    ],
)
def test_an_answer_is_right_only_alone(answer, effects, said):
    rounds = [{'answer': answer, 'effects': effects}]
    assert verdict({'rounds': rounds, 'failed': '', 'hidden': 'creep'}) == said
    assert verdict({'rounds': rounds, 'failed': 'no shape', 'hidden': 'creep'}) == 'failed'


def test_a_moved_arm_is_counted():
    assert str(MOVED) in fleet(1, 12, 0.0)
    row = tried(27, 30.0, 1)
    assert (row['right'], row['wrong']) == (1, 0)

"""The marginal likelihood of the trial engine: what it keeps, and who stands in for whom."""

from __future__ import annotations

from evidence.sparse import Dictionary, explain, log_evidence
import numpy as np
from one_evidence import chance_of_split, outcome
import pytest


def dictionary(seed: int, truth: dict[int, float], rows: int = 400, count: int = 40) -> Dictionary:
    """Return columns in white noise, two by two of one cause, with these coefficients."""
    random = np.random.default_rng(seed)
    columns = random.standard_normal((rows, count))
    columns[:, 1] = columns[:, 0] + 0.05 * columns[:, 1]
    rest = random.standard_normal(rows) + sum(
        size * columns[:, place] for place, size in truth.items()
    )
    return Dictionary(
        score=columns.T @ rest,
        information=columns.T @ columns,
        causes=tuple(f'cause {place // 2}' for place in range(count)),
        costs=np.full(count, np.log(count)),
    )


def test_what_is_there_is_found_and_nothing_else():
    for seed in range(10):
        found = explain(dictionary(seed, {4: 0.6, 20: -0.5}))
        assert set(found.causes) == {'cause 2', 'cause 10'}
        assert min(found.weights.values()) > 10.0
    assert sum(bool(explain(dictionary(seed, {})).causes) for seed in range(20)) <= 1


def test_evidence_is_that_of_the_columns_and_another_may_stand_in():
    items = dictionary(3, {0: 0.6})
    found = explain(items)
    assert found.strongest == 'cause 0'
    assert found.evidence == log_evidence(items, found.columns, found.variances)
    without = explain(items, ('cause 0',))
    assert 'cause 0' not in without.causes
    assert without.evidence < found.evidence - 10.0


def test_an_even_split_says_nothing_and_an_uneven_one_is_that_rare():
    assert chance_of_split(0, 0) == chance_of_split(3, 3) == 1.0
    assert chance_of_split(6, 0) == chance_of_split(0, 6) == pytest.approx(2.0 / 2**6)
    assert chance_of_split(6, 1) == pytest.approx(2.0 * 8.0 / 2**7)


def test_an_uneven_arm_in_which_nothing_is_hidden_may_be_unobservable():
    row = {'block': 'static', 'truth': {'effects': {}, 'strain': 0.0}}
    said = row | {'today': {'score': 'unobservable'}, 'evidence': {'score': 'false name'}}
    assert [outcome(said, name) for name in ('today', 'evidence')] == ['right', 'false name']
    hidden = said | {'truth': {'effects': {}, 'strain': 0.1}}
    assert outcome(hidden, 'today') == 'unobservable'


def test_what_no_engine_settled_on_is_not_invisible():
    failed = {'answer': 'failed', 'effects': [], 'alternatives': [], 'evidence': []}
    row = {'block': 'rated_single', 'truth': {'effects': {'creep': {'amplitude': 0.1}}}}
    for name in ('today', 'evidence'):
        row[name] = failed | {'detectable': {}}
    assert [outcome(row, name) for name in ('today', 'evidence')] == ['failed', 'failed']

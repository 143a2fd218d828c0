"""A bank of hypotheses: priors that are replaced exactly, weights, and what is dropped."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.measurement.inference.bank import Hypothesis, odds_relative_to_first, ranked
from pneunet_ros.measurement.inference.gaussian import (
    Gaussian,
    prior_log_odds,
    take_measurement,
    with_prior,
    without_prior,
)
import pytest

WHERE = slice(3, 5)
NARROW = np.array([1.0, 2.0, 0.5, 0.01, 0.02, 3.0])
WIDE = np.array([1.0, 2.0, 0.5, 0.5, 0.7, 3.0])


def measured(std, seed, center=0.0):
    """Return what is known after eight measurements, from a prior, and their log evidence."""
    random = np.random.default_rng(seed)
    response = random.standard_normal((8, std.size))
    value, noise = 2.0 * random.standard_normal(8), np.full(8, 0.3)
    mean = np.zeros(std.size)
    mean[WHERE] = center
    prior = Gaussian(mean=mean, root=np.diag(std))
    spread = response @ np.diag(std**2) @ response.T + np.diag(noise**2)
    off = value - response @ mean
    evidence = -0.5 * (off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])
    return take_measurement(prior, response, value, noise), float(evidence)


@pytest.mark.parametrize('center', [0.0, -0.4])
@pytest.mark.parametrize('seed', range(5))
def test_a_prior_is_replaced_after_all_measurements_as_if_it_had_stood_before_them(seed, center):
    narrow, before = measured(NARROW, seed, center)
    wide, after = measured(WIDE, seed, center)
    found, log_odds = with_prior(narrow, WHERE, NARROW[WHERE], WIDE[WHERE], center)
    assert log_odds == pytest.approx(after - before, rel=1e-8)
    assert prior_log_odds(narrow, WHERE, NARROW[WHERE], WIDE[WHERE], center) == log_odds
    assert found.mean == pytest.approx(wide.mean, abs=1e-8)
    assert found.root @ found.root.T == pytest.approx(wide.root @ wide.root.T, abs=1e-9)


def test_what_is_known_exactly_has_no_other_prior():
    std = NARROW.copy()
    std[3] = 0.0
    known, _ = measured(std, 0)
    found, log_odds = with_prior(known, WHERE, std[WHERE], WIDE[WHERE])
    assert found is known
    assert log_odds == -math.inf


def test_measurements_alone_say_of_an_unknown_what_a_flat_prior_would():
    response, value, noise = np.array([[1.0]]), np.array([0.2]), np.array([0.05])
    prior = Gaussian(mean=np.zeros(1), root=np.array([[0.01]]))
    known = take_measurement(prior, response, value, noise)
    assert without_prior(known, 0, 0.01) == pytest.approx((0.2, math.hypot(0.05, 0.01)))
    assert without_prior(prior, 0, 0.01) == (0.0, math.inf)


def hypothesis(value, log_weight):
    return Hypothesis(
        belief=Gaussian(mean=np.array([value]), root=np.eye(1)), log_weight=log_weight
    )


def is_same(one, other):
    return bool(one.mean[0] == other.mean[0])


def test_the_best_comes_first_and_what_is_unlikely_or_the_same_is_dropped():
    given = [hypothesis(1.0, -3.0), hypothesis(2.0, 5.0), hypothesis(3.0, 2.0)]
    given += [hypothesis(2.0, 4.0), hypothesis(4.0, 1.0), hypothesis(5.0, -math.inf)]
    kept = ranked(given, 7.0, 4, is_same)
    assert [one.belief.mean[0] for one in kept] == [2.0, 3.0, 4.0]
    assert [one.log_weight for one in kept] == [0.0, -3.0, -4.0]
    assert [one.is_about_as_likely for one in kept] == [True, True, False]
    assert len(ranked(given, 7.0, 2, is_same)) == 2
    odds = odds_relative_to_first(kept)
    assert odds == pytest.approx([math.exp(-3.0), math.exp(-4.0)])
    assert odds_relative_to_first(tuple(reversed(kept))) == [1.0, 1.0]

"""What recordings could show: the smallest visible sizes, and effects that act alike."""

from __future__ import annotations

import functools
import math

import numpy as np
from pneunet_ros.diagnosis.fit.hypothesis import hypotheses
from pneunet_ros.diagnosis.scores.score_test import (
    Candidate,
    detection_limits,
    effect_cosines,
    largest_clean_score,
    score_effects,
)
from pneunet_ros.diagnosis.settings import LACK_OF_FIT, SELECTION
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
import pytest
from scipy.stats import chi2
from support.lab_designs import asked, fitted, frame

NAMES = ('load_offset', 'extensibility', 'gravity', 'clamp_compliance', 'camera_rotation')


def invented(name: str, direction: list[float], size: float = 0.01) -> Candidate:
    """Return a candidate by its answer in one run."""
    item = asked(name)
    tried = np.zeros(item.size)
    tried[0] = size
    return Candidate(
        hypothesis=item,
        which=0,
        tried=tried,
        gain=0.0,
        start=tried,
        information=float(np.dot(direction, direction)),
        direction=(np.array(direction),),
    )


def plain(columns: list[list[float]]) -> GaussianModel:
    """Return a problem of one run of four rows with these columns."""
    return GaussianModel.of([np.array(columns, dtype=float).reshape(4, -1)], [np.zeros(4)],
                     np.zeros(len(columns[0])))  # fmt: skip


def test_the_smallest_visible_size_has_a_chi_squared_of_25():
    found = detection_limits(
        [asked('load_offset')], [invented('load_offset', [0.0, 6.0, 8.0, 0.0])]
    )
    shown = found['load_offset']
    # 0.01 m has 100: five standard deviations are half of it.
    assert (shown.parameter, shown.unit) == ('offset', 'm')
    assert shown.smallest == pytest.approx(0.005)
    assert shown.observable
    small = detection_limits(
        [asked('load_offset')], [invented('load_offset', [1.0, 0.0, 0.0, 0.0])]
    )
    assert small['load_offset'].smallest == pytest.approx(0.05)
    assert not small['load_offset'].observable  # more than twice the height of the arm


def test_the_smallest_visible_stretch_is_the_largest_stiffness():
    found = detection_limits(
        [asked('extensibility')], [invented('extensibility', [5.0, 0.0, 0.0, 0.0])]
    )
    assert found['extensibility'].smallest == pytest.approx(100.0)  # N, of a compliance of 0.01
    assert found['extensibility'].observable


def test_what_could_not_be_tried_and_what_is_a_scale_of_pressure_are_not_seen():
    strong = [1e6, 0.0, 0.0, 0.0]
    items = [asked(name) for name in ('pressure_gain', 'pressure_offset', 'creep')]
    found = detection_limits(items, [invented('pressure_gain', strong)])
    assert list(found) == ['pressure_gain', 'pressure_offset', 'creep']
    assert not any(item.observable for item in found.values())
    assert all(item.smallest == math.inf for item in found.values())


def test_cosines_are_those_beside_a_refitted_base():
    first = invented('load_offset', [1.0, 1.0, 0.0, 0.0])
    second = invented('gravity', [1.0, -1.0, 0.0, 0.0])
    third = invented('creep', [0.0, 1.0, 0.0, 2.0])
    none = [[0.0]] * 4
    found = effect_cosines(plain(none), [first, second, third])
    assert found == {
        ('load_offset', 'gravity'): 0.0,
        ('load_offset', 'creep'): pytest.approx(1.0 / math.sqrt(10.0)),
        ('gravity', 'creep'): pytest.approx(-1.0 / math.sqrt(10.0)),
    }
    # Where the base takes up the first row, the first two are the same thing.
    strong = [[1e5], [0.0], [0.0], [0.0]]
    taken = effect_cosines(plain(strong), [first, second])
    assert taken[('load_offset', 'gravity')] == pytest.approx(-1.0)
    assert effect_cosines(plain(none), []) == {}


@functools.cache
def tried() -> list[Candidate]:
    """Return candidates beside the base model of clean recordings."""
    return score_effects(fitted(), [asked(name) for name in NAMES])


def test_the_best_candidate_comes_first():
    gains = [item.gain for item in tried()]
    assert gains == sorted(gains, reverse=True)
    assert {item.hypothesis.name for item in tried()} == set(NAMES)
    hidden = score_effects(fitted(hidden='load_offset'), [asked(name) for name in NAMES])
    assert hidden[0].hypothesis.name == 'load_offset'
    assert hidden[0].gain > 500.0
    assert hidden[0].start[0] == pytest.approx(0.006, rel=0.15)


def test_effects_that_are_in_the_fit_are_not_tried_again():
    found = score_effects(fitted('load_offset', 'load_offset'), [asked(name) for name in NAMES])
    assert {item.hypothesis.name for item in found} == set(NAMES) - {'load_offset'}


@pytest.mark.parametrize('name', ['load_offset', 'extensibility'])
def test_what_is_visible_is_what_a_joint_fit_would_be_sure_of(name):
    shown = detection_limits([asked(name)], tried())[name]
    number = asked(name).coordinates[0].of(shown.smallest)
    std = math.sqrt(fitted(name).covariance[0, 0])
    assert number == pytest.approx((math.sqrt(SELECTION.least_gain) + 1.0) * std, rel=0.1)
    assert shown.observable == (number <= 2.0 * asked(name).std[0])


def test_all_effects_have_a_word_on_what_could_be_seen():
    found = detection_limits(hypotheses(frame()), tried())
    assert set(found) == {item.name for item in hypotheses(frame())}
    assert {name for name, item in found.items() if item.observable} <= set(NAMES)


def test_cosines_of_the_lab():
    found = effect_cosines(fitted().gaussian, tried())
    assert found
    for pair, alike in found.items():
        assert abs(alike) < 1.0
        assert set(pair) <= set(NAMES)


def test_the_largest_score_of_clean_data_by_chance():
    problem = plain([[0.0], [0.0], [0.0], [0.0]])
    rows = ([1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0])
    apart = [invented(name, row) for name, row in zip(NAMES, rows, strict=False)]
    alike = [invented(name, rows[0]) for name in NAMES]
    level = LACK_OF_FIT.level
    # Three independent squares of normal numbers, or one: quantiles of chi squared.
    assert largest_clean_score(problem, apart, 0) == pytest.approx(
        chi2.isf(1 - (1 - level) ** (1 / 3), 1), rel=0.2
    )
    assert largest_clean_score(problem, alike, 0) == pytest.approx(chi2.isf(level, 1), rel=0.2)
    assert largest_clean_score(problem, [], 0) == 0.0

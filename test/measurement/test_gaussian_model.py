"""Linear algebra of hypotheses, against brute force with the whole covariance of residuals."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.errors.gaussian_model import GaussianModel
from pneunet_ros.measurement.gauss_newton import Bounds
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal

ROWS = (5, 4, 7)
SIZE = 6


def problem(seed: int) -> tuple[GaussianModel, Array, Array]:
    """Return a random problem of three runs, all its columns and its residuals at prior mean."""
    random = np.random.default_rng(seed)
    columns = [1.5 * random.standard_normal((rows, SIZE)) for rows in ROWS]
    residuals = [3.0 * random.standard_normal(rows) for rows in ROWS]
    position = random.standard_normal(SIZE)
    whole = np.concatenate(columns)
    return (
        GaussianModel.of(columns, residuals, position),
        whole,
        np.concatenate(residuals) + whole @ position,
    )


def further(seed: int, count: int) -> list[Array]:
    """Return more columns for every run."""
    random = np.random.default_rng([seed, 1])
    return [random.standard_normal((rows, count)) for rows in ROWS]


def cost(linear: GaussianModel, step: Array) -> float:
    """Half the squares of residuals and prior after a step."""
    rest = np.concatenate(linear.residuals) - np.concatenate(linear.columns) @ step
    return 0.5 * float(rest @ rest + np.sum((linear.position + step) ** 2))


seeds = pytest.mark.parametrize('seed', range(4))


@seeds
def test_the_step_leads_to_the_most_probable_unknowns(seed):
    linear, columns, start = problem(seed)
    least = minimize(lambda step: cost(linear, step), np.zeros(SIZE), tol=1e-12)
    assert linear.step == pytest.approx(least.x, abs=1e-5)
    mean = np.linalg.solve(np.eye(SIZE) + columns.T @ columns, columns.T @ start)
    assert linear.position + linear.step == pytest.approx(mean)
    assert np.concatenate(linear.best_residuals()) == pytest.approx(start - columns @ mean)
    assert linear.covariance == pytest.approx(np.linalg.inv(np.eye(SIZE) + columns.T @ columns))
    right = np.random.default_rng(seed).standard_normal((SIZE, 2))
    assert linear.solved(right) == pytest.approx(linear.covariance @ right)


@seeds
def test_a_step_lowers_the_cost_by_what_it_says(seed):
    linear, _, _ = problem(seed)
    expected = cost(linear, np.zeros(SIZE)) - cost(linear, linear.step)
    assert linear.gain == pytest.approx(expected)


@seeds
def test_a_step_with_some_unknowns_kept(seed):
    linear, _, _ = problem(seed)
    kept, free = [1, 4], [0, 2, 3, 5]
    held = Bounds(rows=np.eye(SIZE)[kept], low=np.zeros(2), high=np.zeros(2))
    step, gain = held.hold(linear.step, linear.gain, linear.solved)
    assert step[kept] == pytest.approx(0.0, abs=1e-12)
    assert gain == pytest.approx(cost(linear, np.zeros(SIZE)) - cost(linear, step))

    def of_free(part: Array) -> float:
        whole = np.zeros(SIZE)
        whole[free] = part
        return cost(linear, whole)

    assert step[free] == pytest.approx(minimize(of_free, np.zeros(4), tol=1e-12).x, abs=1e-5)
    assert gain < linear.gain


@seeds
def test_a_step_stays_within_bounds_of_sums_of_unknowns(seed):
    linear, _, _ = problem(seed)
    rows = np.random.default_rng([seed, 2]).standard_normal((3, SIZE))
    moved = rows @ linear.step
    # The first may not go half of its way, the second as far as it likes, the third no way back.
    limits = Bounds(
        rows=rows,
        low=np.minimum(np.array([0.5 * moved[0], -np.inf, 0.0]), 0.0),
        high=np.maximum(np.array([0.5 * moved[0], np.inf, np.inf]), 0.0),
    )
    step, gain = limits.hold(linear.step, linear.gain, linear.solved)
    assert np.all(rows @ step >= limits.low - 1e-9)
    assert np.all(rows @ step <= limits.high + 1e-9)
    assert rows[0] @ step == pytest.approx(0.5 * moved[0])
    assert gain == pytest.approx(cost(linear, np.zeros(SIZE)) - cost(linear, step))
    best = minimize(
        lambda whole: cost(linear, whole),
        np.zeros(SIZE),
        method='SLSQP',
        constraints=[
            {'type': 'ineq', 'fun': lambda whole: rows[0] @ whole - limits.low[0]},
            {'type': 'ineq', 'fun': lambda whole: limits.high[0] - rows[0] @ whole},
            {'type': 'ineq', 'fun': lambda whole: rows[2] @ whole - limits.low[2]},
        ],
    )
    assert cost(linear, step) == pytest.approx(best.fun, rel=1e-3)


@seeds
def test_score_and_inner_product_are_those_of_the_whole_covariance(seed):
    linear, columns, start = problem(seed)
    inverse = np.linalg.inv(np.eye(sum(ROWS)) + columns @ columns.T)
    some, others = further(seed, 3), further(seed + 100, 2)
    left, right = np.concatenate(some), np.concatenate(others)
    assert linear.score(some) == pytest.approx(left.T @ inverse @ start)
    assert linear.inner(some, some) == pytest.approx(left.T @ inverse @ left)
    assert linear.inner(some, others) == pytest.approx(left.T @ inverse @ right)


def test_what_the_base_can_do_itself_has_hardly_a_score():
    linear, columns, _ = problem(1)
    strong = GaussianModel.of(
        [1e4 * item for item in linear.columns], linear.residuals, np.zeros(SIZE)
    )
    alike = [item @ np.ones((SIZE, 1)) for item in linear.columns]
    assert strong.inner(alike, alike)[0, 0] < 1e-6 * float(np.sum((columns @ np.ones(SIZE)) ** 2))
    assert abs(strong.score(alike)[0]) < 1e-3


@seeds
def test_probability_of_runs_and_of_each_from_the_others(seed):
    linear, columns, start = problem(seed)
    covariance = np.eye(sum(ROWS)) + columns @ columns.T
    ends = np.cumsum(ROWS)
    places = [np.arange(stop - rows, stop) for stop, rows in zip(ends, ROWS, strict=True)]

    def log(chosen: Array) -> float:
        normal = multivariate_normal(np.zeros(chosen.size), covariance[np.ix_(chosen, chosen)])
        constant = 0.5 * chosen.size * np.log(2.0 * np.pi)
        return float(normal.logpdf(start[chosen])) + constant

    whole = np.arange(sum(ROWS))
    assert linear.log_probability() == pytest.approx(log(whole))
    total = 0.0
    for which, own in enumerate(places):
        rest = np.setdiff1d(whole, own)
        assert linear.without(which).log_probability() == pytest.approx(log(rest))
        # The same once more, as a run predicted by what the others say of it.
        gain = covariance[np.ix_(own, rest)] @ np.linalg.inv(covariance[np.ix_(rest, rest)])
        mean = gain @ start[rest]
        spread = covariance[np.ix_(own, own)] - gain @ covariance[np.ix_(rest, own)]
        total += float(multivariate_normal(mean, spread).logpdf(start[own]))
        total += 0.5 * own.size * np.log(2.0 * np.pi)
    assert linear.evidence() == pytest.approx(total)


def test_known_products_of_columns_are_used():
    linear, _, _ = problem(2)
    same = GaussianModel.of(linear.columns, linear.residuals, linear.position, linear.grams)
    assert same.step == pytest.approx(linear.step)
    twice = GaussianModel.of(
        linear.columns, linear.residuals, linear.position, [4.0 * item for item in linear.grams]
    )
    assert twice.step != pytest.approx(linear.step)

"""Effects fitted jointly with the model: what is hidden is found, what is not is about zero."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import ModelError
from pneunet_ros.diagnosis.fit import refit as refit_module
from pneunet_ros.diagnosis.fit.refit import effects_of, JointFit, refit, settle, split_numbers
from pneunet_ros.diagnosis.settings import REFIT
import pytest
from support.lab_designs import asked, design, fitted, HIDDEN

HYPOTHESES = ['load_offset', 'extensibility']


@pytest.mark.parametrize('name', HYPOTHESES)
def test_what_is_hidden_is_found(name):
    found, without = fitted(name, name), fitted(hidden=name)
    assert found.gain < REFIT.least_gain
    ((parameter, true),) = HIDDEN[name].items()
    item = asked(name)
    wanted = item.coordinates[0].of(true)
    std = np.sqrt(found.covariance[0, 0])
    assert abs(found.numbers[0] - wanted) < 3.0 * std
    assert std < 0.05 * abs(wanted)
    assert getattr(found.effects[0], parameter) == pytest.approx(true, rel=0.1)
    assert 2.0 * (without.cost - found.cost) > 100.0
    assert found.names == (name,)


@pytest.mark.parametrize('name', [*HYPOTHESES, 'clamp_compliance', 'camera_rotation'])
def test_what_is_not_there_is_about_zero(name):
    found, without = fitted(name), fitted()
    assert found.gain < REFIT.least_gain
    assert abs(found.numbers[0]) < 3.5 * np.sqrt(found.covariance[0, 0])
    assert 0.0 < 2.0 * (without.cost - found.cost) < 12.0


def test_the_error_is_how_the_cost_bends():
    # What gravity does is nearly all taken up by the base model: its answer must be exact.
    start = fitted().linearization.at(fitted().point)
    without = refit(start, (), np.zeros(0), 0)
    found = JointFit(start, (asked('gravity'),)).fit(np.array([0.0, 0.03]))
    assert without is not None
    assert found is not None
    promised = found.numbers @ np.linalg.solve(found.covariance, found.numbers)
    assert 2.0 * (without.cost - found.cost) == pytest.approx(promised, abs=0.5)
    assert np.all(np.abs(found.numbers) < 3.5 * np.sqrt(np.diag(found.covariance)))


def test_the_point_is_where_the_search_ended():
    found = fitted('load_offset', 'load_offset')
    point = found.point
    assert asked('load_offset').numbers(point.effects[-1]) == pytest.approx(found.numbers)
    again = found.linearization.at(point)
    assert again.position == pytest.approx(found.base[: again.position.size], abs=1e-9)
    assert again.point.arm.effects == (
        *found.linearization.point.parameters.frame.effects,
        *point.effects,
    )
    values = (
        found.linearization.mean
        + found.linearization.scale @ found.base[: found.linearization.mean.size]
    )
    assert np.concatenate([point.values, point.placement.ravel()]) == pytest.approx(values)
    # Beginning there, nothing changes.
    search = JointFit(again, found.hypotheses).fit(found.numbers, found.base)
    assert search is not None
    assert search.cost == pytest.approx(found.cost, abs=0.5)
    assert search.numbers == pytest.approx(
        found.numbers, abs=0.2 * float(np.sqrt(found.covariance[0, 0]))
    )


def test_the_cost_is_that_of_the_linear_problem_at_the_end():
    found = fitted('load_offset', 'load_offset')
    squares = sum(found.gaussian.squares) + found.gaussian.position @ found.gaussian.position
    volume = sum(found.gaussian.log_volumes)
    assert volume > 100.0  # readings move the points further than noise does
    assert found.cost == pytest.approx(0.5 * squares + volume)
    assert found.gain < 0.1


def test_the_cost_never_grows(monkeypatch):
    costs = []
    own = JointFit.relinearize

    def watched(self, at):
        costs.append(at.cost)
        return own(self, at)

    monkeypatch.setattr(JointFit, 'relinearize', watched)
    # From the far end of what is likely.
    found = JointFit(design('load_offset'), (asked('load_offset'),)).fit(np.array([-0.012]))
    assert found is not None
    assert len(costs) >= 2
    assert np.all(np.diff(costs) <= 0.0)
    assert costs[0] > found.cost + 100.0
    assert costs[-1] == found.cost


def test_a_step_that_is_too_long_or_uphill_is_not_taken():
    search = JointFit(design('extensibility'), (asked('extensibility'),))
    at = search.iterate(search.start(), np.array([0.02]))
    assert at is not None
    gaussian = search.linearize(at)
    assert gaussian is not None
    step, size = gaussian.step, at.base.size
    assert search.lower((at, gaussian), 3.0 * step) is None
    found = search.lower((at, gaussian), 1.5 * step)
    assert found is not None
    assert found.base == pytest.approx(at.base + 1.5 * step[:size])
    assert found.numbers == pytest.approx(at.numbers + 1.5 * step[size:] * search.std)
    again = search.iterate(found.base, found.numbers)
    assert again is not None
    assert found.cost == again.cost < at.cost
    assert search.lower((at, gaussian), -step) is None
    # A number goes to its bound and no further.
    below = 0.1 * step
    below[-1] = -1.0
    bounded = search.lower((replace(at, cost=np.inf), gaussian), below)
    assert bounded is not None
    assert bounded.numbers.tolist() == [0.0]


def test_numbers_stay_within_their_bounds():
    # Nothing is stiffer than inextensible: where that would be better, the search ends there.
    item = asked('extensibility')
    search = JointFit(design(), (item,))
    assert search.active_bounds(np.array([0.0]), np.array([1.0, -1.0])) == [1]
    assert search.active_bounds(np.array([0.0]), np.array([1.0, 1.0])) == []
    assert search.active_bounds(np.array([search.high[0]]), np.array([-1.0, 1.0])) == [1]
    started = search.fit(np.array([-5.0]))
    assert started is not None
    assert item.coordinates[0].low <= started.numbers[0] <= item.coordinates[0].high


def test_answers_to_numbers_are_how_residuals_fall():
    found = design('extensibility')
    search = JointFit(found, (asked('extensibility'), asked('load_offset')))
    at = search.iterate(search.start(), np.array([0.03, 0.002]))
    assert at is not None
    answers = search.jacobian(at)
    assert answers is not None
    for place, step in enumerate((1e-4, 1e-5)):
        moved = at.numbers.copy()
        moved[place] += step
        ahead = search.residuals(at.base, moved)
        moved[place] -= 2.0 * step
        behind = search.residuals(at.base, moved)
        assert ahead is not None
        assert behind is not None
        for which, columns in enumerate(answers):
            slope = (behind[which] - ahead[which]) / (2.0 * step)
            largest = max(float(np.abs(slope).max()), 1.0 / step * 1e-3)
            assert columns[:, place] == pytest.approx(slope, abs=0.01 * largest)


def test_products_of_columns_are_those_of_the_columns():
    linear = fitted('load_offset', 'load_offset').gaussian
    for columns, gram in zip(linear.columns, linear.grams, strict=True):
        assert np.allclose(gram, columns.T @ columns)


def test_numbers_of_several_effects_lie_one_after_the_other():
    items = (asked('gravity'), asked('load_offset'), asked('creep'))
    numbers = np.array([0.1, -0.2, 0.003, 0.04, np.log(20.0)])
    assert [part.tolist() for part in split_numbers(items, numbers)] == [
        [0.1, -0.2], [0.003], [0.04, np.log(20.0)]
    ]  # fmt: skip
    gravity, offset, creep = effects_of(items, numbers)
    assert (gravity.weight_x, gravity.weight_y, offset.offset) == (0.1, -0.2, 0.003)
    assert creep.time_constant == pytest.approx(20.0)
    assert effects_of((), np.zeros(0)) == ()


def test_a_fit_that_is_settled_is_left_alone():
    found = replace(fitted('load_offset', 'load_offset'), settled=True)
    assert settle(found, 3) is found
    assert settle(replace(found, settled=False), 0).settled is False


@dataclass(frozen=True)
class Swinging:
    """A fit of one number whose minimum runs away from where it was linearized: to -1.2 of it."""

    numbers: Array
    base: Array
    cost: float
    settled: bool = False
    hypotheses: tuple[()] = ()
    gain: float = 0.0

    @property
    def misfit(self) -> float:
        return self.cost

    @property
    def point(self) -> Array:
        return self.numbers

    @property
    def linearization(self) -> Swinging:
        return self

    def at(self, point: Array) -> Array:
        return point


class SwingingFit:
    """The search around a number."""

    def __init__(self, around: Array, *_: object) -> None:
        self.minimum = -1.2 * around

    def fit(self, *_: object) -> Swinging:
        return Swinging(self.minimum, self.minimum, 100.0 * float(np.sum(self.minimum**2)))


def test_a_search_that_swings_from_model_to_model_comes_to_rest(monkeypatch):
    monkeypatch.setattr(refit_module, 'JointFit', SwingingFit)
    start = Swinging(np.array([10.0]), np.array([10.0]), 1e4)
    found = settle(start, 20)
    assert found.settled
    assert found.numbers == pytest.approx(0.0, abs=0.1)


class RestlessFit(SwingingFit):
    """Rounds that never settle; of the first the search broke off, at the lowest cost."""

    rounds = iter(())

    def fit(self, *_: object) -> Swinging:
        cost, gain = next(self.rounds)
        return Swinging(np.array([cost]), np.zeros(1), cost, gain=gain)


def test_a_search_that_broke_off_is_not_the_best_of_its_rounds(monkeypatch):
    monkeypatch.setattr(refit_module, 'JointFit', RestlessFit)
    RestlessFit.rounds = iter([(6e5, 1e3), (7.4e5, 0.1), (7.2e5, 0.2), (7.3e5, 0.1)])
    found = settle(Swinging(np.array([1e6]), np.zeros(1), 1e6), 4)
    assert not found.settled
    assert found.cost == 7.2e5
    RestlessFit.rounds = iter([(6e5, 1e3), (7.4e5, 2e3)])
    assert settle(Swinging(np.array([1e6]), np.zeros(1), 1e6), 2).cost == 6e5


@dataclass(frozen=True)
class Parted(Swinging):
    """A fit between which and the one before there is no arm."""

    def at(self, point: Array) -> Array:
        raise ModelError('a rigidity passes through zero')


def test_a_search_between_two_signs_of_a_rigidity_ends_with_what_it_has():
    start = Parted(np.array([10.0]), np.array([10.0]), 1e4)
    assert settle(start, 20) is start

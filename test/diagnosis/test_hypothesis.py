"""Effects as hypotheses: numbers that are zero where nothing happens, for all of the table."""

from __future__ import annotations

from dataclasses import fields, replace
import math

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import quantities
from pneunet_ros.diagnosis.fit.hypothesis import hypotheses, Hypothesis, hypothesis
from pneunet_ros.diagnosis.settings import HYPOTHESIS
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.arm_size import ArmSize, scaled_prior
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.effect import Load, NO_TERMS, PressureScale, Terms
from pneunet_ros.effects.gravity import Gravity
from pneunet_ros.model.arm import Arm
import pytest
from support.scaled import Size

SCALE = PressureScale(rows=(0.0, 20e3, 40e3, 60e3), top=60e3, std=60.0)
PRESSURE = np.array([0.0, 15e3, 50e3])
everywhere = pytest.mark.parametrize('name', list(EFFECTS))


def arm() -> Arm:
    """Return the paper's arm."""
    return load_model(share_path('config/paper_arm.yaml'))


def asked(name: str) -> Hypothesis:
    """Return an effect of the table as a hypothesis."""
    return hypothesis(EFFECTS[name], ArmSize())


@everywhere
def test_numbers_and_effects_are_the_same_thing(name):
    item = asked(name)
    random = np.random.default_rng(4)
    low = np.array([max(one.low, one.mean - 2.0 * one.std) for one in item.coordinates])
    high = np.array([min(one.high, one.mean + 2.0 * one.std) for one in item.coordinates])
    for _ in range(20):
        numbers = random.uniform(low, high)
        assert item.numbers(item.effect(numbers)) == pytest.approx(numbers, rel=1e-9, abs=1e-15)


@everywhere
def test_the_ends_of_the_prior_range_are_numbers_within_the_bounds(name):
    item = asked(name)
    for place, declared in enumerate(fields(EFFECTS[name])):
        coordinate = item.coordinates[place]
        for value in declared.metadata['prior']:
            number = coordinate.of(value)
            assert coordinate.low <= number <= coordinate.high
            assert abs(number - coordinate.mean) <= 2.0 * coordinate.std * (1.0 + 1e-9)
            if value != declared.default or coordinate.shape:
                assert coordinate.value(number) == pytest.approx(value)


@everywhere
def test_without_any_size_nothing_happens(name):
    item = asked(name)
    assert np.array_equal(item.mean[item.sizes], np.zeros(len(item.sizes)))
    for numbers in item.shapes():
        effect = item.effect(numbers)
        for place in item.sizes:
            parameter = item.coordinates[place].parameter
            assert getattr(effect, parameter) == getattr(item.kind(), parameter)
        load = Load(pressure=31e3, force_x=0.2, force_y=-0.1, moment=1e-3)
        assert effect.sense(load) == load
        seen = effect.see(np.array([0.1]), np.array([0.02]))
        assert (float(seen[0][0]), float(seen[1][0])) == (0.1, 0.02)
        history = effect.initial(10e3, SCALE)
        for seconds, pressure in ((0.5, 30e3), (1.0, 5e3), (2.0, 5e3)):
            history, chamber = effect.actuate(history, seconds, pressure, SCALE)
            assert chamber == pytest.approx(pressure, rel=1e-12)
        if history:
            nothing(effect.history_terms(np.array([history]), SCALE))
        nothing(effect.terms(PRESSURE))


def nothing(terms: Terms) -> None:
    """Check that terms do not change a rod; a mixture of rows matters by its share alone."""
    for item in fields(Terms):
        if item.name not in ('part', 'row_weights'):
            value = np.asarray(getattr(terms, item.name), dtype=np.float64)
            assert np.all(value == getattr(NO_TERMS, item.name)), item.name


@everywhere
def test_a_number_without_shapes_is_the_neutral_effect(name):
    item = asked(name)
    if len(item.sizes) == item.size:
        assert item.effect(np.zeros(item.size)) == item.kind()


@everywhere
def test_starts_are_within_the_bounds_and_move_one_size(name):
    item = asked(name)
    moved = []
    for which, numbers in item.starts():
        assert np.all((item.low <= numbers) & (numbers <= item.high))
        assert numbers[which] != 0.0
        assert which in item.sizes
        assert not any(numbers[other] for other in item.sizes if other != which)
        assert item.effect(numbers) != item.kind()
        moved.append(which)
    assert sorted(set(moved)) == item.sizes


@everywhere
def test_slopes_are_those_of_the_parameter(name):
    item = asked(name)
    for coordinate in item.coordinates:
        here = coordinate.mean + 0.5 * coordinate.std
        step = 1e-5 * coordinate.std
        change = (coordinate.value(here + step) - coordinate.value(here - step)) / (2.0 * step)
        assert coordinate.slope(here) == pytest.approx(change, rel=1e-6)


def test_gain_and_offset_of_pressure_are_another_name_of_the_curvature_and_no_others():
    found = {item.name for item in hypotheses(arm()) if item.confounded_with_pressure_scale}
    assert found == {'pressure_gain', 'pressure_offset'}


def test_effects_with_a_history_remember():
    found = {item.name for item in hypotheses(arm()) if item.has_memory}
    assert found == {'camera_delay', 'pressure_lag', 'hysteresis', 'creep', 'softening'}


def test_the_time_of_creep_is_a_shape_and_its_amplitude_a_size():
    amplitude, time = asked('creep').coordinates
    assert (amplitude.parameter, amplitude.shape, time.shape) == ('amplitude', False, True)
    assert time.mean == pytest.approx(math.log(math.sqrt(2.0 * 300.0)))
    assert time.value(time.mean + time.std) == pytest.approx(300.0)
    times = {round(float(numbers[1]), 9) for _, numbers in asked('creep').starts()}
    assert len(times) == HYPOTHESIS.shapes


def test_a_stiffness_that_may_be_infinite_is_its_compliance():
    (compliance,) = asked('extensibility').coordinates
    assert compliance.reciprocal
    assert compliance.value(0.0) == math.inf
    assert compliance.of(20.0) == pytest.approx(0.05)
    assert compliance.value(-1.0) == math.inf  # no rod grows shorter when it is pulled
    assert compliance.value(1e5) == pytest.approx(1e-4)  # N, the least that is allowed


def test_known_effects_are_no_hypotheses():
    every = [item.name for item in hypotheses(arm())]
    assert every == [name for name in EFFECTS if name != 'inertia']
    known = replace(arm(), effects=(Creep(amplitude=0.1), Gravity(weight_y=0.1)))
    left = [name for name in every if name not in ('creep', 'gravity')]
    assert [item.name for item in hypotheses(known)] == left


@pytest.mark.parametrize('name', sorted(EFFECTS))
def test_no_number_leads_out_of_the_bounds_by_a_single_bit(name):
    tried = hypothesis(EFFECTS[name], ArmSize())
    random = np.random.default_rng(11)
    for place, item in enumerate(tried.coordinates):
        ends = [end for end in (item.low, item.high) if math.isfinite(end)]
        around = [math.nextafter(end, way) for end in ends for way in (-math.inf, math.inf)]
        drawn = random.normal(item.mean, 30.0 * item.std, 200).tolist()
        low, high = item.bounds
        for number in (*ends, *around, *drawn, -math.inf, math.inf):
            assert low <= item.value(number) <= high
            numbers = tried.mean.copy()
            numbers[place] = number
            tried.effect(numbers)  # refuses what is out of bounds


def test_a_fit_may_end_at_the_bound_of_the_camera_scale():
    # 1.0 + (0.1 - 1.0) is 0.09999999999999998, and ended a diagnosis.
    tried = hypothesis(EFFECTS['camera_scale'], ArmSize())
    assert tried.effect(tried.low).factor == 0.1
    assert tried.effect(tried.high).factor == 10.0


def test_what_is_linear_in_its_size():
    linear = {name for name, kind in EFFECTS.items() if hypothesis(kind, ArmSize()).is_linear}
    assert {'pressure_lag', 'hysteresis', 'softening'}.isdisjoint(linear)
    assert {'creep', 'gravity', 'extensibility', 'camera_scale'} <= linear


def test_the_priors_are_those_of_the_papers_arm():
    size = arm().size
    assert (size.length, size.force, size.pressure) == pytest.approx((1.0, 1.0, 1.0))


@everywhere
def test_an_arm_of_another_size_has_the_priors_of_its_size(name):
    """Every length, force and pressure times a factor: nothing depends on their units."""
    for length, force, pressure in ((8.0, 64.0, 0.25), (0.0625, 2.0**-8, 16.0)):
        other = Size(length=length, force=force, pressure=pressure)
        size = ArmSize(length=length, force=force, pressure=pressure)
        assert other.arm(arm()).size == size
        for item in quantities(EFFECTS[name]):
            # The zero of a gauge drifts by its own range, which is not known.
            factor = 1.0 if name == 'pressure_offset' else other.of(item.metadata['unit'])
            scaled = scaled_prior(item, size)
            assert scaled == tuple(factor * end for end in item.metadata['prior'])
            low, high = item.metadata['bounds']
            assert low <= scaled[0] <= scaled[1] <= high

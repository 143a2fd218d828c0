"""Which meaning of pressure readings is the most likely: known truths, and no false accusation."""

from __future__ import annotations

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import PRESSURE_UNITS
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.pressure_watch import OTHER_PRESSURE
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.meaning.pressure_convention import PressureConvention
from pneunet_ros.measurement.meaning.pressure_judge import (
    ANY_ACTUATOR,
    expected_of,
    expected_without_model,
    ExpectedPressure,
    judge_pressure,
    record_of,
)
from pneunet_ros.offline.judge import TargetFit
import pytest

ARM = load_model(share_path('config/paper_arm.yaml'))
PASCAL = PressureConvention()
KNOWN = (expected_of(ARM),)
DICE = np.random.default_rng(5)
STAIRS = np.concatenate([np.repeat(np.r_[0:60e3:7j, 50e3:0:6j], 40), np.zeros(30)])
NOISY = STAIRS + 60.0 * DICE.normal(size=STAIRS.size)
PULSES = 45e3 * np.maximum(np.sin(np.linspace(0.0, 20.0, 600)), 0.0)
VACUUM = ExpectedPressure(low=-60e3, high=0.0, std=60.0)


def verdict(values, declared=PASCAL, expected=KNOWN, **more):
    record = record_of(range(0, 10**7 * len(values), 10**7), np.asarray(values).tolist())
    return judge_pressure(record, declared, expected, **more)


@pytest.mark.parametrize('pressure', [NOISY, PULSES], ids=['stairs', 'pulses'])
@pytest.mark.parametrize('unit', ['hPa', 'kPa', 'psi', 'bar', 'MPa'])
@pytest.mark.parametrize('air', [None, 0.987e5, 1.013e5, 0.83e5])
def test_another_unit_and_reference_are_named_together(pressure, unit, air):
    size = PressureConvention(unit=unit).size
    found = verdict((pressure + (air or 0.0)) / size)
    assert found.contradicted
    assert (found.other.unit, found.other.sign) == (unit, 1)
    assert found.other.reference == ('gauge' if air is None else 'absolute')
    if air is not None:
        assert found.other.ambient == pytest.approx(air, abs=300.0)
    low, high = sorted(found.other.gauge(end) for end in (found.low, found.high))
    assert low == pytest.approx(0.0, abs=300.0)
    assert high == pytest.approx(float(pressure.max()), abs=300.0)


@pytest.mark.parametrize('pressure', [NOISY, PULSES], ids=['stairs', 'pulses'])
@pytest.mark.parametrize('unit', ['Pa', 'kPa', 'psi'])
def test_swapped_ports_are_named(pressure, unit):
    found = verdict(-pressure / PressureConvention(unit=unit).size)
    assert found.contradicted
    assert (found.other.unit, found.other.sign) == (unit, -1)


@pytest.mark.parametrize(
    'values',
    [
        NOISY,
        PULSES,
        0.1 * NOISY,
        1.3 * NOISY,
        5.0 * NOISY,
        np.full(400, 30e3) + 60.0 * DICE.normal(size=400),
        60.0 * DICE.normal(size=400),
        500.0 + 60.0 * DICE.normal(size=400),
        -300.0 + 20.0 * DICE.normal(size=400),
        3.0 + 1.0 * DICE.normal(size=400),
        np.full(400, 20.0),
        np.linspace(0.0, 66e3, 300),
        np.linspace(10e3, 66e3, 300),
        np.linspace(0.0, 30.0, 400) + 2.0 * DICE.normal(size=400),
        np.append(NOISY, 9999e3),
        [31e3],
    ],
)
def test_right_readings_are_not_accused(values):
    found = verdict(values)
    assert found is None or not found.contradicted


def test_zeros_say_nothing():
    assert verdict(np.zeros(100)) is None
    assert judge_pressure(record_of([], []), PASCAL, [expected_of(ARM)]) is None


def test_a_vacuum_actuator_is_not_accused_and_its_sensor_may_be_reversed():
    assert not verdict(-NOISY, expected=[VACUUM]).contradicted
    assert not verdict(-NOISY, expected=ANY_ACTUATOR).contradicted
    found = verdict(NOISY, expected=[VACUUM])
    assert (found.contradicted, found.other.sign) == (True, -1)
    absolute = verdict((0.98e5 - NOISY) / 1e3, expected=[VACUUM])
    assert absolute.contradicted
    assert (absolute.other.unit, absolute.other.reference) == ('kPa', 'absolute')
    assert absolute.other.ambient == pytest.approx(0.98e5, abs=300.0)


def test_settings_that_make_it_worse_are_named_as_well():
    declared = PressureConvention(unit='kPa')
    found = verdict(NOISY, declared)
    assert found.changes == {'pressure_unit': 'Pa'}
    absolute = PressureConvention(reference='absolute')
    assert verdict(NOISY, absolute).changes == {'pressure_reference': 'gauge'}


def test_where_no_model_is_known_only_what_no_actuator_has_is_accused():
    assert verdict(NOISY / 1e3, expected=ANY_ACTUATOR, moves=True).other.unit == 'kPa'
    assert not verdict(NOISY / 7.0, expected=ANY_ACTUATOR).contradicted


@pytest.mark.parametrize(('low', 'high'), [(-60e3, 60e3), (-30e3, 60e3), (-80e3, 30e3)])
def test_an_actuator_with_pressure_and_vacuum_is_not_accused(low, high):
    values = low + (high - low) * NOISY / NOISY.max()
    assert not verdict([0.0, *values], expected=ANY_ACTUATOR).contradicted
    assert not verdict([*values, 0.0], expected=ANY_ACTUATOR).contradicted


@pytest.mark.parametrize(('zero', 'top'), [(-10e3, 1e5), (-20e3, 1e5), (-40e3, 6e4), (-60e3, 1e5)])
def test_without_a_model_a_zero_that_was_never_set_is_found(zero, top):
    found = verdict(zero + top * NOISY / NOISY.max(), expected=ANY_ACTUATOR)
    assert found.contradicted
    assert found.other.offset == pytest.approx(-zero, abs=500.0)


@pytest.mark.parametrize('air', [85e3, 90e3, 95e3])
def test_absolute_pressures_at_a_height_are_none_of_a_vacuum(air):
    found = verdict(NOISY + air, expected=ANY_ACTUATOR)
    assert found.log_odds > 0.0
    assert found.other.reference == 'absolute'
    assert found.other.ambient == pytest.approx(air, abs=300.0)


def test_targets_find_a_zero_that_was_never_set():
    pressure = np.linspace(0.0, 60e3, 8)
    shapes = [solve(ARM, value) for value in pressure]
    places = ARM.target_arclength
    points = np.array(
        [[np.interp(places, one.arclength, part) for part in (one.x, one.y)] for one in shapes]
    )

    def fit(offset):
        return TargetFit(
            arm=ARM, reading=pressure + offset, load=np.zeros((8, 3)), points=points, places=places
        )

    for offset in (9e3, -9e3):
        found = verdict(pressure + offset, fit=fit(offset))
        assert found.contradicted
        assert found.other.offset == pytest.approx(-offset, abs=1.0)
    assert not verdict(pressure, fit=fit(0.0)).contradicted


def test_a_frame_in_which_the_model_has_no_shape_counts_as_the_length():
    places, found = ARM.target_arclength, solve(ARM, 2e4)
    points = [np.interp(places, found.arclength, part) for part in (found.x, found.y)]

    def fit(*moment):
        count = len(moment)
        return TargetFit(
            arm=ARM,
            reading=np.full(count, 2e4),
            load=np.array([[0.0, 0.0, one] for one in moment]),
            points=np.array([points] * count),
            places=places,
        )

    assert fit(0.0)(PASCAL) == pytest.approx((0.0, 1), abs=1e-8)
    assert fit(0.0, 1e3)(PASCAL) == pytest.approx((0.5, 2), abs=1e-8)
    assert fit(1e3)(PASCAL) == (1.0, 1)


@pytest.mark.parametrize('unit', PRESSURE_UNITS)
@pytest.mark.parametrize('reference', ['gauge', 'absolute'])
@pytest.mark.parametrize('sign', [1, -1])
def test_a_convention_and_its_inverse(unit, reference, sign):
    meaning = PressureConvention(
        unit=unit, reference=reference, sign=sign, ambient=95e3, offset=150.0
    )
    assert meaning.gauge(meaning.reading(31e3)) == pytest.approx(31e3)


def estimates(values, **settings):
    """Return the reasons of refusals and the number of estimates for 50 readings a second."""
    estimator = Estimator(
        arm=ARM, settings=EstimatorSettings(wrench_required=False, stations=3, **settings)
    )
    state = EstimatorState()
    for index, value in enumerate(values):
        reading = PressureReading(stamp_ns=10**9 + 20_000_000 * index, pressure=float(value))
        state, _ = estimator.step(state, reading)
    return state


def test_live_readings_in_kilopascals_stop_the_estimates_after_a_while():
    twenty = 20.0 + 0.06 * DICE.normal(size=600)
    state = estimates(twenty)
    assert state.rejected[OTHER_PRESSURE] == pytest.approx(100, abs=2)
    assert state.watch.verdict.other.unit == 'kPa'
    assert OTHER_PRESSURE not in estimates(twenty, judge_readings=False).rejected
    right = estimates(twenty, pressure_unit='kPa')
    assert right.estimates == 600


def test_a_slow_start_is_not_accused_live():
    state = estimates(np.linspace(0.0, 60.0, 600))
    assert (state.estimates, dict(state.rejected)) == (600, {})


def test_variance_is_in_the_unit_of_the_reading():
    arguments = {'wrench_required': False, 'stations': 3}
    pascal = Estimator(arm=ARM, settings=EstimatorSettings(**arguments))
    kilo = Estimator(arm=ARM, settings=EstimatorSettings(pressure_unit='kPa', **arguments))
    one = pascal.reading_std(PressureReading(stamp_ns=1, pressure=3e4, variance=1e4))
    two = kilo.reading_std(PressureReading(stamp_ns=1, pressure=30.0, variance=1e-2))
    assert one == pytest.approx(two)


@pytest.mark.parametrize('reach', [120e3, 200e3, 300e3, 700e3])
@pytest.mark.parametrize('share', [0.05, 0.1, 0.3, 1.0])
def test_a_pressure_that_is_held_is_not_accused_of_its_reference(reach, share):
    arm = ExpectedPressure(low=0.0, high=reach, std=1e-3 * reach)
    gauge = share * reach + arm.std * np.random.default_rng(3).normal(size=300)
    absolute = PressureConvention(unit='kPa', reference='absolute')
    assert not verdict(gauge, expected=[arm]).contradicted
    readings = [absolute.reading(value) for value in gauge.tolist()]
    assert not verdict(readings, absolute, [arm]).contradicted


@pytest.mark.parametrize('reach', [3e3, 1e4, 2e4])
@pytest.mark.parametrize('zero', [1.5e3, -1.5e3])
def test_the_zero_of_a_small_arm_is_named_by_its_targets(reach, zero):
    arm = ExpectedPressure(low=0.0, high=reach, std=1e-3 * reach)
    true = 0.95 * reach * np.repeat(np.r_[0:1:6j, 1:0:6j], 40)

    def fit(meaning):  # an arm that bends by half of its length
        return (0.5 * (zero + meaning.offset) / reach) ** 2 if meaning.size == 1.0 else 1.0, 8

    found = verdict(true + zero, expected=[arm], fit=fit)
    assert found.contradicted or reach > 1e4
    assert set(found.changes) == {'pressure_offset'}
    assert found.other.offset == pytest.approx(-zero, abs=1.0)


def test_live_a_sensor_that_was_mended_is_believed_again():
    waves = 20e3 * (1.0 - np.cos(np.linspace(0.0, 40.0, 1500)))
    broken, mended = waves[:800] / 1e3, waves[:1200]
    state = estimates(np.concatenate([broken, mended]))
    assert state.rejected[OTHER_PRESSURE] > 200
    assert not state.watch.verdict.contradicted
    still = estimates(np.concatenate([broken, broken, broken]))
    assert still.watch.verdict.contradicted


def test_without_a_model_a_vacuum_actuator_is_a_stranger_and_no_reversed_sensor():
    found = verdict(-NOISY, expected=expected_without_model(ARM))
    assert (found.contradicted, found.is_other_actuator) == (False, True)
    assert '--pressure-sign -1' in found.model_mismatch
    assert not verdict(NOISY, expected=expected_without_model(ARM)).is_other_actuator
    hecto = verdict((NOISY + 1e5) / 100.0, expected=expected_without_model(ARM))
    assert hecto.changes['pressure_unit'] == 'hPa'


def test_readings_without_bound_are_judged():
    assert verdict(NOISY * 1e300) is not None

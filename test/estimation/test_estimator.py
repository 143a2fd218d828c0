"""The estimator's one step: which readings it takes, what it refuses, and how sure it is."""

from __future__ import annotations

from dataclasses import fields, replace
import json
import math

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.effects import EFFECTS
from pneunet_ros.estimation import pressure_tare
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.pressure_tare import pressure_zero
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.measurement.meaning.pressure_judge import ExpectedPressure
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.domain_position import LOAD_BEYOND, LOADS_UNKNOWN, PRESSURE_BEYOND
from pneunet_ros.model.equilibrium import tip_jacobian
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.moment_law import LinearLaw
from pneunet_ros.model.motion import Motion
from pneunet_ros.model.uncertainty import ModelCovariance
import pytest
from support.example_arms import TABLE_1, WIDE
from support.refusals import refused

SECOND = 1_000_000_000
PAPER_ARM = load_model(share_path('config/paper_arm.yaml'))
ARM = replace(PAPER_ARM, domain=WIDE)  # the domain has tests of its own
PRESSURE, FORCE, MOMENT = 31e3, (0.175, 0.07), 2e-4
NAMES = ('x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment')


def estimator_with(arm=ARM, **settings) -> Estimator:
    return Estimator(arm=arm, settings=EstimatorSettings(**settings))


def pressure(at: float, value: float = PRESSURE, variance: float = 0.0) -> PressureReading:
    """Make a pressure reading stamped at so many seconds."""
    return PressureReading(stamp_ns=round(at * SECOND), pressure=value, variance=variance)


def wrench(
    at: float, force=FORCE, moment: float = MOMENT, frame: str = 'pneunet_base'
) -> WrenchReading:
    """Make an end wrench stamped at so many seconds."""
    return WrenchReading(
        stamp_ns=round(at * SECOND),
        force_x=force[0],
        force_y=force[1],
        moment=moment,
        frame_id=frame,
    )


def fed(estimator: Estimator, *readings):
    """Return the state after these readings, and what became of each."""
    state, outcomes = EstimatorState(), []
    for reading in readings:
        state, outcome = estimator.step(state, reading)
        outcomes.append(outcome)
    return state, outcomes


def last(estimator: Estimator, *readings):
    return fed(estimator, *readings)[1][-1]


def linear_covariance(estimate: ShapeEstimate):
    """Return the covariance of the tip without what errors do to second order."""
    further = estimate.second_order.stations(estimate.shape.arclength)[:, -1]
    return estimate.tip_covariance - np.outer(further, further)


PLAIN = estimator_with()
UNLOADED = estimator_with(wrench_required=False)


# What it gives


def test_an_estimate_is_the_equilibrium_under_the_readings():
    estimate = last(PLAIN, wrench(9.9), pressure(10))
    shape = solve(ARM, PRESSURE, FORCE, MOMENT)
    for name in NAMES:
        np.testing.assert_allclose(
            getattr(estimate.shape, name), getattr(shape, name), rtol=1e-10, atol=1e-12
        )
    assert estimate.stamp_ns == 10 * SECOND
    assert estimate.chamber_pressure == estimate.shape.pressure == PRESSURE
    assert (estimate.shape.force, estimate.shape.end_moment) == (FORCE, MOMENT)
    assert estimate.wrench_age == pytest.approx(0.1)
    assert estimate.warnings == ()


def test_a_step_is_pure():
    state, _ = fed(PLAIN, wrench(1), pressure(1))
    before = replace(state)
    after, first = PLAIN.step(state, pressure(1.1, 32e3))
    again, second = PLAIN.step(state, pressure(1.1, 32e3))
    assert isinstance(first, ShapeEstimate)
    assert same_values(first, second)
    assert same_values(after, again)
    assert same_values(state, before)
    with pytest.raises(ValueError, match='read-only'):
        first.shape.x[0] = 1.0


def test_the_number_of_stations_is_a_setting():
    estimate = last(estimator_with(stations=5), wrench(1), pressure(1))
    fine = last(estimator_with(stations=9), wrench(1), pressure(1))
    assert estimate.shape.arclength == pytest.approx(ARM.length * np.linspace(0, 1, 5))
    np.testing.assert_allclose(estimate.shape.curvature, fine.shape.curvature[::2])
    np.testing.assert_allclose(estimate.std_curvature, fine.std_curvature[::2])


# The end wrench


def test_without_an_end_wrench_there_is_no_estimate():
    refusal = last(PLAIN, pressure(1))
    assert (refusal.reason, refusal.error) == ('no_wrench', True)
    assert refusal.awaits_others
    assert 'wrench_required' in refusal.sentence


@pytest.mark.parametrize('age', [0.5, -0.5, 0.0])
def test_a_wrench_is_used_up_to_its_timeout(age):
    estimate = last(PLAIN, wrench(10 - age), pressure(10))
    assert estimate.wrench_age == age


@pytest.mark.parametrize(
    ('age_ns', 'side'), [(SECOND // 2 + 1, 'older'), (-SECOND // 2 - 1, 'newer')]
)
def test_a_wrench_beyond_its_timeout_is_stale(age_ns, side):
    load = replace(wrench(0), stamp_ns=10 * SECOND - age_ns)
    refusal = last(PLAIN, load, pressure(10))
    assert (refusal.reason, refusal.error) == ('stale_wrench', True)
    assert side in refusal.sentence
    assert 'wrench_timeout' in refusal.sentence


def test_an_unloaded_arm_needs_no_wrench_and_hears_none():
    estimate = last(UNLOADED, wrench(1), pressure(1))
    assert estimate.shape.force == (0.0, 0.0)
    assert estimate.shape.end_moment == 0.0
    assert estimate.wrench_age is None
    np.testing.assert_allclose(
        linear_covariance(estimate),
        60.0**2 * np.outer(estimate.jacobian[:, 0], estimate.jacobian[:, 0]),
        rtol=1e-9,
    )


def test_a_wrench_in_an_unknown_frame_is_refused_and_the_one_before_stays():
    _, (_, refusal, estimate) = fed(
        PLAIN, wrench(1), wrench(1.1, (9.0, 9.0), frame='tool0'), pressure(1.2)
    )
    assert (refusal.reason, refusal.error) == ('wrong_frame', True)
    assert "'tool0'" in refusal.sentence
    assert 'wrench_frame' in refusal.sentence
    assert estimate.shape.force == FORCE


@pytest.mark.parametrize('frame', ['tool0', 'pneunet_base'])
def test_the_frame_of_the_sensor_may_be_named(frame):
    estimate = last(estimator_with(wrench_frame='tool0'), wrench(1, frame=frame), pressure(1))
    assert estimate.shape.force == FORCE


def test_a_wrench_that_names_no_frame_is_refused():
    for estimator, named in (
        (PLAIN, 'pneunet_base'),
        (estimator_with(wrench_frame='tool0'), 'tool0'),
    ):
        refusal = last(estimator, wrench(1, frame=''))
        assert (refusal.reason, refusal.error) == ('wrong_frame', True)
        assert refusal.sentence.endswith(named)


@pytest.mark.parametrize('yaw', [0.7, -math.pi / 2])
def test_a_turned_sensor_of_the_reaction_gives_the_same_shape(yaw):
    along, across = FORCE
    seen = (
        -(math.cos(yaw) * along + math.sin(yaw) * across),
        -(math.cos(yaw) * across - math.sin(yaw) * along),
    )
    turned = estimator_with(wrench_sign=-1, wrench_yaw=yaw)
    plain = last(PLAIN, wrench(1), pressure(1))
    same = last(turned, wrench(1, seen, -MOMENT), pressure(1))
    for name in NAMES:
        np.testing.assert_allclose(
            getattr(same.shape, name), getattr(plain.shape, name), rtol=1e-9, atol=1e-12
        )
    np.testing.assert_allclose(same.jacobian, plain.jacobian, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(same.tip_covariance, plain.tip_covariance, rtol=1e-8, atol=1e-18)


# Readings that cannot be used, and what comes after them


@pytest.mark.parametrize('bad', [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize('what', ['pressure', 'variance', 'force_x', 'force_y', 'moment'])
def test_what_is_no_finite_number_is_dropped_and_changes_nothing(what, bad):
    good = pressure(1.1) if what in ('pressure', 'variance') else wrench(1.1)
    before, _ = fed(PLAIN, wrench(1), pressure(1))
    after, refusal = PLAIN.step(before, replace(good, **{what: bad}))
    assert (refusal.reason, refusal.error) == ('not_finite', False)
    assert dict(after.rejected) == {'not_finite': 1}
    assert same_values(replace(after, rejected=before.rejected), before)
    assert isinstance(PLAIN.step(after, pressure(1.2))[1], ShapeEstimate)


@pytest.mark.parametrize('kind', [pressure, wrench])
@pytest.mark.parametrize('stamp_ns', [0, -1])
def test_a_reading_without_a_stamp_is_dropped(kind, stamp_ns):
    refusal = last(PLAIN, replace(kind(1), stamp_ns=stamp_ns))
    assert (refusal.reason, refusal.error) == ('no_stamp', False)


@pytest.mark.parametrize('kind', [pressure, wrench])
@pytest.mark.parametrize(
    ('back', 'reason'), [(0.0, 'duplicate'), (0.001, 'older'), (1.0, 'older')]
)
def test_duplicate_and_late_readings_are_dropped_and_counted(kind, back, reason):
    before, _ = fed(PLAIN, wrench(10), pressure(10))
    after, refusal = PLAIN.step(before, kind(10 - back))
    assert (refusal.reason, refusal.error) == (reason, False)
    assert dict(after.rejected) == {reason: 1}
    assert same_values(replace(after, rejected=before.rejected), before)


@pytest.mark.parametrize('kind', [pressure, wrench])
def test_a_jump_back_in_time_starts_anew(kind):
    before, _ = fed(PLAIN, wrench(10), pressure(10))
    jumped, _ = PLAIN.step(before, kind(8.9))
    assert (jumped.resets, jumped.estimates) == (1, 1)
    state, _ = PLAIN.step(jumped, wrench(9))
    state, estimate = PLAIN.step(state, pressure(9))
    assert same_values(estimate, last(PLAIN, wrench(9), pressure(9)))
    assert (state.resets, state.estimates) == (1, 2)


def test_a_jump_back_in_time_forgets_the_wrench():
    state, (*_, refusal) = fed(PLAIN, wrench(10), pressure(10), pressure(8))
    assert refusal.reason == 'no_wrench'
    assert state.wrench is None


def test_a_wrench_in_an_unknown_frame_long_ago_is_not_why_there_is_none():
    wrong = wrench(9, frame='tool0')
    _, (*_, refusal) = fed(PLAIN, wrong, wrench(10), pressure(10), pressure(8))
    assert refusal.sentence == last(PLAIN, pressure(8)).sentence


def test_a_jump_back_in_time_is_noted_and_the_lag_starts_in_equilibrium():
    arm = replace(ARM, effects=(EFFECTS['pressure_lag'](time_constant=0.5),))
    _, (_, behind, fresh) = fed(
        estimator_with(arm, wrench_required=False),
        pressure(10, 10e3),
        pressure(10.1, 30e3),
        pressure(5, 30e3),
    )
    assert behind.chamber_pressure < 15e3
    assert fresh.chamber_pressure == 30e3
    assert any(' 5.1 s' in warning for warning in fresh.warnings)


def test_the_first_pressure_after_a_gap_is_marked():
    _, (_, punctual, late, later) = fed(UNLOADED, *map(pressure, (1, 1.5, 2.25, 4)))
    assert punctual.warnings == ()
    (warning,) = late.warnings
    assert ' 0.5 s' in warning
    assert later.warnings == late.warnings  # counted together by a replay


def test_rejected_readings_are_counted_by_reason():
    state, _ = fed(
        PLAIN,
        pressure(1),
        pressure(1.1),
        wrench(1.2, frame='tool0'),
        pressure(1.2, math.nan),
        wrench(1.2),
        pressure(1.2),
        pressure(1.2),
        pressure(1.3, 200e3),
    )
    assert dict(state.rejected) == {
        'no_wrench': 2,
        'wrong_frame': 1,
        'not_finite': 1,
        'duplicate': 1,
        'out_of_range': 1,
    }
    assert state.estimates == 1


@pytest.mark.parametrize(
    'trouble',
    [
        [pressure(1.1, math.nan)],
        [pressure(1.1, 500e3)],
        [pressure(1.1, -50e3)],
        [wrench(1.1, (math.nan, 0.0))],
        [wrench(1.1, (9.0, 9.0), frame='tool0')],
        [pressure(1)],
        [pressure(0.9)],
        [pressure(1.7)],  # its wrench is stale
        [wrench(1.1, (-1e5, 1e5)), pressure(1.1)],  # no rod carries that
    ],
    ids=['nan', 'above', 'below', 'nan-force', 'frame', 'again', 'older', 'stale', 'force'],
)
def test_after_any_trouble_the_next_good_readings_give_the_estimate(trouble):
    _, outcomes = fed(PLAIN, wrench(1), pressure(1), *trouble, wrench(1.8), pressure(1.8))
    troubled, estimate = outcomes[2:-2], outcomes[-1]
    assert any(isinstance(outcome, Refusal) for outcome in troubled)
    np.testing.assert_allclose(
        estimate.shape.tip, last(PLAIN, wrench(1.8), pressure(1.8)).shape.tip, rtol=1e-9
    )


# The pressure: range, reference, offset, lag


def test_pressure_a_little_beyond_the_range_is_extrapolated_with_a_warning():
    top = ARM.pressure_range[1]
    for value, extrapolated in ((top, False), (1.049 * top, True), (-0.049 * top, True)):
        estimate = last(UNLOADED, pressure(1, value))
        assert estimate.shape.extrapolated is extrapolated
        assert any('extrapolated' in text for text in estimate.warnings) is extrapolated


@pytest.mark.parametrize('share', [1.051, -0.051])
def test_pressure_further_out_gives_no_estimate(share):
    refusal = last(UNLOADED, pressure(1, share * ARM.pressure_range[1]))
    assert (refusal.reason, refusal.error) == ('out_of_range', True)


def test_absolute_pressure_taken_for_gauge_is_recognized():
    refusal = last(UNLOADED, pressure(1, 101_325.0 + PRESSURE))
    assert '31 to 31 kPa' in refusal.sentence
    assert 'pressure_reference' in refusal.sentence


def test_gauge_pressure_taken_for_absolute_is_recognized():
    refusal = last(
        estimator_with(wrench_required=False, pressure_reference='absolute'), pressure(1, PRESSURE)
    )
    assert '31 to 31 kPa' in refusal.sentence
    assert 'pressure_reference' in refusal.sentence


def test_pressure_that_fits_neither_way_gets_no_advice():
    assert 'pressure_reference' not in last(UNLOADED, pressure(1, 400e3)).sentence


def test_absolute_pressure_is_converted_by_the_ambient_one():
    absolute = estimator_with(
        wrench_required=False, pressure_reference='absolute', ambient_pressure=95e3
    )
    estimate = last(absolute, pressure(1, 95e3 + PRESSURE))
    assert same_values(estimate, last(UNLOADED, pressure(1)))


def test_the_pressure_offset_is_added():
    estimate = last(
        estimator_with(wrench_required=False, pressure_offset=-250.0), pressure(1, 31_250.0)
    )
    assert same_values(estimate, last(UNLOADED, pressure(1)))


def test_behind_a_line_the_chamber_lags_and_the_jacobian_is_its():
    tau = 0.4
    lagging = replace(ARM, effects=(EFFECTS['pressure_lag'](time_constant=tau),))
    estimate = last(
        estimator_with(lagging, wrench_required=False), pressure(1, 20e3), pressure(1.2, 24e3)
    )
    slope = 4e3 / 0.2
    chamber = 24e3 - slope * tau * (1.0 - math.exp(-0.2 / tau))
    assert estimate.chamber_pressure == pytest.approx(chamber, rel=1e-12)
    assert estimate.shape.pressure == 24e3
    at_chamber = last(UNLOADED, pressure(1, chamber))
    np.testing.assert_allclose(estimate.shape.x, at_chamber.shape.x, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(estimate.jacobian, at_chamber.jacobian, rtol=1e-8, atol=1e-14)


def test_an_estimator_goes_on_from_a_history_that_was_written_down():
    effects = (
        EFFECTS['hysteresis'](width=1e3),
        EFFECTS['creep'](amplitude=0.1, time_constant=2.0),
        EFFECTS['softening'](loss=0.2),
    )
    estimator = estimator_with(replace(ARM, effects=effects), wrench_required=False)
    state, _ = fed(estimator, pressure(1, 20e3), pressure(2, 50e3), pressure(3, 35e3))
    written = json.loads(json.dumps(state.history))
    resumed = replace(state, history=tuple(tuple(item) for item in written))
    goes_on, anew = (estimator.step(begin, pressure(4, 34e3))[1] for begin in (state, resumed))
    assert same_values(goes_on, anew)
    forgetful = last(estimator, pressure(4, 34e3))
    assert math.dist(goes_on.shape.tip[:2], forgetful.shape.tip[:2]) > 5e-4


def test_a_reading_that_is_refused_still_moves_the_lag():
    lagging = replace(ARM, effects=(EFFECTS['pressure_lag'](time_constant=0.4),))
    path = [pressure(1, 20e3), pressure(1.2, 60e3), pressure(1.4, 20e3)]
    heard = last(estimator_with(lagging), wrench(1.3), *path)
    _, outcomes = fed(estimator_with(lagging), *path[:2], wrench(1.3), path[2])
    assert isinstance(outcomes[1], Refusal)
    assert outcomes[3].chamber_pressure == heard.chamber_pressure > 25e3


# The domain


SHIPPED = estimator_with(PAPER_ARM)


def test_table_1_is_estimated_without_a_word():
    for row in TABLE_1:
        estimate = last(SHIPPED, wrench(1, row.force, 0.0), pressure(1, row.pressure))
        assert estimate.warnings == ()
        assert not estimate.shape.extrapolated


def test_noise_at_rest_is_no_extrapolation():
    for value in (-60.0, -479.0):
        assert (
            last(estimator_with(PAPER_ARM, wrench_required=False), pressure(1, value)).warnings
            == ()
        )


@pytest.mark.parametrize('force', [(0.0, -5.0), (-0.3, 0.0), (5.0, 0.0), (1e6, 1e6)])
def test_a_load_far_beyond_the_calibrated_ones_gives_no_estimate(force):
    refusal = last(SHIPPED, wrench(1, force, 0.0), pressure(1))
    assert (refusal.reason, refusal.error) == ('load_out_of_domain', True)


def test_a_load_beyond_the_calibrated_ones_is_flagged_and_the_less_sure_the_further():
    deviations = []
    for push in (0.02, 0.06, 0.1, 0.14):
        beyond = last(SHIPPED, wrench(1, (-push, 0.0), 0.0), pressure(1))
        known = last(PLAIN, wrench(1, (-push, 0.0), 0.0), pressure(1))
        assert beyond.warnings == (LOAD_BEYOND,)
        assert beyond.shape.extrapolated
        np.testing.assert_array_equal(beyond.shape.x, known.shape.x)
        added = beyond.tip_covariance - known.tip_covariance
        assert np.linalg.eigvalsh(added)[0] > -1e-9
        assert (beyond.std_x >= known.std_x).all()
        deviations.append(beyond.position.error[0])
    assert deviations == sorted(deviations)


def test_a_pressure_beyond_the_range_is_less_sure():
    at = replace(PAPER_ARM, domain=Domain(pressure=(0.0, 30e3), end_load=[[0.2, 0.0, 0.0, 0.0]]))
    beyond = last(estimator_with(at, wrench_required=False), pressure(1, 31e3))
    known = last(UNLOADED, pressure(1, 31e3))
    assert beyond.warnings == (PRESSURE_BEYOND,)
    assert beyond.tip_covariance[1, 1] > 2.0 * known.tip_covariance[1, 1]


def test_a_model_without_domain_warns_under_a_load():
    bare = estimator_with(replace(PAPER_ARM, domain=None))
    assert last(bare, wrench(1), pressure(1)).warnings == (LOADS_UNKNOWN,)
    assert last(bare, wrench(1, (0.0, 0.0), 0.0), pressure(1)).warnings == ()


# Out of the plane


@pytest.mark.parametrize(
    ('part', 'limit'), [('force_z', 0.03132), ('moment_x', 0.003508), ('moment_y', 0.003508)]
)
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_wrench_out_of_the_plane_is_a_warning_and_then_an_error(part, limit, sign):
    """A tenth of the largest force of Table 1, 0.3132 N, and of its moment at 0.112 m."""
    name = {'force_z': 'Fz', 'moment_x': 'Mx', 'moment_y': 'My'}[part]
    at = wrench(1, moment=0.0)
    for share, words in ((0.99, ()), (1.01, (name,))):
        beside = replace(at, **{part: sign * share * limit})
        estimate = last(SHIPPED, beside, pressure(1))
        assert len(estimate.warnings) == len(words)
        assert all(text in said for text, said in zip(words, estimate.warnings, strict=True))
    assert isinstance(
        last(SHIPPED, replace(at, **{part: sign * 2.99 * limit}), pressure(1)), ShapeEstimate
    )
    refusal = last(SHIPPED, replace(at, **{part: sign * 3.01 * limit}), pressure(1))
    assert (refusal.reason, refusal.error) == ('out_of_plane', True)
    assert refusal.sentence.startswith(f'{name} ')
    assert 'out_of_plane_limit' in refusal.sentence


def test_the_limit_out_of_the_plane_is_a_setting_and_noise_is_within():
    beside = replace(wrench(1, moment=0.0), force_z=0.5)
    assert (
        last(estimator_with(PAPER_ARM, out_of_plane_limit=2.0), beside, pressure(1)).warnings == ()
    )
    noisy = replace(wrench(1, moment=0.0), force_z=0.0039)
    strict = estimator_with(PAPER_ARM, out_of_plane_limit=0.001)
    assert last(strict, noisy, pressure(1)).warnings == ()
    assert len(last(strict, replace(noisy, force_z=0.0041), pressure(1)).warnings) == 1


def test_what_is_not_measured_is_not_out_of_the_plane():
    silent = replace(wrench(1), force_z=math.nan, moment_x=math.nan, moment_y=math.nan)
    assert last(PLAIN, silent, pressure(1)).warnings == ()
    beside = last(PLAIN, replace(silent, moment_x=1.0), pressure(1))
    assert beside.reason == 'out_of_plane'
    assert last(PLAIN, replace(silent, force_z=-math.inf)).reason == 'not_finite'


def test_a_turned_sensor_turns_what_is_out_of_the_plane():
    turned = estimator_with(PAPER_ARM, wrench_yaw=math.pi / 2, wrench_sign=-1)
    seen = replace(wrench(1, (-FORCE[1], FORCE[0]), 0.0), moment_x=0.02)
    said = last(turned, seen, pressure(1)).sentence
    assert (said[:3], ' -0.02' in said) == ('My ', True)


# A stamp ahead of its time


HOUR = 3600.0
CREEPING = replace(
    ARM,
    effects=(
        EFFECTS['creep'](amplitude=0.1, time_constant=20.0),
        EFFECTS['pressure_lag'](time_constant=0.5),
    ),
)


@pytest.mark.parametrize('ahead', [1.5, 30.0, HOUR])
def test_one_pressure_stamp_ahead_costs_no_history(ahead):
    creeping = estimator_with(CREEPING, wrench_required=False)
    path = [pressure(1, 10e3), pressure(1.1, 40e3), pressure(1.2, 40e3)]
    after = [pressure(1.4, 41e3), pressure(1.5, 42e3)]
    _, clean = fed(creeping, *path, *after)
    state, troubled = fed(creeping, *path, pressure(1.3 + ahead, 41e3), *after)
    assert state.resets == 0
    assert dict(state.rejected) == {'ahead': 1}
    assert len(troubled[-2].warnings) == 1
    for one, other in zip(clean[-2:], troubled[-2:], strict=True):
        np.testing.assert_allclose(one.shape.tip, other.shape.tip, rtol=1e-9)
        assert one.chamber_pressure == other.chamber_pressure
    assert troubled[-1].warnings == ()


def test_one_wrench_stamp_ahead_costs_no_history():
    path = [wrench(1), pressure(1, 10e3), wrench(1.1), pressure(1.1, 40e3)]
    after = [wrench(1.3), pressure(1.3, 41e3)]
    creeping = estimator_with(CREEPING)
    _, clean = fed(creeping, *path, *after)
    state, troubled = fed(creeping, *path, wrench(1.2 + HOUR), *after)
    assert (state.resets, dict(state.rejected)) == (0, {'ahead': 1})
    np.testing.assert_allclose(clean[-1].shape.tip, troubled[-1].shape.tip, rtol=1e-9)


def test_both_stamps_ahead_cost_no_history():
    path = [wrench(1), pressure(1, 10e3), wrench(1.1), pressure(1.1, 40e3)]
    after = [wrench(1.3), pressure(1.3, 41e3)]
    state, outcomes = fed(
        estimator_with(CREEPING), *path, wrench(1.2 + HOUR), pressure(1.2 + HOUR), *after
    )
    assert (state.resets, dict(state.rejected)) == (0, {'ahead': 2})
    assert isinstance(outcomes[-1], ShapeEstimate)


REMEMBERS = {
    'creep': EFFECTS['creep'](amplitude=0.1, time_constant=20.0),
    'hysteresis': EFFECTS['hysteresis'](width=2e3),
    'pressure_lag': EFFECTS['pressure_lag'](time_constant=0.5),
    'softening': EFFECTS['softening'](loss=0.1),
}


@pytest.mark.parametrize('name', REMEMBERS)
def test_a_pressure_that_no_arm_can_have_leaves_no_trace_in_it(name):
    remembering = estimator_with(replace(ARM, effects=(REMEMBERS[name],)), wrench_required=False)
    path = [pressure(1, 10e3), pressure(1.1, 40e3), pressure(1.2, 20e3)]
    after = [pressure(1.4, 20e3), pressure(1.5, 21e3)]
    _, clean = fed(remembering, *path, *after)
    state, troubled = fed(remembering, *path, pressure(1.3, 3e7), *after)
    assert dict(state.rejected) == {'out_of_range': 1}
    for one, other in zip(clean[-2:], troubled[-2:], strict=True):
        np.testing.assert_allclose(one.shape.tip, other.shape.tip, rtol=1e-9)
        assert one.chamber_pressure == other.chamber_pressure


def test_time_that_goes_on_after_a_pause_is_time():
    creeping = estimator_with(CREEPING, wrench_required=False)
    path = [pressure(1, 10e3), pressure(1.1, 40e3), pressure(HOUR, 40e3)]
    state, outcomes = fed(creeping, *path, pressure(HOUR + 0.1, 41e3), pressure(HOUR - 5.0))
    assert state.resets == 1
    assert state.before is None
    assert not state.rejected
    assert outcomes[3].warnings == ()


# Zero of the pressure sensor


def at_rest(*values: float) -> tuple[PressureReading, ...]:
    return tuple(pressure(index + 1, value) for index, value in enumerate(values))


def zero_of(estimator, readings):
    """Give the zero of the sensor of an estimator."""
    return pressure_zero(estimator.arm, estimator.settings.pressure, readings)


def test_the_zero_is_what_cancels_the_mean():
    offset, sentence = pressure_zero(
        PLAIN.arm, PLAIN.settings.pressure, at_rest(120, 130, 125, 124, 126)
    )
    assert offset == pytest.approx(-125.0)
    assert '5 readings' in sentence


def test_the_zero_of_an_absolute_sensor_is_above_ambient():
    absolute = estimator_with(pressure_reference='absolute', ambient_pressure=95e3)
    offset, _ = zero_of(absolute, at_rest(*5 * [95_200.0]))
    assert offset == pytest.approx(-200.0)


@pytest.mark.parametrize(
    ('values', 'number'),
    [
        ((), ' 0 '),
        ((1, 2, 3, 4), ' 4 '),
        ((0, 0, 0, 0, 661), '661 Pa'),
        (5 * (2001,), '-2001'),
        (5 * (-3181,), '3181'),
    ],
)
def test_there_is_no_zero_without_a_vented_arm_at_rest(values, number):
    offset, why = zero_of(PLAIN, at_rest(*values))
    assert offset is None
    assert number in why


def test_an_absolute_sensor_far_from_zero_is_a_matter_of_the_air():
    absolute = estimator_with(pressure_reference='absolute', ambient_pressure=101_325.0)
    offset, why = zero_of(absolute, at_rest(*5 * [95_200.0]))
    assert offset is None
    assert '95200' in why


@pytest.mark.parametrize(('reach', 'largest'), [(3e3, 600.0), (66e3, 2e3)])
def test_the_largest_zero_is_the_smaller_of_the_two_priors(monkeypatch, reach, largest):
    expected = ExpectedPressure(low=0.0, high=reach)
    monkeypatch.setattr(pressure_tare, 'expected_of', lambda arm: expected)
    assert zero_of(PLAIN, at_rest(*5 * [largest - 1.0]))[0] == 1.0 - largest
    assert zero_of(PLAIN, at_rest(*5 * [largest + 1.0]))[0] is None


# How sure it is


def test_the_jacobian_is_that_of_the_equilibrium_and_of_finite_differences():
    estimate = last(PLAIN, wrench(1), pressure(1))
    shape = solve(ARM, PRESSURE, FORCE, MOMENT)
    np.testing.assert_allclose(estimate.jacobian, tip_jacobian(ARM, shape), rtol=1e-8, atol=1e-14)
    base = np.array([PRESSURE, *FORCE, MOMENT])
    for column, step in enumerate((5.0, 1e-4, 1e-4, 1e-6)):
        tips = []
        for moved in (base + step * np.eye(4)[column], base - step * np.eye(4)[column]):
            tips.append(solve(ARM, moved[0], (moved[1], moved[2]), moved[3], shape).tip)
        slope = np.subtract(*tips) / (2.0 * step)
        np.testing.assert_allclose(estimate.jacobian[:, column], slope, rtol=1e-4, atol=1e-9)


QUANTITIES = (
    'moment_law.rigidity.2.1',
    'intrinsic_curvature.curvature.5.4',
    'arm.clamp_angle',
    'moment_law.moment_offset.2.0',
)
FACTOR = np.array([[1e-3, 5e-4], [0.15, -0.1], [4e-3, 0.0], [0.0, 2e-3]])
DRAWS = 800


def sampled(arm, draws: int = DRAWS):
    """Draw tips (draws, 3) and x, y, curvature (draws, 3, stations) of random arms and loads.

    Each quantity is moved by its own factor, so that nothing of the estimator's algebra is used.
    """
    random = np.random.default_rng(20)
    start = solve(arm, PRESSURE, FORCE, MOMENT)
    tips, shapes = [], []
    for _ in range(draws):
        drawn = arm
        if arm.covariance is not None:
            amounts = arm.covariance.factor @ random.normal(size=arm.covariance.factor.shape[1])
            drawn = arm.with_changes(dict(zip(arm.covariance.quantities, amounts, strict=True)))
        noise = random.normal(size=4) * [60.0, 1e-3, 1e-3, 1e-5]
        shape = solve(
            drawn,
            PRESSURE + noise[0],
            (FORCE[0] + noise[1], FORCE[1] + noise[2]),
            MOMENT + noise[3],
            start,
        )
        tips.append(shape.tip)
        shapes.append((shape.x, shape.y, shape.curvature))
    return np.array(tips), np.array(shapes)


@pytest.mark.parametrize(
    'covariance',
    [None, ModelCovariance(quantities=QUANTITIES, factor=FACTOR)],
    ids=['sensors', 'sensors-and-model'],
)
def test_the_uncertainty_is_the_scatter_of_drawn_arms_and_readings(covariance):
    arm = replace(ARM, covariance=covariance)
    estimate = last(estimator_with(arm), wrench(1), pressure(1))
    tips, shapes = sampled(arm)
    std = np.sqrt(np.diag(estimate.tip_covariance))
    np.testing.assert_allclose(
        np.cov(tips.T) / np.outer(std, std),
        estimate.tip_covariance / np.outer(std, std),
        atol=5.0 / math.sqrt(DRAWS),
    )
    scatter = shapes.std(axis=0)
    claimed = np.array([estimate.std_x, estimate.std_y, estimate.std_curvature])
    np.testing.assert_allclose(claimed[:2, 0], 0.0, atol=1e-12)  # the clamp stands still
    near = 4.0 / math.sqrt(2 * DRAWS)
    np.testing.assert_allclose(claimed[2], scatter[2], rtol=near)
    np.testing.assert_allclose(claimed[:2], scatter[:2], rtol=near, atol=2e-7)


def test_a_column_of_the_model_adds_what_one_sigma_of_it_does():
    std = 3e-4  # m, of the length
    uncertain = replace(
        ARM, covariance=ModelCovariance(quantities=('arm.length',), factor=[[std]])
    )
    sensors = last(PLAIN, wrench(1), pressure(1)).tip_covariance
    both = last(estimator_with(uncertain), wrench(1), pressure(1)).tip_covariance
    longer, shorter = (
        solve(ARM.with_changes({'arm.length': step}), PRESSURE, FORCE, MOMENT).tip
        for step in (1e-6, -1e-6)
    )
    moved = std * np.subtract(longer, shorter) / 2e-6
    np.testing.assert_allclose(both - sensors, np.outer(moved, moved), rtol=1e-3)


def test_the_free_end_is_as_sure_as_the_tip_also_where_the_arm_is_straight_and_free():
    # The sensitivity at stations was once a difference, whose step lost its way at rest.
    state = EstimatorState()
    for count in range(8):
        at, value = 1.0 + 0.1 * count, max(1000.0 - 250.0 * count, 0.0)
        state, _ = PLAIN.step(state, wrench(at, force=(0.0, 0.0), moment=0.0))
        state, estimate = PLAIN.step(state, pressure(at, value))
        variances = [estimate.std_x[-1] ** 2, estimate.std_y[-1] ** 2]
        tip = np.diag(estimate.tip_covariance)[:2]
        np.testing.assert_allclose(variances, tip, rtol=1e-9, atol=1e-16)
        assert np.all(np.diff(estimate.std_y) >= 0.0)
        assert estimate.std_curvature.max() < 2.0


def test_the_variance_of_a_message_counts_instead_of_the_models():
    def covariance_with(variance: float):
        return linear_covariance(last(PLAIN, wrench(1), pressure(1, variance=variance)))

    column = last(PLAIN, wrench(1), pressure(1)).jacobian[:, 0]
    added = covariance_with(500.0**2) - covariance_with(0.0)
    np.testing.assert_allclose(
        added, (500.0**2 - 60.0**2) * np.outer(column, column), rtol=1e-6, atol=1e-16
    )
    np.testing.assert_array_equal(covariance_with(-1.0), covariance_with(0.0))


def test_a_gain_in_the_model_scales_what_an_error_of_the_reading_means():
    arm = replace(ARM, effects=(EFFECTS['pressure_gain'](gain=1.1),))
    gained = last(estimator_with(arm, wrench_required=False), pressure(1, PRESSURE / 1.1))
    plain = last(UNLOADED, pressure(1))
    np.testing.assert_allclose(
        linear_covariance(gained), 1.21 * linear_covariance(plain), rtol=1e-6
    )


# Settings


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('stations', 1, 'out_of_bounds'),
        ('stations', 2001, 'out_of_bounds'),
        ('wrench_timeout', 0.0, 'out_of_bounds'),
        ('wrench_timeout', math.nan, 'out_of_bounds'),
        ('input_timeout', 4000.0, 'out_of_bounds'),
        ('pressure_reference', 'relative', 'unknown_kind'),
        ('ambient_pressure', 10.0, 'out_of_bounds'),
        ('pressure_offset', math.inf, 'out_of_bounds'),
        ('wrench_sign', 0, 'unknown_kind'),
        ('wrench_yaw', 90.0, 'out_of_bounds'),
        ('frame_id', '', 'empty'),
    ],
)
def test_a_setting_outside_its_declaration_is_refused_by_name(name, value, reason):
    with refused(RequestError, reason) as caught:
        EstimatorSettings(**{name: value})
    assert name in str(caught.value)


def test_every_setting_says_what_it_means():
    for item in fields(EstimatorSettings):
        assert item.metadata['meaning'], item.name


# Branches


def column_estimator() -> Estimator:
    """Make a column that pressure bends one way or the other, to be pushed till it buckles."""
    bent = IntrinsicCurvature(
        pressure=[-50e3, 50e3], arclength=[0.0, 1.0], curvature=[[-10.0, -10.0], [10.0, 10.0]]
    )
    arm = replace(
        ARM,
        intrinsic_curvature=bent,
        moment_law=LinearLaw(bending_stiffness=1e-3),
        effects=(),
        domain=None,
    )
    return estimator_with(arm)


def test_a_wrench_that_changes_is_the_less_sure_the_older_it_is():
    estimator = estimator_with(load_model(share_path('config/lab_arm.yaml')))
    loads = {at: (0.03, 0.3 * (at - 1.0)) for at in (1.0, 1.1, 1.15)}
    readings = [wrench(1.0, loads[1.0], 0.0), wrench(1.1, loads[1.1], 0.0)]
    old = last(estimator, *readings, pressure(1.15))
    true = last(estimator, *readings, wrench(1.15, loads[1.15], 0.0), pressure(1.15))
    error = np.subtract(old.shape.tip[:2], true.shape.tip[:2])
    size = error @ np.linalg.solve(old.tip_covariance[:2, :2], error)
    assert 0.5 < size < 2.0  # one sigma, of a load that goes on as before
    assert error @ np.linalg.solve(true.tip_covariance[:2, :2], error) > 50.0
    at_rest = [wrench(at, loads[1.1], 0.0) for at in (1.0, 1.1, 1.15)]
    rested = [last(estimator, *at_rest[:number], pressure(1.15)) for number in (2, 3)]
    np.testing.assert_array_equal(rested[0].tip_covariance, rested[1].tip_covariance)


def test_a_moving_arm_feels_the_wrenches_between_its_pressures():
    arm = replace(load_model(share_path('config/lab_arm.yaml')), motion=Motion(damping_time=0.02))
    estimator = estimator_with(arm)
    often = rarely = EstimatorState()
    for step in range(61):
        at = 1.0 + 0.01 * step
        force = wrench(at, (0.03, 0.08 if 33 <= step < 39 else 0.03), 0.0)
        often, _ = estimator.step(often, force)
        often, fine = estimator.step(often, pressure(at))
        rarely, _ = estimator.step(rarely, force)
        if step % 20 == 0:
            rarely, coarse = estimator.step(rarely, pressure(at))
        if step == 40:
            tips = [np.array(one.shape.tip[:2]) for one in (fine, coarse)]
    at_rest = np.array(solve(arm, PRESSURE, (0.03, 0.03)).tip[:2])
    assert np.linalg.norm(tips[0] - at_rest) > 0.01  # it swings
    np.testing.assert_allclose(tips[1], tips[0], atol=5e-4)
    assert not coarse.motion.settled


def test_a_buckled_arm_stays_on_its_side():
    column = column_estimator()
    buckling = (math.pi / 2.0) ** 2 * 1e-3 / ARM.length**2
    push = (-1.3 * buckling, 0.0)
    for side in (1.0, -1.0):
        _, outcomes = fed(
            column,
            wrench(1, push, 0.0),
            pressure(1, side * 5e3),
            pressure(1.1, side * 1e3),
            pressure(1.2, -side * 1e3),  # alone, it would bend to the other side
        )
        cold = solve(column.arm, -side * 1e3, push)
        tips = [outcome.shape.tip[1] for outcome in outcomes[1:]]
        assert all(side * tip > 0.02 for tip in tips)
        assert side * cold.tip[1] < -0.02
        assert outcomes[-1].shape.stable


def test_an_uncertain_gain_spreads_the_tip_like_an_uncertain_pressure():
    gain = EFFECTS['pressure_gain'](gain=1.1)
    covariance = ModelCovariance(quantities=('effects.pressure_gain.gain',), factor=[[0.02]])
    quiet = replace(ARM.sensors, pressure_std=0.0, force_std=0.0, moment_std=0.0)
    arm = replace(ARM, effects=(gain,), sensors=quiet, covariance=covariance)
    settings = EstimatorSettings(wrench_required=False)
    reading = PressureReading(stamp_ns=1, pressure=20e3)
    _, estimate = Estimator(arm=arm, settings=settings).step(EstimatorState(), reading)
    expected = estimate.jacobian[:, 0] * 20e3 * 0.02
    np.testing.assert_allclose(
        linear_covariance(estimate), np.outer(expected, expected), rtol=1e-6, atol=1e-15
    )


def test_a_covariance_at_the_bound_of_a_quantity_is_used_on_the_side_that_is_allowed():
    effect = EFFECTS['clamp_compliance']()
    name = 'effects.clamp_compliance.compliance'
    arms = [
        replace(
            ARM, effects=(effect,), covariance=ModelCovariance(quantities=(name,), factor=[[s]])
        )
        for s in (2.0, -2.0)
    ]
    readings = (
        WrenchReading(
            stamp_ns=1, force_x=0.175, force_y=0.07, moment=0.0, frame_id='pneunet_base'
        ),
        PressureReading(stamp_ns=1, pressure=31e3),
    )
    spreads = []
    for arm in arms:
        state = EstimatorState()
        for reading in readings:
            state, estimate = Estimator(arm=arm).step(state, reading)
        spreads.append(estimate.tip_covariance)
    np.testing.assert_allclose(spreads[0], spreads[1], rtol=1e-6)

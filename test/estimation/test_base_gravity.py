"""Gravity as an accelerometer on the base or a frame of tf says it, and what is no gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros import solve
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.frame_tree import FrameTree
from pneunet_ros.core.frames import BASE_FRAME, quaternion_of_angles, rotation_matrix
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import FrameReading, ImuReading, PressureReading
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.effects.creep import Creep
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.model.uncertainty import ModelCovariance
from pneunet_ros.solver.columns import LOAD_Y
import pytest
from support.example_arms import heavy
from support.refusals import refused

G = STANDARD_GRAVITY
MS = 1_000_000


def imu(x: float, y: float, z: float, at: int = 1, **changes: object) -> ImuReading:
    """Return a reading of an accelerometer in the base frame; at: ms."""
    given = {'frame_id': BASE_FRAME, **changes}
    return ImuReading(stamp_ns=at * MS, x=x, y=y, z=z, **given)  # type: ignore[arg-type]


def pressure(at: int, value: float = 31e3) -> PressureReading:
    """Return a reading of the pressure; at: ms."""
    return PressureReading(stamp_ns=at * MS, pressure=value)


def turned(child: str, parent: str, angles: tuple[float, float, float], at: int = 0, **changes):
    """Return how a frame is turned in another by roll, pitch, yaw (rad); at: ms, 0: for ever."""
    given = {'quaternion': quaternion_of_angles(*angles), 'fixed': at == 0, **changes}
    return FrameReading(stamp_ns=at * MS, frame_id=child, parent=parent, **given)


def estimator(direction: object = 'out_of_plane', **settings: object) -> Estimator:
    """Return an estimator of the paper's arm with a mass at its tip."""
    arm = heavy(direction)
    return Estimator(
        arm=replace(arm, motion=None),
        settings=EstimatorSettings(wrench_required=False, **settings),  # type: ignore[arg-type]
    )


def run(of: Estimator, *readings: object) -> tuple[EstimatorState, list[object]]:
    """Feed readings."""
    state, outcomes = EstimatorState(), []
    for reading in readings:
        state, outcome = of.step(state, reading)  # type: ignore[arg-type]
        outcomes.append(outcome)
    return state, outcomes


def last(of: Estimator, *readings: object) -> object:
    """Return what came of the last reading."""
    return run(of, *readings)[1][-1]


@pytest.mark.parametrize('down', [[0.0, -1.0], [0.6, -0.8], [0.3, 0.2]])
def test_a_base_that_rests_hangs_as_a_fixed_direction_says(down):
    out = -np.sqrt(max(1.0 - down[0] ** 2 - down[1] ** 2, 0.0))
    found = last(estimator(), imu(-G * down[0], -G * down[1], -G * out), pressure(2))
    expected = last(estimator(down), pressure(2))
    assert isinstance(found, ShapeEstimate)
    assert found.gravity == pytest.approx(down, abs=1e-12)
    assert found.shape.tip == pytest.approx(expected.shape.tip, abs=1e-12)
    assert found.tip_covariance == pytest.approx(expected.tip_covariance, rel=1e-9)
    assert found.jacobian == pytest.approx(expected.jacobian, rel=1e-9)


def test_a_base_that_accelerates_pulls_the_arm_the_other_way():
    # Upwards at 3 m/s^2: the arm is as heavy as at 12.8 m/s^2.
    found = last(estimator(), imu(0.0, G + 3.0, 0.0), pressure(2))
    heavier = replace(heavy([0.0, -1.0]), motion=None)
    pulls = (1.0 + 3.0 / G) * heavier.weight / heavier.length
    rods = heavier.rods(np.array([31e3]), gravity=np.array([found.gravity]))
    assert found.gravity == pytest.approx((0.0, -1.0 - 3.0 / G))
    assert rods.sections[0, :, LOAD_Y] == pytest.approx(-pulls, rel=1e-12)
    assert found.shape.tip[1] < solve(heavier, 31e3).tip[1]


def test_gravity_that_turns_is_the_less_sure_the_older_its_reading():
    of = estimator(judge_readings=False)
    rolls = {at: 0.002 * at for at in (100, 200, 250)}
    read = {at: imu(0.0, G * np.sin(roll), G * np.cos(roll), at) for at, roll in rolls.items()}
    old = last(of, read[100], read[200], pressure(250))
    true = last(of, read[100], read[200], read[250], pressure(250))
    error = np.subtract(old.shape.tip[:2], true.shape.tip[:2])
    sigmas = [np.sqrt(np.diag(one.tip_covariance)[:2]) for one in (old, true)]
    size = np.abs(error) / sigmas[0]
    assert np.all((size > 0.7) & (size < 1.4))  # one sigma, of a base that turns on as before
    assert np.linalg.norm(error / sigmas[1]) > 5.0
    assert old.std_y[-1] == pytest.approx(sigmas[0][1])


def test_what_effects_add_stays_beside_a_measured_direction():
    """Also the neighbors by which errors are carried: with the way of every table."""
    for effects in ((), (Creep(amplitude=0.2, time_constant=60.0), LoadOffset(offset=2e-3))):
        arm = replace(heavy([0.0, -1.0]), effects=effects, divided=())
        std = ModelCovariance(quantities=('arm.weight', 'gravity.x'), factor=np.diag([1e-3, 1e-2]))
        settings = EstimatorSettings(wrench_required=False)
        still, sideways = (
            Estimator(arm=replace(arm, gravity=gravity_of(way), covariance=std), settings=settings)
            for way in ([0.0, -0.9], [0.5, 0.5])
        )
        found = last(sideways, imu(0.0, 0.9 * G, 0.0), pressure(2))
        expected = last(still, pressure(2))
        assert found.shape.tip == pytest.approx(expected.shape.tip, abs=1e-9)
        # It swings about another unloaded shape.
        assert found.tip_covariance == pytest.approx(expected.tip_covariance, rel=1e-3)


def test_the_frame_of_the_imu_is_turned_by_tf_or_by_a_setting():
    angles = (0.3, -0.2, 1.1)
    force = rotation_matrix(quaternion_of_angles(*angles)).T @ np.array([0.0, G, 0.0])
    reading = imu(*force.tolist(), frame_id='imu_link')
    by_tf = last(
        estimator(), (turned('imu_link', 'plate', angles), turned('plate', BASE_FRAME, (0, 0, 0))),
        reading, pressure(2),
    )  # fmt: skip
    by_setting = last(estimator(imu_from_base='0.3 -0.2, 1.1'), reading, pressure(2))
    numbers = ', '.join(map(repr, quaternion_of_angles(*angles)))
    by_quaternion = last(estimator(imu_from_base=numbers), reading, pressure(2))
    for found in (by_tf, by_setting, by_quaternion):
        assert found.gravity == pytest.approx((0.0, -1.0), abs=1e-12)
    with refused(RequestError, 'wrong_form'):
        EstimatorSettings(imu_from_base='0, 0, 0, 0')


def test_a_frame_whose_z_points_up_is_followed():
    of = estimator(gravity_frame='world')
    # The base in the world, its y up: z of the world is y of the base.
    up = turned(BASE_FRAME, 'tool', (0.0, 0.0, 0.0)), turned('tool', 'world', (np.pi / 2, 0, 0), 5)
    found = last(of, (up[0],), (up[1],), pressure(6))
    assert found.gravity == pytest.approx((0.0, -1.0), abs=1e-12)
    state, outcomes = run(of, pressure(1), (up[0],), (up[1],), pressure(600))
    assert [one.reason for one in (outcomes[0], outcomes[-1])] == [
        'no_gravity_frame',
        'stale_gravity_frame',
    ]
    assert outcomes[0].awaits_others
    assert 'world' in outcomes[0].sentence
    assert state.rejected == {'no_gravity_frame': 1, 'stale_gravity_frame': 1}


@pytest.mark.parametrize(
    ('reading', 'reason'),
    [
        (imu(0.0, 1.0, 0.02), 'imu_unit'),
        (imu(0.0, 1000.0, 0.0), 'imu_unit'),
        (imu(0.0, 0.0, 0.01), 'imu_unit'),
        (imu(0.0, G, 0.0, frame_id='imu_link'), 'imu_frame'),
        (imu(0.0, G, 0.0, known=False), 'imu_without_acceleration'),
    ],
)
def test_an_imu_that_means_something_else_stops_estimates_with_its_reason(reading, reason):
    state, outcomes = run(estimator(), reading, pressure(2))
    assert isinstance(outcomes[0], Refusal)
    assert [one.reason for one in outcomes] == [reason, 'no_imu']
    assert state.rejected == {reason: 1, 'no_imu': 1}
    # Whoever says where gravity points does without.
    fixed = replace(estimator().arm, gravity=gravity_of([0.0, -1.0], fixed=True))
    of = Estimator(arm=fixed, settings=EstimatorSettings(wrench_required=False))
    assert isinstance(last(of, reading, pressure(2)), ShapeEstimate)


NAN = float('nan')


@pytest.mark.parametrize(
    ('bad', 'reason'),
    [
        (imu(0.0, NAN, 0.0, at=2), 'not_finite'),
        (imu(0.0, G, 0.0, at=1), 'duplicate'),
        (imu(0.0, G, 0.0, at=0), 'no_stamp'),
    ],
)
def test_a_bad_reading_alone_is_left_out(bad, reason):
    _, outcomes = run(estimator(), imu(0.0, G, 0.0), bad, pressure(3))
    assert outcomes[1].reason == reason
    assert not outcomes[1].error
    assert outcomes[2].gravity == pytest.approx((0.0, -1.0))


@pytest.mark.parametrize('bad', [imu(0.0, NAN, 0.0), imu(0.0, G, 0.0, at=0)])
def test_an_imu_that_was_never_usable_is_not_replaced_by_the_model(bad):
    _, outcomes = run(estimator(), bad, pressure(2), imu(0.0, G, 0.0, at=3), pressure(4))
    assert (outcomes[1].reason, outcomes[1].error) == ('no_imu', True)
    assert outcomes[3].gravity == pytest.approx((0.0, -1.0))


def test_after_a_reset_an_imu_is_awaited_rather_than_replaced_by_the_model():
    # The pressure of the second lap of a bag comes before the first Imu of it.
    readings = imu(0.0, G, 0.0, at=5000), pressure(5001), pressure(2)
    state, outcomes = run(estimator(), *readings)
    assert state.resets == 1
    assert outcomes[-1].reason == 'no_imu'
    _, again = run(estimator(), *readings, imu(0.0, G, 0.0, at=3), pressure(4))
    assert again[-1].gravity == pytest.approx((0.0, -1.0))
    # Where there was none, none is awaited.
    assert isinstance(last(estimator(), pressure(5001), pressure(2)), ShapeEstimate)


def test_what_was_wrong_with_an_imu_is_not_said_of_its_silence():
    _, outcomes = run(estimator(), imu(0.0, G, 0.0), imu(0.0, 1.0, 0.0, at=2), pressure(900))
    assert [one.reason for one in outcomes[1:]] == ['imu_unit', 'stale_imu']


def test_an_imu_that_falls_silent_or_never_speaks():
    _, outcomes = run(estimator(), imu(0.0, G, 0.0), pressure(2), pressure(900), pressure(901))
    assert [one.reason for one in outcomes[2:]] == ['stale_imu'] * 2
    _, outcomes = run(estimator('imu'), pressure(1), imu(0.0, G, 0.0, at=2), pressure(3))
    assert outcomes[0].reason == 'no_imu'
    assert outcomes[0].awaits_others
    assert isinstance(outcomes[2], ShapeEstimate)
    assert isinstance(last(estimator(), pressure(1)), ShapeEstimate)


def test_frames_that_never_move_outlive_a_new_start_of_time():
    of = estimator()
    link = turned('imu_link', BASE_FRAME, (0.0, 0.0, 0.0))
    reading = imu(0.0, G, 0.0, at=5000, frame_id='imu_link')
    again = imu(0.0, G, 0.0, at=2, frame_id='imu_link')
    state, outcomes = run(of, (link,), reading, pressure(5001), pressure(3), again, pressure(4))
    assert state.resets == 1
    assert isinstance(outcomes[-1], ShapeEstimate)
    assert outcomes[-1].gravity == pytest.approx((0.0, -1.0))


def test_frames_in_a_circle_and_rotations_that_are_none():
    of = estimator(gravity_frame='world')
    circle = turned('a', 'b', (0, 0, 0)), turned('b', 'a', (0, 0, 0))
    flat = turned('world', BASE_FRAME, (0, 0, 0), quaternion=(0.0, 0.0, 0.0, 0.0))
    _, outcomes = run(of, circle, (flat,), pressure(1))
    assert [one.reason for one in outcomes[1:]] == ['no_rotation', 'no_gravity_frame']


def test_a_transform_stamped_ahead_costs_no_reading_for_good():
    def after(tree: FrameTree, at: int) -> FrameTree:
        return tree.after([turned('base', 'world', (0.0, 0.0, 0.0), at=at)])

    ahead = after(after(FrameTree(), 1_000), 3_600_000)
    assert ahead.frames['base'].stamp_ns == 3_600_000 * MS
    again = after(ahead, 1_010)
    assert again.frames['base'].stamp_ns == 1_010 * MS
    late = after(again, 1_005)  # two ways to here, of which one is slower
    assert late.frames['base'].stamp_ns == 1_010 * MS


@pytest.mark.parametrize('mounted', ['', '0, 1.5707963267948966, 0'])
def test_the_turn_rate_is_about_the_normal_of_the_bending_plane(mounted):
    about = (0.0, 0.0, 0.7) if not mounted else (-0.7, 0.0, 0.0)
    of = estimator(imu_from_base=mounted)
    state, _ = run(of, imu(G, 0.0, 0.0, rate=about))
    assert of.gravity.turn_rate_at(state.gravity, 2 * MS) == pytest.approx(0.7)
    assert np.isnan(of.gravity.turn_rate_at(state.gravity, 2000 * MS))  # too old
    state, _ = run(of, imu(G, 0.0, 0.0))
    assert np.isnan(of.gravity.turn_rate_at(state.gravity, 2 * MS))

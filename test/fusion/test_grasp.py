"""What a gripper holds, from solved arms whose truth is known; and how it is closed."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.readings import PressureReading, TargetSightings
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.pressure_gain import PressureGain
from pneunet_ros.fusion.closing import Closing, GripCommand, is_reached, reach_of
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.grasp import Gripper, mount_of, seen_arm
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.messages.gripper import GRASP_POINT, grasp_point, mount_transforms
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
import pytest
from support.refusals import refused

APART, THICKNESS = 0.045, 0.006  # m
PRESSURE, PUSH = 45e3, 0.03  # Pa, N
FRAMES = 5
NAMES = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')


@pytest.fixture(scope='module')
def fusion():
    return Fusion(arm=load_model(share_path('config/lab_arm.yaml')))


def seen_at(fusion, force, seed):
    """Return the true shape, and an arm at its last frame, under a tip force (2,) N."""
    random, targets = np.random.default_rng(seed), fusion.arm.target_arclength
    noise = fusion.arm.sensors.target_std
    shape = solve(fusion.arm, pressure=PRESSURE, force=force)
    state, nothing = FusionState(), np.full(targets.size, np.nan)
    for frame in range(FRAMES):
        stamp = 1_000_000_000 + 33_000_000 * frame
        x, y = (
            np.interp(targets, shape.arclength, row) + noise * random.standard_normal(targets.size)
            for row in (shape.x, shape.y)
        )
        event = TargetSightings(stamp_ns=stamp, x=x, y=y, **dict.fromkeys(NAMES, nothing))
        state, _ = fusion.step(state, event)
        state, _ = fusion.step(state, PressureReading(stamp_ns=stamp, pressure=PRESSURE))
        state = fusion.settle(state)
    return shape, seen_arm(fusion, state)


def around(count):
    """Return a gripper of so many arms about the axis x, bent towards it."""
    mounts = {}
    for index in range(count):
        roll = 2.0 * math.pi * index / count
        place = [0.0, -APART * math.cos(roll), -APART * math.sin(roll), roll, 0.0, 0.0]
        mounts[f'arm_{index}'] = mount_of(place, THICKNESS)
    return Gripper(mounts=mounts)


@pytest.fixture(scope='module')
def pushed(fusion):
    return [seen_at(fusion, (0.0, -PUSH), seed) for seed in range(3)]


@pytest.fixture(scope='module')
def free(fusion):
    return [seen_at(fusion, (0.0, 0.0), seed) for seed in range(2)]


@pytest.mark.parametrize('count', [2, 3])
def test_arms_that_are_pushed_hold_something(count, pushed):
    gripper = around(count)
    seen = {f'arm_{index}': pushed[index][1] for index in range(count)}
    grasp, reached = gripper.grasp(seen), pushed[0][0].y.max()
    assert grasp.touching == count
    assert abs(grasp.width - 2.0 * (APART - reached - THICKNESS)) < 4.0 * grasp.std_width + 1e-5
    assert grasp.std_width < 5e-4
    assert abs(grasp.force - count * PUSH) < 4.0 * grasp.std_force
    assert np.all(np.abs(grasp.balance) < 4.0 * grasp.std_balance + 1e-6)
    assert np.abs(grasp.center[1:]).max() < 5e-4


def test_free_arms_have_an_opening_and_no_force(free):
    grasp = around(2).grasp({f'arm_{index}': free[index][1] for index in range(2)})
    assert (grasp.touching, grasp.force) == (0, 0.0)
    assert abs(grasp.width - 2.0 * (APART - free[0][0].tip[1] - THICKNESS)) < 5e-4


def test_one_push_is_out_of_balance(free, pushed):
    grasp = around(2).grasp({'arm_0': pushed[0][1], 'arm_1': free[1][1]})
    assert grasp.touching == 1
    assert grasp.balance[1] == pytest.approx(PUSH, rel=0.1)  # on the object, away from the arm


def test_the_message_holds_it_all(pushed):
    grasp = around(2).grasp({f'arm_{index}': pushed[index][1] for index in range(2)})
    (point,) = grasp_point(grasp)
    assert point.dtype == GRASP_POINT and point['touching'] == 2
    assert (point['width'], point['force']) == (grasp.width, grasp.force)
    assert point['balance_y'] == grasp.balance[1] and point['std_force'] == grasp.std_force
    assert point['x'] == np.float32(grasp.center[0])


def test_a_mount_is_the_origin_of_a_urdf():
    mount = mount_of([0.1, 0.2, 0.3, 0.3, -0.4, 0.5], THICKNESS)
    assert mount.origin.tolist() == [0.1, 0.2, 0.3]
    assert np.allclose(mount.axes @ mount.axes.T, np.eye(3))
    turned = mount_of([0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * math.pi], THICKNESS)
    assert np.allclose(turned.axes[:, 0], [0.0, 1.0, 0.0])  # yaw turns x to y


def test_transforms_turn_as_the_mounts_do():
    from scipy.spatial.transform import Rotation

    places = {'one': [0.1, 0.2, 0.3, 0.3, -0.4, 0.5], 'turned': [0.0] * 3 + [math.pi, 0.0, 0.0]}
    mounts = {name: mount_of(place, THICKNESS) for name, place in places.items()}
    message = mount_transforms(mounts, 'hand', ROSBAGS_TYPES)
    for one, (name, mount) in zip(message.transforms, mounts.items(), strict=True):
        assert (one.header.frame_id, one.child_frame_id) == ('hand', name)
        turn, move = one.transform.rotation, one.transform.translation
        assert np.allclose(
            Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), mount.axes
        )
        assert [move.x, move.y, move.z] == mount.origin.tolist()


@pytest.mark.parametrize('place', [[0.0] * 5, [0.0] * 5 + [math.nan], ['a'] * 6, 3.0])
def test_what_is_no_mount_is_refused(place):
    with refused(RequestError, 'wrong_shape'):
        mount_of(place, THICKNESS)


@pytest.mark.parametrize(
    'turns',
    [
        [(0.0, 0.0, 0.0)],
        [(0.0, 0.0, 0.0), (0.0, 0.0, math.pi)],  # opposite ways
    ],
)
def test_what_is_no_gripper_is_refused(turns):
    mounts = {str(at): mount_of([0.0] * 3 + [*turn], 0.0) for at, turn in enumerate(turns)}
    with pytest.raises(RequestError):
        Gripper(mounts=mounts)


@pytest.fixture(scope='module')
def closing(fusion):
    gripper = around(2)
    reaches = {
        name: reach_of(fusion.arm, mount, gripper.inward(name))
        for name, mount in gripper.mounts.items()
    }
    return Closing(gripper=gripper, reaches=reaches, rate=20e3, gain=3.0)


def test_the_model_knows_the_pressure_of_a_width(closing, fusion):
    for name, place in closing.places(0.05).items():
        pressure = closing.reaches[name].pressure_for(place)
        reached = solve(fusion.arm, pressure=pressure).tip[1]
        assert 2.0 * (APART - reached - THICKNESS) == pytest.approx(0.05, abs=2e-4)


def test_the_pressure_of_a_width_is_that_which_the_sensor_reads(closing, fusion):
    (name, mount), *_ = closing.gripper.mounts.items()
    effects = (PressureGain(gain=1.25),)
    arm = replace(fusion.arm, effects=effects, covariance=None)
    known = closing.reaches[name]
    read = reach_of(arm, mount, closing.gripper.inward(name))
    assert read.pressure == pytest.approx(known.pressure / 1.25)
    assert read.inward == pytest.approx(known.inward, abs=1e-9)


def test_free_arms_go_towards_the_width_no_faster_than_the_rate(closing, free):
    seen = {f'arm_{index}': free[index][1] for index in range(2)}
    width = around(2).grasp(seen).width
    for wanted, change in ((width - 0.02, 2e3), (width + 0.02, -2e3)):
        command = GripCommand(width=wanted, force=0.05)
        once = closing.step(seen, dict.fromkeys(seen, PRESSURE), command, 0.1)
        assert set(once.values()) == {PRESSURE + change}
    there = GripCommand(width=width, force=0.05)
    once = closing.step(seen, dict.fromkeys(seen, PRESSURE), there, 0.1)
    assert max(abs(pressure - PRESSURE) for pressure in once.values()) < 200.0


def test_no_arm_is_pressed_harder_than_wanted(closing, pushed):
    seen = {f'arm_{index}': pushed[index][1] for index in range(2)}
    harder = closing.step(
        seen, dict.fromkeys(seen, PRESSURE), GripCommand(width=0.0, force=2.0 * PUSH), 0.033
    )
    softer = closing.step(
        seen, dict.fromkeys(seen, PRESSURE), GripCommand(width=0.0, force=0.5 * PUSH), 0.033
    )
    assert min(harder.values()) > PRESSURE > max(softer.values())
    now = dict.fromkeys(seen, PRESSURE)
    assert closing.is_stalled(seen, now, GripCommand(width=0.0, force=PUSH), 0.04)
    assert not closing.is_stalled(seen, now, GripCommand(width=0.0, force=1.2 * PUSH), 0.04)
    assert not closing.is_stalled(seen, now, GripCommand(width=0.06, force=PUSH), 0.04)
    for width, end in ((0.0, -1), (0.06, 0)):  # no arm can do more
        ends = {name: float(closing.reaches[name].pressure[end]) for name in seen}
        assert closing.is_stalled(seen, ends, GripCommand(width=width, force=2.0 * PUSH), 0.04)


def test_a_width_is_reached_to_a_tolerance(free):
    grasp = around(2).grasp({f'arm_{index}': free[index][1] for index in range(2)})
    command = GripCommand(width=grasp.width + 0.5e-3, force=0.1)
    assert is_reached(grasp, command, 1e-3) and not is_reached(grasp, command, 1e-4)
    with pytest.raises(RequestError):
        GripCommand(width=math.nan, force=0.1)


def without(seen, *components):
    """Return an arm whose frame does not determine these components of the force."""
    force, covariance = seen.fused.force.copy(), seen.fused.force_covariance.copy()
    force[[*components]] = covariance[[*components]] = covariance[:, [*components]] = np.nan
    return replace(seen, fused=replace(seen.fused, force=force, force_covariance=covariance))


def turned(yaw):
    """Return a gripper of two arms whose clamps are turned towards each other (rad)."""
    places = {'arm_0': [0.0, -APART, 0.0, 0.0, 0.0, yaw], 'arm_1': [0.0, APART] + [0.0] * 4}
    places['arm_1'][3:] = [math.pi, 0.0, -yaw]
    return Gripper(mounts={name: mount_of(place, THICKNESS) for name, place in places.items()})


@pytest.mark.parametrize('yaw', [0.0, 0.05, 0.3])
def test_a_push_is_felt_if_the_force_along_the_arm_is_unknown(yaw, pushed):
    seen = {f'arm_{index}': without(pushed[index][1], 0) for index in range(2)}
    grasp = turned(yaw).grasp(seen)
    assert grasp.touching == 2
    assert grasp.force == pytest.approx(2.0 * PUSH, rel=0.2)
    assert np.isnan(grasp.balance).tolist() == [True, yaw > 0.0, False]
    assert np.array_equal(np.isnan(grasp.std_balance), np.isnan(grasp.balance))


def test_an_unknown_push_is_no_force_of_zero_and_closes_nothing(closing, pushed):
    seen = {f'arm_{index}': without(pushed[index][1], 0, 1) for index in range(2)}
    grasp = around(2).grasp(seen)
    assert math.isnan(grasp.force) and math.isnan(grasp.std_force)
    assert np.isnan(grasp.balance[:2]).all() and np.isnan(grasp.std_balance[:2]).all()
    now, close = dict.fromkeys(seen, PRESSURE), GripCommand(width=-0.2, force=2.0 * PUSH)
    assert closing.step(seen, now, close, 0.033) == now
    assert not closing.is_stalled(seen, now, close, grasp.width)
    assert closing.is_blind(seen, now, close, grasp.width)
    for one, force, blind in ((0, PUSH, True), (1, PUSH, True), (0, 2.0 * PUSH, False)):
        known = seen | {f'arm_{one}': pushed[one][1]}
        softer = GripCommand(width=close.width, force=force)
        assert closing.is_blind(known, now, softer, grasp.width) == blind
    opened = closing.step(seen, now, GripCommand(width=0.09, force=PUSH), 0.033)
    assert not closing.is_blind(seen, now, GripCommand(width=0.09, force=PUSH), grasp.width)
    assert max(opened.values()) < PRESSURE


def test_an_unknown_push_closes_nothing_inside_a_play_gap(closing, pushed):
    fused = without(pushed[0][1], 0, 1).fused
    estimate = replace(fused.estimate, jacobian=np.zeros_like(fused.estimate.jacobian))
    seen = dict.fromkeys(
        ('arm_0', 'arm_1'), replace(pushed[0][1], fused=replace(fused, estimate=estimate))
    )
    now, close = dict.fromkeys(seen, PRESSURE), GripCommand(width=-0.2, force=PUSH)
    assert closing.step(seen, now, close, 0.033) == now


def test_a_free_arm_that_is_turned_closes_although_the_force_along_it_is_unknown(fusion, free):
    seen, gripper = {f'arm_{index}': without(free[index][1], 0) for index in range(2)}, turned(0.1)
    reaches = {
        name: reach_of(fusion.arm, mount, gripper.inward(name))
        for name, mount in gripper.mounts.items()
    }
    closing = Closing(gripper=gripper, reaches=reaches, rate=20e3, gain=3.0)
    close = GripCommand(width=gripper.grasp(seen).width - 0.02, force=0.05)
    once = closing.step(seen, dict.fromkeys(seen, PRESSURE), close, 0.033)
    assert min(once.values()) > PRESSURE

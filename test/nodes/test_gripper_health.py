"""What a gripper reports: arms without frames, frames apart from each other, commands."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from pneunet_ros.core.health import Level
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.gripper.configuration import GripperSettings  # noqa: E402
from pneunet_ros.nodes.gripper.grasping import Grasping  # noqa: E402
from pneunet_ros.nodes.gripper.health import GraspHealth  # noqa: E402

ARMS, HOLD_AFTER = ('left', 'right'), 0.3


def reports(period, alive, *, is_wanted=True):
    """Return the reports of 3 s in which the arms `alive` have a frame every `period` seconds."""
    health, found = GraspHealth(ARMS), []
    for tick in range(300):
        now = 0.01 * tick
        if tick % round(100.0 * period) == 0:
            for arm in alive:
                health.take_frame(arm, now)
            health.grasps += set(alive) == set(ARMS)
        if tick % 100 == 99:
            found.append(health.report(HOLD_AFTER, now, is_wanted=is_wanted))
    return found


def test_an_arm_without_frames_is_named_while_somebody_asks_for_a_grasp():
    assert reports(0.05, ARMS) == [(Level.OK, '')] * 3
    assert reports(0.05, (), is_wanted=False) == [(Level.OK, '')] * 3
    (*_, (level, sentence)) = reports(0.05, ('left',))
    assert level is Level.ERROR
    assert 'right for 2.00 s' in sentence and 'left' not in sentence
    first, second, _ = reports(0.05, ())
    assert first == (Level.OK, '')  # it may have been asked for just now
    assert second[0] is Level.ERROR and 'left' in second[1] and 'right' in second[1]


def test_frames_that_are_too_rare_for_commands_are_a_warning_with_their_period():
    *_, (level, sentence) = reports(0.36, ARMS)
    assert level is Level.WARN
    assert '0.36 s' in sentence and 'hold_after' in sentence


def test_frames_are_missed_from_when_a_grasp_is_wanted():
    health = GraspHealth(ARMS)
    for arm in ARMS:
        health.take_frame(arm, 0.0)
    assert health.report(HOLD_AFTER, 60.0, is_wanted=False) == (Level.OK, '')
    assert health.report(HOLD_AFTER, 61.0, is_wanted=True) == (Level.OK, '')


@pytest.fixture
def grasping():
    """Return the part of a gripper that grasps, with a subscriber and stand-ins for estimates."""
    found = object.__new__(Grasping)
    found.settings = GripperSettings(arms=ARMS, hold_after=HOLD_AFTER)
    found.fusions = dict.fromkeys(ARMS)
    found.seen, found.new, found.grasp, found.command = {}, set(), None, None
    found.health, found.sent, found.warned = GraspHealth(ARMS), [], []
    found.states = SimpleNamespace(get_subscription_count=lambda: 1, publish=found.sent.append)
    found.serializer = SimpleNamespace(bytes_of=lambda output, grasp: grasp)
    grasp = SimpleNamespace(touching=0, width=0.05, std_width=1e-4, force=0.0, std_force=0.0)
    free = SimpleNamespace(force=np.zeros(2))
    found.gripper = SimpleNamespace(
        grasp=lambda seen: grasp, touches=lambda seen: dict.fromkeys(seen, free)
    )
    found.follow = lambda now: None
    found.node = SimpleNamespace(
        log=SimpleNamespace(warn=lambda kind, sentence, now: found.warned.append(sentence))
    )
    return found


def seen_at(seconds):
    """Return an arm at a frame."""
    return SimpleNamespace(fused=SimpleNamespace(stamp_ns=round(1e9 * seconds)))


def test_frames_of_different_times_make_no_grasp(grasping):
    grasping.take_seen('right', seen_at(40.0), 0.0)
    grasping.take_seen('left', seen_at(100.0), 0.0)
    assert not grasping.sent
    report = grasping.report(0.5)
    assert report.level is Level.ERROR and 'right are 60.00 s older' in report.message
    assert 'width_m' not in report.values
    grasping.take_seen('left', seen_at(100.1), 0.6)
    assert not grasping.sent  # until both have a new one
    grasping.take_seen('right', seen_at(100.0), 0.6)
    assert len(grasping.sent) == 1
    report = grasping.report(0.7)
    assert (report.level, report.values['width_m']) == (Level.WARN, '0.05')  # 0.6 s without any
    report = grasping.report(0.8)
    assert (report.level, report.message) == (Level.OK, '')
    assert 'width_m' not in report.values  # it would be that of an earlier second


def test_a_rejected_command_is_counted_and_reported_once(grasping):
    for position, effort in (([0.03, 0.03], []), ([0.03], [float('nan')])):
        grasping.take_command(SimpleNamespace(position=position, effort=effort))
    report = grasping.report(0.0)
    assert report.level >= Level.WARN and 'rejected' in report.message
    assert report.values['commands_rejected'] == '2' and len(grasping.warned) == 2
    report = grasping.report(0.1)
    assert report.message == '' and report.values['commands_rejected'] == '2'


def test_an_arm_that_is_held_because_its_force_is_unknown_is_named(grasping):
    touches = {arm: SimpleNamespace(force=np.zeros(2)) for arm in ARMS}
    touches['right'].force = np.array([np.nan, np.nan])
    grasping.gripper.touches = lambda seen: touches
    grasping.commands, grasping.pressures = {}, dict.fromkeys(ARMS, 1e4)
    grasping.controller = lambda: SimpleNamespace(step=lambda *arguments: {})
    grasping.node.get_clock = lambda: SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0))
    del grasping.follow
    grasping.order(0.0, 0.03)
    grasping.pressures, grasping.commanded_at = dict.fromkeys(ARMS, 1e4), 0.0
    for arm in ARMS:
        grasping.take_seen(arm, seen_at(1.0), 0.1)
    report = grasping.report(0.2)
    assert report.level is Level.WARN
    assert 'right' in report.message and 'left' not in report.message

"""Goals of the action of a gripper, without ROS around them; and an executor that polls for it."""

from __future__ import annotations

import itertools
import math
import os
import time
from types import SimpleNamespace

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.errors import RequestError  # noqa: E402
from pneunet_ros.fusion.closing import GripCommand  # noqa: E402
from pneunet_ros.nodes.gripper import action  # noqa: E402
from pneunet_ros.nodes.gripper.action import GripperGoals, Turn  # noqa: E402
from pneunet_ros.nodes.gripper.configuration import GripperSettings  # noqa: E402
from pneunet_ros.nodes.gripper.grasping import Grasping  # noqa: E402
from pneunet_ros.nodes.gripper.health import GraspHealth  # noqa: E402
from pneunet_ros.nodes.prompt_executor import PromptExecutor  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402

KIND = SimpleNamespace(Result=SimpleNamespace, Feedback=SimpleNamespace)


class Held:
    """What goals ask of the grasp, as it is said here."""

    def __init__(self):
        self.fusions, self.grasp, self.ordered = {'left': None, 'right': None}, None, []
        self.reached = self.stalled = self.blind = self.held = False
        self.command = None

    def order(self, width, force):
        if width < -1.0:
            raise RequestError('no such width')
        self.ordered.append((width, force))
        self.command, self.held = GripCommand(width=width, force=force), False
        return self.command

    def hold(self):
        self.held, self.command = True, None

    def is_reached(self):
        return self.reached

    def is_stalled(self):
        return self.stalled

    def is_blind(self):
        return self.blind

    def see(self, width):
        self.grasp = SimpleNamespace(width=width, force=0.06)


class Handle:
    """A goal, and what becomes of it."""

    def __init__(self, width=0.0, force=0.03):
        self.request = SimpleNamespace(command=SimpleNamespace(position=width, max_effort=force))
        self.is_cancel_requested, self.became, self.told = False, '', []
        self.publish_feedback = self.told.append
        for name in ('abort', 'canceled', 'succeed'):
            setattr(self, name, lambda name=name: setattr(self, 'became', name))


def turn(running):
    """Let a goal go on once; returns its result, None where it goes on."""
    try:
        running.send(None)
    except StopIteration as end:
        return end.value
    return None


@pytest.fixture
def held():
    return Held()


@pytest.mark.parametrize('way', ['reached', 'stalled'])
def test_a_goal_ends_where_it_is_reached_or_holds_something(held, way):
    handle = Handle()
    running = GripperGoals(held, KIND).execute(handle)
    assert turn(running) is None and held.ordered == [(0.0, 0.03)]
    held.see(0.05)
    assert turn(running) is None
    assert (handle.told[-1].position, handle.told[-1].effort) == (0.05, 0.03)
    setattr(held, way, True)
    held.see(0.04)
    result = turn(running)
    assert handle.became == 'succeed' and result.position == 0.04
    assert (result.reached_goal, result.stalled) == (way == 'reached', way == 'stalled')


def test_a_goal_ends_by_a_newer_one_by_cancelling_and_without_frames(held, monkeypatch):
    goals, first, second = GripperGoals(held, KIND), Handle(), Handle()
    running, newer = goals.execute(first), goals.execute(second)
    turn(running)
    turn(newer)
    held.see(0.05)
    assert turn(running) is not None and first.became == 'abort'
    second.is_cancel_requested = True
    assert turn(newer) is not None and second.became == 'canceled' and held.held
    monkeypatch.setattr(action, 'SILENCE', -1.0)
    third = Handle()
    assert turn(goals.execute(third)) is not None and third.became == 'abort'
    assert held.held  # nothing moves on when frames come back
    refused = Handle(width=-2.0)
    assert turn(goals.execute(refused)) is not None and refused.became == 'abort'


@pytest.mark.parametrize('blind', [True, False])
def test_a_goal_ends_where_frames_come_but_not_the_force_that_it_needs(held, monkeypatch, blind):
    """It ran forever."""
    handle, clock = Handle(), itertools.count()
    monkeypatch.setattr(action, 'time', SimpleNamespace(monotonic=lambda: 0.5 * next(clock)))
    running = GripperGoals(held, KIND).execute(handle)
    held.blind = blind
    for _ in range(10):
        held.see(0.05)
        if turn(running) is not None:
            break
    assert (handle.became, held.held) == (('abort', True) if blind else ('', False))


def test_a_goal_ends_where_its_command_was_reset(held):
    handle = Handle()
    running = GripperGoals(held, KIND).execute(handle)
    turn(running)
    held.command = None
    held.see(0.05)
    assert turn(running) is not None and handle.became == 'abort'


def test_a_goal_ends_by_another_command_and_not_by_a_refused_goal(held):
    goals, handle, refused = GripperGoals(held, KIND), Handle(), Handle(width=-2.0)
    running = goals.execute(handle)
    turn(running)
    assert turn(goals.execute(refused)) is not None and refused.became == 'abort'
    held.see(0.05)
    assert turn(running) is None and handle.became == ''
    command = held.order(0.0, 0.03)  # by the topic; equal, but it is not that of the goal
    held.see(0.0)
    held.reached = True
    result = turn(running)
    assert handle.became == 'abort' and not result.reached_goal
    assert held.command is command and not held.held  # which goes on


def grasping() -> Grasping:
    """Return the part of a gripper that grasps, without topics; nobody listens."""
    found = object.__new__(Grasping)
    found.settings = GripperSettings(arms=('left', 'right'))
    found.command, found.seen, found.new = None, {}, set()
    found.states = SimpleNamespace(get_subscription_count=lambda: 0)
    found.health = GraspHealth(found.settings.arms)
    return found


def test_a_command_begins_with_frames_of_today():
    found = grasping()
    found.seen, found.new = {'left': 'of minutes ago'}, {'left'}
    found.order(0.03, 0.02)
    assert (found.seen, found.new) == ({}, set())
    found.hold()
    found.seen, found.new = {'left': 'of minutes ago'}, {'left'}
    found.take_frame('right')
    assert (found.seen, found.new) == ({}, set())


def test_a_force_that_is_no_number_is_no_command():
    with pytest.raises(RequestError):
        grasping().order(0.03, math.nan)
    found = grasping()
    assert found.order(0.03, 0.0).force == found.settings.max_force


def test_the_force_of_a_command_is_no_more_than_allowed_now():
    found = grasping()
    command = found.order(0.03, 0.04)
    for most, force in ((0.05, 0.04), (0.01, 0.01), (0.05, 0.04)):
        found.settings = GripperSettings(max_force=most)
        assert found.allowed.force == force
    assert found.command is command  # a goal waits for it


def test_the_executor_lets_what_is_polled_go_on_while_nothing_wakes_it():
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ['ROS_DOMAIN_ID']))
    node = rclpy.create_node('polled', context=context)
    node.is_polled = True
    executor = PromptExecutor(context)
    executor.add_node(node)

    async def wait():
        for _ in range(5):
            await Turn()
        return 'done'

    task, end = executor.create_task(wait), time.monotonic() + 60.0
    while not task.done():
        assert time.monotonic() < end
        executor.take_turn()
    assert task.result() == 'done'
    node.destroy_node()
    context.try_shutdown()

"""The action `gripper_cmd` of type control_msgs/action/GripperCommand.

It requires control_msgs, which is part of ROS 2 but not available from a Python package index.
"""

from __future__ import annotations

from importlib import import_module
import time
from typing import Any

from pneunet_ros.core.errors import RequestError
from pneunet_ros.fusion.closing import GripCommand
from pneunet_ros.fusion.grasp import Grasp
from pneunet_ros.nodes.gripper.grasping import Grasping

NAME = 'gripper_cmd'
SILENCE = 2.0  # s without a required frame or force, after which a goal is aborted


def gripper_command() -> Any | None:
    """Return the type of the action; None if control_msgs is not installed."""
    try:
        return import_module('control_msgs.action').GripperCommand
    except ModuleNotFoundError:
        return None


def serve_action(node: Any, goals: GripperGoals) -> Any:
    """Open the action server; returns objects that must be kept alive."""
    from rclpy.action import ActionServer, CancelResponse

    node.is_polled = True  # an action does not wake this executor
    return ActionServer(
        node,
        goals.kind,
        NAME,
        execute_callback=goals.execute,
        cancel_callback=lambda handle: CancelResponse.ACCEPT,
    )


class GripperGoals:
    """Executes goals, each until a newer command replaces it.

    kind: the type of the action. A goal ends when the width is reached, or when the arms hold an
    object with the largest allowed force; the latter sets `stalled` and is not a failure. The goal
    is aborted if an arm waits too long for a frame or a known force.
    """

    def __init__(self, grasping: Grasping, kind: Any) -> None:
        self.grasping, self.kind = grasping, kind

    async def execute(self, handle: Any) -> Any:
        """Execute a goal; returns its result."""
        wanted = handle.request.command
        try:
            command = self.grasping.order(wanted.position, wanted.max_effort)
        except RequestError:
            handle.abort()
            return self.kind.Result()
        waiting_since = time.monotonic()
        while True:
            grasp = await self.next_grasp(waiting_since)
            if self.grasping.command is not command:
                handle.abort()
            elif grasp is None:
                self.grasping.hold()
                handle.abort()
            elif handle.is_cancel_requested:
                self.grasping.hold()
                handle.canceled()
            elif self.grasping.is_reached() or self.grasping.is_stalled():
                handle.succeed()
            else:
                handle.publish_feedback(self.fill_message(self.kind.Feedback(), grasp, command))
                if not self.grasping.is_blind():
                    waiting_since = time.monotonic()
                continue
            return self.fill_message(self.kind.Result(), grasp, command)

    def fill_message(self, message: Any, grasp: Grasp | None, command: GripCommand) -> Any:
        """Return a result or feedback with the width (m) and the mean force of an arm (N)."""
        if grasp is not None:
            is_own = self.grasping.command is command
            message.position = grasp.width
            message.effort = grasp.force / len(self.grasping.fusions)
            message.reached_goal = is_own and self.grasping.is_reached()
            message.stalled = is_own and self.grasping.is_stalled() and not message.reached_goal
        return message

    async def next_grasp(self, waiting_since: float) -> Grasp | None:
        """Return the next grasp; None after a timeout."""
        before = self.grasping.grasp
        while self.grasping.grasp is before or self.grasping.grasp is None:
            if time.monotonic() - waiting_since > SILENCE:
                return None
            await Turn()
        return self.grasping.grasp


class Turn:
    """Awaitable that lets the executor run all other callbacks once."""

    def __await__(self) -> Any:
        """Yield to the executor."""
        yield

"""An executor that hands messages to a node as soon as they are there.

That of rclpy looks through all that it waits for in each turn, makes a task of each callback, and
wakes once more after it: more work than an estimate. Its EventsExecutor is an experiment, and in
the wheels of rclpy 7.1.5 it never calls anything back.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerGuardCondition

# Of subscriptions whose callbacks take a message and what rclpy knows of it, and do not wait.
AT_ONCE = MutuallyExclusiveCallbackGroup()
FOREVER = -1  # ns


class PromptExecutor(SingleThreadedExecutor):
    """Calls back the subscriptions of the group AT_ONCE itself; all else rclpy's executor does.

    For nodes with subscriptions, timers and services: nothing else wakes it.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._wait_set: Any = None
        self._size: tuple[int, ...] = ()
        self._wake = GuardCondition(callback=None, callback_group=None, context=self.context)
        self._signal = SignalHandlerGuardCondition(self.context)
        self.context.on_shutdown(self.wake)

    def wake(self) -> None:
        """Look again at what there is to wait for."""
        self._wake.trigger()
        super().wake()

    def spin(self) -> None:
        """Call back until ROS shuts down; ExternalShutdownException then."""
        while self.context.ok():
            self.take_turn()
        raise ExternalShutdownException()

    def take_turn(self) -> None:
        """Wait for something, and call back what is ready."""
        nodes = self.get_nodes()
        subscriptions = [item for node in nodes for item in node.subscriptions]
        timers = [item for node in nodes for item in node.timers]
        services = [item for node in nodes for item in node.services]
        waiting = self.empty_wait_set(len(subscriptions), 2, len(timers), 0, len(services), 0)
        for item in subscriptions:
            waiting.add_subscription(item.handle)
        for item in timers:
            waiting.add_timer(item.handle)
        for item in services:
            waiting.add_service(item.handle)
        waiting.add_guard_condition(self._wake.handle)
        waiting.add_guard_condition(self._signal.handle)
        waiting.wait(FOREVER)
        # A message of each, in the order in which they were subscribed, be it that one has come
        # only now: a pressure comes right after its wrench.
        others = set()
        for item in subscriptions:
            if item.callback_group is not AT_ONCE:
                others.add(item.handle.pointer)
            elif taken := item.handle.take_message(item.msg_type, item.raw):
                item.callback(*taken)
        if (
            waiting.get_ready_entities('timer')
            or waiting.get_ready_entities('service')
            or not others.isdisjoint(waiting.get_ready_entities('subscription'))
        ):
            self.spin_once(timeout_sec=0)

    def empty_wait_set(self, *size: int) -> Any:
        """Return a set for so many subscriptions, guards, timers, clients, services, events."""
        if self._size != size:
            self._wait_set = rclpy_implementation.WaitSet(*size, self.context.handle)
            self._size = size
        self._wait_set.clear_entities()
        return self._wait_set

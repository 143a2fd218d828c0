"""An executor that hands messages to a node as soon as they are there, in order.

That of rclpy takes one message of each topic in a turn, makes a task of each callback, and wakes
once more after it: more work than an estimate, and another order than that of arrival. Its
EventsExecutor is an experiment, and in the wheels of rclpy 7.1.5 it never calls anything back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
import time
from typing import Any

from pneunet_ros.core.arrivals import ArrivalOrder
from pneunet_ros.messages.builders import header_stamp
from pneunet_ros.nodes.callback_errors import CallbackErrors
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerGuardCondition

FOREVER = -1  # ns
Call = Callable[[], None]


class AtOnce(MutuallyExclusiveCallbackGroup):
    """Of one subscription, whose callback takes a message and what rclpy knows of it.

    order: that of the messages of all subscriptions that belong together; topic: which one of its
    topics this is; errors: counts messages that cannot be taken, which else raise.
    """

    def __init__(
        self, order: ArrivalOrder[Call], topic: str, errors: CallbackErrors | None = None
    ) -> None:
        super().__init__()
        self.order, self.topic, self.errors = order, topic, errors

    def can_execute(self, entity: object) -> bool:
        """Keep rclpy's executor from taking messages out of order."""
        return False

    def take_from(self, subscription: Any) -> bool:
        """Take a message, if there is one, for its turn; whether there may be more."""
        try:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        except Exception as error:
            if self.errors is None:
                raise
            self.errors.note(error)
            return False
        if taken:
            self.add(subscription.callback, *taken)
        return bool(taken)

    def add(self, callback: Callable[..., None], message: Any, info: Mapping[str, int]) -> None:
        """Add a message that was taken, for its turn."""
        # Not every middleware says when it received a message.
        at_ns = info['received_timestamp'] or info['source_timestamp']
        call = partial(callback, message, info)
        self.order.add(self.topic, min(at_ns, time.time_ns()), header_stamp(message), call)


class PromptExecutor(SingleThreadedExecutor):
    """Calls back the subscriptions of a group AtOnce itself; all else rclpy's executor does.

    For nodes with subscriptions, timers and services: nothing else wakes it.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._wait_set: Any = None
        self._size: tuple[int, ...] = ()
        self._due_ns: int | None = None  # when a message has waited for another long enough
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
        waiting.wait(FOREVER if self._due_ns is None else max(self._due_ns - time.time_ns(), 0))
        self.take_messages([item for item in subscriptions if is_at_once(item)])
        others = {item.handle.pointer for item in subscriptions if not is_at_once(item)}
        if (
            waiting.get_ready_entities('timer')
            or waiting.get_ready_entities('service')
            or not others.isdisjoint(waiting.get_ready_entities('subscription'))
        ):
            self.spin_once(timeout_sec=0)

    def take_messages(self, subscriptions: list[Any]) -> None:
        """Take all messages that have arrived, of all topics, and call them back in order."""
        found = True
        while found:  # until nothing came meanwhile: it may be older than what is there
            found, until_ns = False, time.time_ns()
            for item in subscriptions:
                while item.callback_group.take_from(item):
                    found = True
        orders = {id(order): order for order in map(order_of, subscriptions)}.values()
        for order in orders:
            for call in order.take(until_ns):
                call()
        dues = [order.due_ns for order in orders if order.due_ns is not None]
        self._due_ns = min(dues, default=None)

    def empty_wait_set(self, *size: int) -> Any:
        """Return a set for so many subscriptions, guards, timers, clients, services, events."""
        if self._size != size:
            self._wait_set = rclpy_implementation.WaitSet(*size, self.context.handle)
            self._size = size
        self._wait_set.clear_entities()
        return self._wait_set


def order_of(subscription: Any) -> ArrivalOrder[Call]:
    """Return the order that a subscription of a group AtOnce belongs to."""
    order: ArrivalOrder[Call] = subscription.callback_group.order
    return order


def is_at_once(subscription: Any) -> bool:
    """Whether this executor calls it back itself."""
    return isinstance(subscription.callback_group, AtOnce)

"""An executor that runs message callbacks immediately, in order of arrival.

The executor of rclpy takes one message of each topic per turn, creates a task for each callback,
and wakes up again after each task, which takes longer than an estimate and changes the order of
arrival. The EventsExecutor of rclpy is experimental, and in the wheels of rclpy 7.1.5 it never
runs a callback.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from functools import partial
from heapq import heapify, heappop, heapreplace
import time
from typing import Any, NamedTuple, TypeVar

from pneunet_ros.core.arrivals import ArrivalOrder
from pneunet_ros.core.pauses import work_in_pauses
from pneunet_ros.messages.builders import header_stamp
from pneunet_ros.nodes.callback_errors import CallbackErrors
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.signals import SignalHandlerGuardCondition

FOREVER = -1  # ns
NEVER = 2**63  # ns
SERVICE_NS = 1_000_000  # waiting for a service takes up to 35 us: 3 % of the time
# Callbacks of messages run this long before the executor looks for other messages or continues
# less urgent work; or for this multiple of the time of the last search, or of that work since its
# last pause.
LOOK_AGAIN_NS, LOOKS = 1_000_000, 4
POLL_NS, POLLS = 20_000_000, 4  # how often, and for how long, rclpy serves a polled node
SAME_NS = 100_000  # tolerance for a drift between clocks, and for the delay of DDS
PAUSE_NS = 1_000_000  # between two checks for more urgent messages: a check takes a tenth of this
LONG_NS = 5_000_000  # callback duration after which others are equally urgent: two usual frames
Call = Callable[[], None]
Result = TypeVar('Result')


class SteadyTime:
    """Converts arrival times from the wall clock to the monotonic clock.

    The offset between the clocks is kept while it remains valid, so that messages keep their
    order.
    """

    def __init__(self) -> None:
        self.difference_ns = 0

    def monotonic(self, at_ns: int) -> int:
        """Return a time (ns) of the wall clock, at most now, by the monotonic clock."""
        before_ns, wall_ns, now_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        is_exact = now_ns - before_ns < SAME_NS  # otherwise this thread was interrupted
        if is_exact and abs(now_ns - wall_ns - self.difference_ns) > SAME_NS:
            self.difference_ns = now_ns - wall_ns
        return min(at_ns + self.difference_ns, now_ns)


steady = SteadyTime()


def never() -> bool:
    """Return False: messages are received regardless of the backlog."""
    return False


class ImmediateGroup(MutuallyExclusiveCallbackGroup):
    """Callback group of one subscription, with a callback for a message and its info.

    order: common processing order of related subscriptions; topic: name within that order; errors:
    counts invalid messages, which raise an error if it is None; patience_ns: how much earlier than
    messages of other nodes a message must arrive to be processed before them; read: deserializes
    the messages of a raw subscription; is_full: whether the backlog is so long that no further
    messages are received.
    """

    def __init__(
        self,
        order: ArrivalOrder[Call],
        topic: str,
        errors: CallbackErrors | None = None,
        patience_ns: int = 0,
        read: Callable[[bytes], Any] | None = None,
        is_full: Callable[[], bool] = never,
    ) -> None:
        super().__init__()
        self.order, self.topic, self.errors = order, topic, errors
        self.patience_ns, self.read, self.is_full = patience_ns, read, is_full

    def can_execute(self, entity: object) -> bool:
        """Keep the executor of rclpy from taking messages out of order."""
        return False

    def take_from(self, subscription: Any) -> bool:
        """Take a message into the queue; return whether there may be more."""
        try:
            received = subscription.handle.take_message(subscription.msg_type, subscription.raw)
            if received and self.read is not None:
                received = self.read(received[0]), received[1]
        except Exception as error:
            if self.errors is None:
                raise
            self.errors.note(error)
            return False
        if received:
            self.add(subscription.callback, *received)
        return bool(received)

    def add(self, callback: Callable[..., None], message: Any, info: Mapping[str, int]) -> None:
        """Queue a received message."""
        # Not every middleware reports the time of reception.
        at_ns = steady.monotonic(info['received_timestamp'] or info['source_timestamp'])
        call = partial(callback, message, info)
        self.order.add(self.topic, at_ns, header_stamp(message), call)


class Queue:
    """The messages of subscriptions of one node that share one order."""

    def __init__(self, node: Any, group: ImmediateGroup) -> None:
        self.node, self.order, self.patience_ns = node, group.order, group.patience_ns
        self.is_full = group.is_full
        self.subscriptions: list[Any] = []
        self.until_ns = 0

    def is_ready(self, ready: Collection[int], now_ns: int) -> bool:
        """Whether messages can be processed; ready: subscriptions with messages."""
        due_ns = self.order.due_ns
        return (due_ns is not None and due_ns <= now_ns) or any(
            item.handle.pointer in ready for item in self.subscriptions
        )

    def fill(self) -> None:
        """Receive all available messages, unless too many are waiting."""
        if self.is_full():
            return
        found = True
        while found:  # until no message arrives meanwhile: it may be older than those received
            found, self.until_ns = False, time.monotonic_ns()
            for item in self.subscriptions:
                while item.callback_group.take_from(item):
                    found = True

    @property
    def turn_ns(self) -> int:
        """Time of the next message (ns), its priority among the messages of other nodes."""
        first_ns = self.order.first_ns
        return NEVER if first_ns is None else first_ns + self.patience_ns

    def call_next(self) -> bool:
        """Run the callback of the next message; return whether there was one."""
        call = next(self.order.take(self.until_ns), None)
        if call is not None:
            call()
        return call is not None


class RunningCallback(NamedTuple):
    """A callback in progress: its queues, its patience, and its start time."""

    queues: Collection[Queue]
    patience_ns: int
    begin_ns: int

    def yields_to(self, other: Queue, now_ns: int) -> bool:
        """Whether messages of another node may preempt this callback in its pauses.

        True for messages of a node with less patience, or with equal patience if the work takes
        long.
        """
        is_long = now_ns - self.begin_ns >= LONG_NS
        return other not in self.queues and self.patience_ns + is_long > other.patience_ns


class PromptExecutor(SingleThreadedExecutor):
    """Runs timers and immediate subscriptions; the executor of rclpy runs everything else.

    Messages of several nodes are processed in order of arrival, allowing for the patience of each
    node. In the pauses of a callback (`core.pauses`), more urgent messages of other nodes are
    processed. Only subscriptions, timers and services wake the executor. Other entities of a node,
    such as actions, are polled every `POLL_NS` if its `is_polled` is set. A process with many
    nodes has over a hundred services, and waiting for all of them takes longer than an estimate:
    while messages arrive, each service is polled every `SERVICE_NS`. When no message is waiting,
    `settle` is called on a node that `is_unsettled`.
    """

    def __init__(self, context: Context | None = None) -> None:
        super().__init__(context=context)
        self._wake = GuardCondition(callback=None, callback_group=None, context=self.context)
        self._signal = SignalHandlerGuardCondition(self.context)
        self._changed = True  # whether entities have changed since they were listed
        self._queues: list[Queue] = []
        self._running: list[RunningCallback] = []  # each runs in a pause of the previous one
        self._prompt: list[Any] = []  # immediate subscriptions
        self._other: list[Any] = []  # subscriptions
        self._timers: list[Any] = []
        self._timer_nodes: list[Any] = []  # the node of each timer
        self._services: list[Any] = []
        self._polled = False  # whether any node is polled
        self._settling: list[Any] = []  # nodes that defer work until no message waits
        self._wait_sets: dict[bool, Any] = {}
        self._prompt_until_ns = self._services_due_ns = self._pause_ns = 0
        self._due_ns: int | None = None  # when a message no longer needs to wait for another one
        self.context.on_shutdown(self.wake)

    def wake(self) -> None:
        """Update the list of entities to wait for."""
        self._changed = True
        self._wake.trigger()
        super().wake()

    def spin(self) -> None:
        """Spin until ROS shuts down, then raise ExternalShutdownException."""
        end = work_in_pauses(self.call_urgent)
        try:
            while self.context.ok():
                self.take_turn()
        finally:
            end()
        raise ExternalShutdownException()

    def take_turn(self) -> None:
        """Wait, then run all callbacks that are ready."""
        if self._changed:
            self.list_entities()
        begin_ns = time.monotonic_ns()
        with_services = begin_ns >= min(self._prompt_until_ns, self._services_due_ns)
        late = self._due_ns is not None and self._due_ns <= begin_ns
        waiting = self.wait(begin_ns, with_services=with_services)
        looked_ns = begin_ns if late else time.monotonic_ns()
        arrived = set(waiting.get_ready_entities('subscription'))
        has_request = with_services and bool(waiting.get_ready_entities('service'))
        if self.call_messages(arrived, looked_ns, all_arrived=has_request):
            self._prompt_until_ns = time.monotonic_ns() + SERVICE_NS * len(self._services)
        elif (node := self.unsettled()) is not None:
            self.work(self.background_work(node), node.errors.guarded(node.settle))
        ready = set(waiting.get_ready_entities('timer'))
        for timer, node in list(zip(self._timers, self._timer_nodes, strict=True)):
            if timer.handle.pointer in ready:
                self.call_timer(timer, node)
                if not self._changed:
                    self.call_some(self._queues)
        if not with_services:
            return
        self._services_due_ns = time.monotonic_ns() + SERVICE_NS * len(self._services)
        other_handles = {item.handle.pointer for item in self._other}
        for _ in range(POLLS * self._polled):
            self.spin_once(timeout_sec=0)
        if has_request or not other_handles.isdisjoint(arrived):
            self.spin_once(timeout_sec=0)

    def wait(self, begin_ns: int, *, with_services: bool) -> Any:
        """Wait for messages and timers, and possibly for services."""
        waiting = self._wait_sets[with_services]
        waiting.clear_entities()
        for item in [*self._prompt, *self._other] if with_services else self._prompt:
            waiting.add_subscription(item.handle)
        for item in self._timers:
            waiting.add_timer(item.handle)
        for item in self._services if with_services else ():
            waiting.add_service(item.handle)
        waiting.add_guard_condition(self._wake.handle)
        waiting.add_guard_condition(self._signal.handle)
        ends = [] if self._due_ns is None else [self._due_ns]
        if self.unsettled() is not None:
            ends.append(begin_ns)
        if not with_services:
            ends.append(self._services_due_ns)
        elif self._polled:
            ends.append(begin_ns + POLL_NS)
        waiting.wait(max(min(ends) - begin_ns, 0) if ends else FOREVER)
        return waiting

    def call_messages(self, ready: Collection[int], begin_ns: int, *, all_arrived: bool) -> bool:
        """Run callbacks of received messages for a while; return whether there were any.

        begin_ns: start of the search for messages. Searching is slow on a busy machine and must
        not take most of the time. all_arrived: whether to process all arrived messages, because
        the next item is a service request, which is served after the messages sent before it.
        """
        for queue in self._queues:
            if queue.is_ready(ready, begin_ns):
                queue.fill()
        now_ns = time.monotonic_ns()
        end_ns = now_ns + max(LOOK_AGAIN_NS, LOOKS * (now_ns - begin_ns))
        any_called, more = self.call_in_turn(self._queues, end_ns)
        if more and all_arrived:
            self.call_arrived(self._queues)
        elif more:  # to be processed next
            self._due_ns = now_ns
        return any_called

    def call_in_turn(self, queues: Iterable[Queue], end_ns: int) -> tuple[bool, bool]:
        """Run callbacks of queues until a time; return whether any ran and whether more wait."""
        turns = [
            (queue.turn_ns, index, queue)
            for index, queue in enumerate(queues)
            if queue.order.first_ns is not None
        ]
        heapify(turns)
        any_called = False
        while turns and time.monotonic_ns() < end_ns and not self._changed:
            turn_ns, index, queue = turns[0]
            if turn_ns == queue.turn_ns:  # otherwise a pause has processed its first message
                running = RunningCallback([queue], queue.patience_ns, time.monotonic_ns())
                if not self.work(running, queue.call_next):
                    heappop(turns)
                    continue
                any_called = True
            heapreplace(turns, (queue.turn_ns, index, queue))
            if turns[0][0] == NEVER:
                break
        dues = [queue.order.due_ns for queue in self._queues]
        self._due_ns = min((due for due in dues if due is not None), default=None)
        return any_called, bool(turns) and turns[0][0] < NEVER

    def call_some(self, queues: Collection[Queue]) -> bool:
        """Process messages of queues for a short time; return whether some are left."""
        for queue in queues:
            queue.fill()
        now_ns = time.monotonic_ns()
        _, more = self.call_in_turn(queues, now_ns + LOOK_AGAIN_NS)
        if more:
            self._due_ns = now_ns
        return more

    def call_arrived(self, queues: Collection[Queue], end_ns: int = NEVER) -> None:
        """Process messages that have arrived, and more urgent messages, until a time."""
        now_ns, more = time.monotonic_ns(), True
        while more and not self._changed and time.monotonic_ns() < end_ns:
            more = self.call_some(queues)
            arrivals = [queue.order.first_ns for queue in queues]
            more = more and any(at_ns is not None and at_ns <= now_ns for at_ns in arrivals)

    def work(self, running: RunningCallback, call: Callable[[], Result]) -> Result:
        """Run a callback while further messages of its queues wait."""
        self._running.append(running)
        try:
            return call()
        finally:
            self._running.pop()

    def call_urgent(self) -> None:
        """Process messages more urgent than the running callbacks, in a pause of the last one.

        Waiting messages get a fixed multiple of the time of the callback, so that the callback can
        end.
        """
        now_ns = time.monotonic_ns()
        if now_ns < self._pause_ns or not self._running:
            return
        worked_ns = now_ns - max(self._running[-1].begin_ns, self._pause_ns - PAUSE_NS)
        self.call_arrived(
            [
                queue
                for queue in self._queues
                if all(one.yields_to(queue, now_ns) for one in self._running)
            ],
            now_ns + max(LOOK_AGAIN_NS, LOOKS * worked_ns),
        )
        self._pause_ns = time.monotonic_ns() + PAUSE_NS

    def call_timer(self, timer: Any, node: Any) -> None:
        """Run a timer callback, unless an earlier callback has destroyed the timer.

        All messages take precedence over timers, which serve only observers.
        """
        try:
            with timer.handle:
                timer.handle.call_timer()
        except InvalidHandle:
            return
        self.work(self.background_work(node), timer.callback)

    def background_work(self, node: Any) -> RunningCallback:
        """Return work of a node during which the messages of all other nodes have priority."""
        own_queues = [queue for queue in self._queues if queue.node is node]
        return RunningCallback(own_queues, NEVER, time.monotonic_ns())

    def unsettled(self) -> Any | None:
        """Return a node with deferred work; None if there is none."""
        return next((node for node in self._settling if node.is_unsettled), None)

    def list_entities(self) -> None:
        """List the entities to wait for, which nodes may add and remove at any time."""
        self._changed = False
        nodes = self.get_nodes()
        self._settling = [node for node in nodes if hasattr(node, 'settle')]
        self._polled = any(getattr(node, 'is_polled', False) for node in nodes)
        subscriptions = [item for node in nodes for item in node.subscriptions]
        self._prompt = [item for item in subscriptions if is_immediate(item)]
        self._other = [item for item in subscriptions if not is_immediate(item)]
        self._timers = [item for node in nodes for item in node.timers]
        self._timer_nodes = [node for node in nodes for _ in node.timers]
        self._services = [item for node in nodes for item in node.services]
        self._queues = queues_of(nodes)
        self._wait_sets = {
            False: self.wait_set(len(self._prompt), 0),
            True: self.wait_set(len(subscriptions), len(self._services)),
        }

    def wait_set(self, subscriptions: int, services: int) -> Any:
        """Return a wait set for these entities, all timers and two guards."""
        size = (subscriptions, 2, len(self._timers), 0, services, 0)
        return rclpy_implementation.WaitSet(*size, self.context.handle)


def queues_of(nodes: Iterable[Any]) -> list[Queue]:
    """Return the queues of the immediate subscriptions of nodes."""
    queues: dict[int, Queue] = {}
    for node in nodes:
        for item in filter(is_immediate, node.subscriptions):
            group = item.callback_group
            queue = Queue(node, group)
            queues.setdefault(id(group.order), queue).subscriptions.append(item)
    return list(queues.values())


def is_immediate(subscription: Any) -> bool:
    """Whether the executor calls this callback directly."""
    return isinstance(subscription.callback_group, ImmediateGroup)

"""The topics of a node: their quality of service, and how it can be overridden.

Publishers and subscriptions have no event callbacks, because rclpy checks each of them in every
turn of the executor, which doubles the latency. Such callbacks would only log a QoS mismatch,
which the other side logs as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
import inspect
from typing import Any

from pneunet_ros.core.arrivals import ArrivalOrder
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND
from pneunet_ros.messages.builders import Input
from pneunet_ros.messages.readings import (
    arrival_order,
    BASE_IMU,
    END_WRENCH,
    FIXED_FRAMES,
    FRAMES,
    PRESSURE,
    TARGETS,
)
from pneunet_ros.nodes.load_shedding import MOST_WAITING
from pneunet_ros.nodes.prompt_executor import ImmediateGroup, never
from pneunet_ros.nodes.ros_types import deserialize, message_class
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

POLICIES = (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY)


# 0.2 s of pressures at 100 Hz and of a force sensor at 1 kHz: nothing is lost while a node is busy
# with a frame. A node slower than its pressures lags behind by this many.
DEPTH = MOST_WAITING
DEPTH_OF: Mapping[Input[Any], int] = dict.fromkeys(
    (END_WRENCH, BASE_IMU, FRAMES, FIXED_FRAMES), 10 * DEPTH
)


def input_qos(depth: int = DEPTH) -> QoSProfile:
    """Return a new QoS for sensor data, which overrides may change in place."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def output_qos() -> QoSProfile:
    """Return the QoS of estimates."""
    return QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


def latched_qos(depth: int = 1) -> QoSProfile:
    """Return the QoS of a latched topic: late subscribers get the last message."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def publisher(node: Any, type_name: str, topic: str, qos: QoSProfile) -> Any:
    """Create a publisher with QoS that parameters can override."""
    events = PublisherEventCallbacks(use_default_callbacks=False)
    create = partial(node.create_publisher, event_callbacks=events)
    return _overridable(create, message_class(type_name), topic, qos)


def subscription(
    node: Any,
    type_name: str,
    topic: str,
    callback: Callable[..., None],
    qos: QoSProfile,
    policies: tuple[QoSPolicyKind, ...] = POLICIES,
    group: ImmediateGroup | None = None,
) -> Any:
    """Create a subscription with QoS of which parameters can override `policies`.

    A callback with two parameters (message, info) is called immediately. group: processing order
    shared with other subscriptions; None: an order of this topic alone, in which no messages are
    received while others wait, so that the middleware drops the oldest messages of a backlog.
    """
    if group is None and len(inspect.signature(callback).parameters) == 2:
        order: ArrivalOrder[Any] = ArrivalOrder([topic])
        group = group_of(node, order, topic, is_full=lambda: order.first_ns is not None)
    events = SubscriptionEventCallbacks(use_default_callbacks=False)
    raw = group is not None and group.read is not None
    create = partial(
        node.create_subscription, event_callbacks=events, callback_group=group, raw=raw
    )
    return _overridable(create, message_class(type_name), topic, callback, qos, policies=policies)


def group_of(
    node: Any,
    order: ArrivalOrder[Any],
    topic: str,
    read: Callable[[bytes], Any] | None = None,
    is_full: Callable[[], bool] = never,
) -> ImmediateGroup:
    """Return the callback group of a subscription (`ImmediateGroup`); read: decodes messages."""
    patience_ns = round(getattr(node, 'PATIENCE', 0.0) * NANOSECONDS_PER_SECOND)
    return ImmediateGroup(order, topic, getattr(node, 'errors', None), patience_ns, read, is_full)


def subscribe_in_order(node: Any, takes: Mapping[Input[Any], Callable[..., None]]) -> None:
    """Subscribe to sensor topics, and process their messages in one common order.

    takes: callbacks (message, info) by sensor, in the order for ties. While the node is behind,
    frames are dropped (`LoadShedding`).
    """
    order = arrival_order(takes)
    node.shedding.backlog = partial(order.backlog, PRESSURE.name)
    node.shedding.span = lambda: order.span_ns
    node.shedding.timeout = lambda: node.in_use()[1].input_timeout
    for sensor, take in takes.items():
        if sensor is TARGETS:
            note = partial(node.note_message, node.resolve_topic_name(sensor.topic))
            take = node.shedding.drop_frames_if_late(take, note)
        read = partial(deserialize, type_name=sensor.type)
        group = group_of(node, order, sensor.name, read, node.shedding.is_full)
        qos = input_qos(DEPTH_OF.get(sensor, DEPTH))
        if sensor is FIXED_FRAMES:
            qos = latched_qos(qos.depth)
        subscription(node, sensor.type, sensor.topic, take, qos, group=group)


def _overridable(
    create: Callable[..., Any], *arguments: Any, policies: tuple[QoSPolicyKind, ...] = POLICIES
) -> Any:
    try:
        return create(*arguments, qos_overriding_options=QoSOverridingOptions(policies))
    except (ParameterException, InvalidQosOverridesError, RuntimeError) as error:
        raise RequestError(
            f'invalid qos_overrides parameter: {error}', reason='wrong_value'
        ) from error

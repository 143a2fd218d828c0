"""The topics of the estimator: their quality of service, and publishing of what is wanted.

No publisher or subscription here has event callbacks: rclpy looks after each of them in every turn
of the executor, which doubles the latency. They would only log what the other side logs as well,
that a quality of service does not match.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from pneunet_ros.cdr_template import EstimateSerializer
from pneunet_ros.errors import RequestError
from pneunet_ros.message_parts import Output
from pneunet_ros.messages import OUTPUTS
from pneunet_ros.nodes.ros_types import message_class
from pneunet_ros.shape import ShapeEstimate
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

# Published first, as a controller may wait for them; the centerline last, as it is for people.
FOR_CONTROL = ('shape', 'tip', 'tip_jacobian')
FOR_PEOPLE = 'centerline'
PUBLISHED = tuple(
    sorted(OUTPUTS, key=lambda topic: (topic.name not in FOR_CONTROL, topic.name == FOR_PEOPLE))
)


def input_qos() -> QoSProfile:
    """Return the quality of service of sensor data; a new one, as overriding changes it."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=5, reliability=ReliabilityPolicy.BEST_EFFORT
    )


def output_qos() -> QoSProfile:
    """Return the quality of service of what is estimated."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE
    )


def latched_qos() -> QoSProfile:
    """Return the quality of service of what late subscribers get as well."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL,
    )


def publisher(node: Any, type_name: str, topic: str, qos: QoSProfile) -> Any:
    """Create a publisher whose quality of service parameters can override."""
    events = PublisherEventCallbacks(use_default_callbacks=False)
    create = partial(node.create_publisher, event_callbacks=events)
    return _overridable(create, message_class(type_name), topic, qos)


def subscription(
    node: Any, type_name: str, topic: str, callback: Callable[..., None], qos: QoSProfile
) -> Any:
    """Create a subscription whose quality of service parameters can override."""
    events = SubscriptionEventCallbacks(use_default_callbacks=False)
    create = partial(node.create_subscription, event_callbacks=events)
    return _overridable(create, message_class(type_name), topic, callback, qos)


def _overridable(create: Callable[..., Any], *arguments: Any) -> Any:
    options = QoSOverridingOptions.with_default_policies()
    try:
        return create(*arguments, qos_overriding_options=options)
    except (ParameterException, InvalidQosOverridesError, RuntimeError) as error:
        raise RequestError(f'a qos_overrides parameter cannot be used: {error}') from error


class EstimatePublisher:
    """Publishes estimates on all their topics, as far as somebody listens.

    A message is not even built for a topic without subscribers. `centerline_rate` (Hz) limits the
    topic of that name, as reading a Path is costly; 0 means every estimate.
    """

    def __init__(self, node: Any, serializer: EstimateSerializer, centerline_rate: float) -> None:
        self.centerline_rate = centerline_rate
        self._serializer = serializer
        self._due = 0.0
        self._publishers: tuple[tuple[Output[ShapeEstimate], Any], ...] = tuple(
            (topic, publisher(node, topic.type, topic.name, output_qos())) for topic in PUBLISHED
        )

    def publish(self, estimate: ShapeEstimate, now: float) -> None:
        """Publish an estimate; now: seconds of a steady clock."""
        for topic, out in self._publishers:
            if out.get_subscription_count() == 0:
                continue
            if topic.name == FOR_PEOPLE and not self._centerline_is_due(now):
                continue
            out.publish(self._serializer.bytes_of(topic, estimate))

    def _centerline_is_due(self, now: float) -> bool:
        if self.centerline_rate <= 0.0:
            return True
        if now < self._due:
            return False
        # A step from when it was due keeps the rate, unless nothing was wanted for a while.
        period = 1.0 / self.centerline_rate
        self._due = self._due + period if now - self._due < period else now + period
        return True

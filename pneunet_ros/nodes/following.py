"""A subscription that adopts the reliability and durability of its publishers.

A reliable subscription receives nothing from a best-effort publisher, and a best-effort
subscription loses many images of a reliable publisher. Latched messages reach only subscriptions
that request them.

ReliabilityPolicy.BEST_AVAILABLE does not help: the publishers are checked only once, when the
subscription is created, and without publishers the policy is reliable and latched. Messages of
later publishers that offer less are then never received.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pneunet_ros.nodes.parameters import overrides
from pneunet_ros.nodes.topics import POLICIES, subscription
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy

# A tenth of a second at 60 Hz, so that a delayed node catches up. If images come faster than they
# are processed, at most this many wait in the node, and as many in the middleware; the oldest are
# lost.
DEPTH = 6
Offer = tuple[ReliabilityPolicy, DurabilityPolicy]
ANYTHING: Offer = (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE)


class FollowingSubscription:
    """A subscription with the QoS offered by the publishers; `follow` checks and adapts it.

    Reliability set by a `qos_overrides` parameter is not changed.
    """

    def __init__(
        self, node: Any, type_name: str, topic: str, callback: Callable[..., None]
    ) -> None:
        """Subscribe with a QoS that matches any publisher, until the publishers are known."""
        self._node, self._type_name, self._topic = node, type_name, topic
        self._callback = callback
        self._subscription = self._subscribed(ANYTHING)
        self._followed = ANYTHING
        self.follow()

    @property
    def topic(self) -> str:
        """Full name of the topic."""
        name: str = self._subscription.topic_name
        return name

    def follow(self) -> None:
        """Resubscribe if the publishers offer another quality of service."""
        offer = common_offer(self._node.get_publishers_info_by_topic(self.topic))
        if offer is not None and offer != self._followed:
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribed(offer)
            self._followed = offer

    def _subscribed(self, offer: Offer) -> Any:
        reliability, durability = offer
        qos = QoSProfile(depth=DEPTH, reliability=reliability, durability=durability)
        # A declared parameter keeps its first value, so only given parameters are declared.
        name = self._node.resolve_topic_name(self._topic)
        given = f'qos_overrides.{name}.subscription.reliability' in overrides(self._node)
        policies = (
            POLICIES
            if given
            else tuple(policy for policy in POLICIES if policy is not QoSPolicyKind.RELIABILITY)
        )
        return subscription(
            self._node, self._type_name, self._topic, self._callback, qos, policies
        )


def common_offer(publishers: Sequence[Any]) -> Offer | None:
    """Return the weakest QoS that the publishers of a topic offer; None without publishers."""
    if not publishers:
        return None
    qualities = [publisher.qos_profile for publisher in publishers]
    reliable = all(quality.reliability == ReliabilityPolicy.RELIABLE for quality in qualities)
    latched = all(quality.durability == DurabilityPolicy.TRANSIENT_LOCAL for quality in qualities)
    return (
        ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )

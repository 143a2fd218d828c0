"""Other nodes on the topics of a node: duplicates, and incompatible peers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from typing import Any

from pneunet_ros.core.pauses import pause
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

SHARED_TOPICS = ('/diagnostics', '/tf', '/rosout', '/parameter_events', '/clock')  # for all nodes


def rival_sentences(node: Any, shared: Collection[str]) -> Iterator[str]:
    """Name duplicates of a node, and inputs with several publishers.

    shared: further topics, in addition to the common ones, that may have several publishers.
    """
    own_name = node.get_fully_qualified_name()
    running = list(node.get_node_names_and_namespaces())
    if running.count((node.get_name(), node.get_namespace())) > 1:
        yield f'another node has the same name, {own_name}'
    excluded = {*SHARED_TOPICS, *shared}
    own_topics = Counter(publisher.topic_name for publisher in node.publishers)
    topics = [
        topic
        for topic, count in own_topics.items()
        if topic not in excluded and node.count_publishers(topic) > count
    ]
    if topics:
        yield f'another node also publishes {", ".join(sorted(topics))}'
    for topic in sorted({item.topic_name for item in node.subscriptions} - excluded):
        pause()
        names = sorted(map(name_of, node.get_publishers_info_by_topic(topic)))
        if len(names) > 1:
            yield (
                f'{topic} has {len(names)} publishers, whose messages are mixed: '
                f'{", ".join(names)}. Stop all but one'
            )


def mismatch_sentences(node: Any) -> Iterator[str]:
    """Report QoS mismatches with publishers and subscribers."""
    for item in node.subscriptions:
        pause()
        topic = item.topic_name
        for other in node.get_publishers_info_by_topic(topic):
            kind = type_name(item.msg_type)
            if other.topic_type != kind:
                yield (
                    f'{name_of(other)} publishes {topic} with the type {other.topic_type}, not '
                    f'{kind}'
                )
                continue
            reason = incompatibility(other.qos_profile, item.qos_profile)
            if reason:
                yield (
                    f'{topic} of {name_of(other)} cannot be received ({reason}): set '
                    f'qos_overrides.{topic}.subscription.reliability, or change the publisher'
                )
    for item in node.publishers:
        pause()
        topic = item.topic_name
        for other in node.get_subscriptions_info_by_topic(topic):
            reason = incompatibility(item.qos_profile, other.qos_profile)
            if reason:
                yield f'{name_of(other)} cannot receive {topic} ({reason})'


def incompatibility(published: Any, subscribed: Any) -> str:
    """Return the reason for an incompatible publisher and subscription; empty if they match.

    Only reliability and durability are compared, because for other policies the graph does not
    show whether a value was set.
    """
    if (published.reliability, subscribed.reliability) == (
        ReliabilityPolicy.BEST_EFFORT,
        ReliabilityPolicy.RELIABLE,
    ):
        return 'published as best effort, but reliable is requested'
    if (published.durability, subscribed.durability) == (
        DurabilityPolicy.VOLATILE,
        DurabilityPolicy.TRANSIENT_LOCAL,
    ):
        return 'published as volatile, but transient local is requested'
    return ''


def name_of(endpoint: Any) -> str:
    """Return the full name of the node of a publisher or subscription."""
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


def type_name(message_type: Any) -> str:
    """Return the ROS name of a message type."""
    package, folder, *_ = message_type.__module__.split('.')
    return f'{package}/{folder}/{message_type.__name__}'

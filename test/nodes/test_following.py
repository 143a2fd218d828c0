"""A subscription that takes its quality of service from the publishers of its topic."""

from __future__ import annotations

import os
from pathlib import Path
import re
import time

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.following import common_offer, DEPTH, FollowingSubscription  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from std_msgs.msg import String  # noqa: E402

TIMEOUT = 180.0  # s
STRING = 'std_msgs/msg/String'
BEST_EFFORT = QoSProfile(depth=3, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=3, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope='module')
def context():
    context = Context()
    rclpy.init(context=context, domain_id=int(os.environ['ROS_DOMAIN_ID']))
    yield context
    context.try_shutdown()


@pytest.fixture
def publisher(context):
    node = rclpy.create_node('publisher', namespace='/f', context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def follower(context):
    """Make a node that follows the topic `/f/words`, with parameters given from outside."""
    nodes = []

    def make(**parameters):
        given = [Parameter(name, value=value) for name, value in parameters.items()]
        node = rclpy.create_node(
            'follower', namespace='/f', context=context, parameter_overrides=given
        )
        nodes.append(node)
        heard = []
        return node, FollowingSubscription(node, STRING, 'words', heard.append), heard

    yield make
    for node in nodes:
        node.destroy_node()


def taken_as(publisher):
    """Return how the topic is subscribed to."""
    found = publisher.get_subscriptions_info_by_topic('/f/words')
    return [
        (item.qos_profile.reliability.name, item.qos_profile.durability.name) for item in found
    ]


def becomes(subscription, publisher, expected):
    """Whether the topic comes to be subscribed to so; a second of following, and it stays so."""
    end = time.monotonic() + TIMEOUT
    while taken_as(publisher) != expected and time.monotonic() < end:
        subscription.follow()
        time.sleep(0.02)
    for _ in range(10):
        subscription.follow()
        time.sleep(0.02)
    return taken_as(publisher) == expected


def test_it_follows_publishers_as_they_come_and_change(publisher, follower):
    _, subscription, _ = follower()
    assert subscription.topic == '/f/words'
    assert becomes(subscription, publisher, [('BEST_EFFORT', 'VOLATILE')])
    one = publisher.create_publisher(String, 'words', RELIABLE)
    assert becomes(subscription, publisher, [('RELIABLE', 'VOLATILE')])
    publisher.create_publisher(String, 'words', BEST_EFFORT)
    assert becomes(subscription, publisher, [('BEST_EFFORT', 'VOLATILE')])
    for other in list(publisher.publishers):
        if other.topic_name == '/f/words':
            publisher.destroy_publisher(other)
    assert one not in publisher.publishers
    publisher.create_publisher(String, 'words', LATCHED)
    assert becomes(subscription, publisher, [('RELIABLE', 'TRANSIENT_LOCAL')])


def test_what_was_latched_before_is_heard(publisher, follower, context):
    publisher.create_publisher(String, 'words', LATCHED).publish(String(data='early'))
    node, subscription, heard = follower()
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    end = time.monotonic() + TIMEOUT
    while not heard and time.monotonic() < end:
        subscription.follow()
        executor.spin_once(timeout_sec=0.02)
    executor.shutdown()
    assert [message.data for message in heard] == ['early']


def test_reliability_that_is_given_stays(publisher, follower):
    name = 'qos_overrides./f/words.subscription.reliability'
    _, subscription, _ = follower(**{name: 'best_effort'})
    publisher.create_publisher(String, 'words', RELIABLE)
    assert becomes(subscription, publisher, [('BEST_EFFORT', 'VOLATILE')])


def test_depth_that_is_given_stays_when_it_follows(publisher, follower):
    name = 'qos_overrides./f/words.subscription.depth'
    node, subscription, _ = follower(**{name: 7})
    publisher.create_publisher(String, 'words', RELIABLE)
    assert becomes(subscription, publisher, [('RELIABLE', 'VOLATILE')])
    assert node.get_parameter(name).value == 7


def test_nothing_is_offered_by_nobody():
    assert common_offer([]) is None


def test_the_depth_is_that_of_the_documentation():
    page = (Path(__file__).resolve().parents[2] / 'docs/tracker.md').read_text()
    depths = re.findall(r'^\| `.*\| in\b.*as its publisher, depth (\d+)', page, re.MULTILINE)
    assert depths == [str(DEPTH)] * 3

"""The pages of the nodes say what the code has, and nothing else: both ways.

Topics and services of running nodes are held against them in test_nodes and test_tracker_node,
parameters stand in config/, which test_node_parts holds.
"""

from __future__ import annotations

from types import MappingProxyType

from pneunet_ros.core.stamps import AHEAD, RESTARTED
from pneunet_ros.estimation.consistency import ConsistencyState
from pneunet_ros.estimation.pressure_watch import OTHER_PRESSURE
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.state import Counts, FusionState
from pneunet_ros.messages.builders import IMAGE_TYPE, UNREADABLE
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.link_chain import JOINT_STATES
from pneunet_ros.messages.markers import markers_output, transform_output
from pneunet_ros.messages.readings import (
    BASE_IMU,
    END_WRENCH,
    FIXED_FRAMES,
    PRESSURE,
    SENSORS,
    TARGETS,
)
from pneunet_ros.messages.tracker import TRACKER_INPUTS, TRACKER_OUTPUTS, WRONG_CAMERA_INFO
from pneunet_ros.model.domain_position import LOAD_OUT_OF_DOMAIN, OUT_OF_RANGE
from pneunet_ros.vision.rest_plane import RESTING, UPRIGHT
from pneunet_ros.vision.tracker import TrackerState
import pytest
from support.example_arms import paper_arm
from support.manuals import page, reasons_in, rows, table, topics, values

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.estimation.health import EstimatorHealth  # noqa: E402
from pneunet_ros.estimation.state import EstimatorState  # noqa: E402
from pneunet_ros.fusion.health import FusionHealth  # noqa: E402
from pneunet_ros.nodes.topics import DEPTH, DEPTH_OF, input_qos, latched_qos, output_qos  # noqa: E402
from pneunet_ros.nodes.tracker.health import TrackerHealth  # noqa: E402
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # noqa: E402
from support.random_estimates import random_estimate  # noqa: E402

NODES = ('estimator', 'tracker', 'fusion')
OF_EVERY_NODE = {
    'model_info': 'std_msgs/msg/String',
    '/diagnostics': 'diagnostic_msgs/msg/DiagnosticArray',
}
ESTIMATED = [sensor for sensor in SENSORS if sensor.needed(EstimatorSettings())]
OF_GRAVITY = {one.topic: one.type for one in (BASE_IMU, FIXED_FRAMES)}
TYPES = {
    'estimator': {
        topic.name: topic.type
        for topic in (
            *(*ESTIMATED, *OUTPUTS),
            *(markers_output(lambda: None), transform_output('tip'), JOINT_STATES),
        )
    }
    | OF_GRAVITY,
    'tracker': {topic.name: topic.type for topic in (*TRACKER_INPUTS, *TRACKER_OUTPUTS)}
    | {'image_annotated': IMAGE_TYPE},
    'fusion': {
        topic.name: topic.type for topic in (PRESSURE, TARGETS, END_WRENCH, *FUSION_OUTPUTS)
    }
    | OF_GRAVITY,
}
COUNTS = MappingProxyType({'<reason>': 1})


def in_words(profile):
    """Return a quality of service as the pages put it."""
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    words = ['reliable' if reliable else 'best effort', *['transient local'] * latched]
    return ', '.join([*words, f'depth {profile.depth}'])


@pytest.mark.parametrize('node', NODES)
def test_topics_are_those_of_the_code(node):
    written = {name: kind.replace('/', '/msg/') for name, (kind, _, _) in topics(node).items()}
    assert written == TYPES[node] | OF_EVERY_NODE


@pytest.mark.parametrize('node', NODES)
def test_quality_of_service_is_that_of_the_code(node):
    depths = {sensor.topic: depth for sensor, depth in DEPTH_OF.items()}
    for name, (_, direction, quality) in topics(node).items():
        if direction.startswith('in'):
            # The tracker's depends on who publishes: test_following.
            depth = depths.get(name, DEPTH)
            qos = latched_qos(depth) if name == FIXED_FRAMES.topic else input_qos(depth)
            expected = in_words(qos) if node != 'tracker' else 'as its publisher'
        else:
            expected = in_words(latched_qos() if 'latched' in direction else output_qos())
        assert quality.startswith(expected), name


VALUES_OF_EVERY_NODE = (
    *('model', 'kernels', 'lost', 'rivals', 'mismatched', 'frames_shed'),
    'other_descriptions',
    *('internal_errors', 'internal_errors/<kind>'),
)


def test_diagnostics_of_the_estimator_are_those_of_the_code():
    health = EstimatorHealth('/pressure', 0.0)
    health.record_pressure(random_estimate(3), 0.1, 0.001)
    state, consistency = EstimatorState(rejected=COUNTS), ConsistencyState(unmatched=COUNTS)
    report = health.report(state, EstimatorSettings(), 0.2, consistency)
    assert sorted(values('estimator')) == sorted([*VALUES_OF_EVERY_NODE, *report.values])


def test_diagnostics_of_the_tracker_are_those_of_the_code():
    health = TrackerHealth('/image', 0.0)
    state = TrackerState(rejected=COUNTS, unexplained=COUNTS)
    report = health.report(state, 0.1)
    assert sorted(values('tracker')) == sorted([*VALUES_OF_EVERY_NODE, *report.values])


def test_diagnostics_of_the_fusion_are_those_of_the_code():
    health, fusion = FusionHealth('/pressure', '/targets', 0.0), Fusion(arm=paper_arm())
    state = FusionState(counts=Counts(unused=COUNTS), readings=EstimatorState(rejected=COUNTS))
    report = health.report(state, fusion, 0.1)
    assert sorted(values('fusion')) == sorted([*VALUES_OF_EVERY_NODE, *report.values])


GRAVITY = ('estimation/base_gravity',)
REASONS = {
    'estimator': [
        UNREADABLE,
        AHEAD,
        OTHER_PRESSURE,
        OUT_OF_RANGE,
        LOAD_OUT_OF_DOMAIN,
        *(reasons_in(m) for m in (*GRAVITY, 'estimation/estimator', 'estimation/state')),
    ],
    'tracker': [
        UNREADABLE,
        RESTING,
        UPRIGHT,
        AHEAD,
        WRONG_CAMERA_INFO,
        *(
            reasons_in(m)
            for m in (
                'vision/tracker',
                'vision/rest_plane',
                'vision/rows/view',
                'vision/rows/row_search',
                'vision/rows/row_search_at_rest',
            )
        ),
    ],
    'fusion': [
        UNREADABLE,
        AHEAD,
        OTHER_PRESSURE,
        OUT_OF_RANGE,
        LOAD_OUT_OF_DOMAIN,
        *(
            reasons_in(m)
            for m in (
                *GRAVITY,
                'fusion/fusion',
                'fusion/belief_estimate',
                'fusion/frame_update',
                'fusion/state',
                'estimation/state',
            )
        ),
    ],
}


@pytest.mark.parametrize('node', NODES)
def test_reasons_are_those_of_the_code(node):
    known = reasons_in('core/stamps') - {RESTARTED}
    for item in REASONS[node]:
        known |= {item} if isinstance(item, str) else item
    written = [reason for reason, *_ in rows(node, 'reason')]
    assert sorted(written) == sorted(known)


@pytest.mark.parametrize('node', NODES)
def test_levels_are_those_of_the_code(node):
    assert [level for level, *_ in table(page(node), 'level')] == [level.name for level in Level]

"""The parts of the node without DDS: parameters and their documents, rates, levels, log."""

from __future__ import annotations

from dataclasses import replace
import math
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.readings import WrenchReading
from pneunet_ros.core.share import share_path
from pneunet_ros.effects.effect import Load
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.model.domain import Domain
from pneunet_ros.model.domain_position import locate_load
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.vision.rest_plane import RestSearch
from pneunet_ros.vision.tracker import TrackerState, Tracking
import pytest
from ruamel.yaml import YAML
from support.example_arms import paper_arm
from support.random_estimates import random_estimate
from support.random_frames import random_sightings, TARGETS
from support.refusals import refused

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.estimation.health import EstimatorHealth  # noqa: E402
from pneunet_ros.nodes.connections import rival_sentences  # noqa: E402
from pneunet_ros.nodes.estimator.configuration import PARAMETERS as ESTIMATOR  # noqa: E402
from pneunet_ros.nodes.estimator.warm_up import load_inside, warm_up  # noqa: E402
from pneunet_ros.nodes.fusion.configuration import PARAMETERS as FUSION  # noqa: E402
from pneunet_ros.nodes.log import Log  # noqa: E402
from pneunet_ros.nodes.publisher import EstimatePublisher, in_order  # noqa: E402
from pneunet_ros.nodes.ros_types import RCLPY_TYPES, serialize  # noqa: E402
from pneunet_ros.nodes.tracker.configuration import PARAMETERS as TRACKER  # noqa: E402
from pneunet_ros.nodes.tracker.health import TrackerHealth  # noqa: E402
from pneunet_ros.nodes.virtual_arm.configuration import PARAMETERS as VIRTUAL_ARM  # noqa: E402

# Parameters


TABLES = {'estimator': ESTIMATOR, 'tracker': TRACKER, 'fusion': FUSION, 'virtual_arm': VIRTUAL_ARM}
FIELDS = [(node, field) for node, table in TABLES.items() for field in table.fields]


@pytest.mark.parametrize('node', TABLES)
def test_the_shipped_parameters_are_the_defaults(node):
    content = YAML(typ='safe', pure=True).load(share_path(f'config/{node}.yaml').read_text())
    defaults = {field.name: field.default for field in TABLES[node].fields}
    assert content == {'/**': {'ros__parameters': defaults}}
    for name, default in defaults.items():
        assert type(content['/**']['ros__parameters'][name]) is type(default)


@pytest.mark.parametrize('node', TABLES)
def test_each_shipped_parameter_has_a_comment(node):
    """The only list of parameters that people read: what is fixed at the start is marked so."""
    text = share_path(f'config/{node}.yaml').read_text()
    for field in TABLES[node].fields:
        (comment,) = re.findall(rf'((?:^    #.*\n)+)    {field.name}:', text, re.MULTILINE)
        assert ('(at start)' in comment) == (field.name in TABLES[node].read_only), field.name


@pytest.mark.parametrize(
    ('node', 'field'), FIELDS, ids=lambda value: getattr(value, 'name', value)
)
def test_a_parameter_is_described(node, field):
    descriptor = TABLES[node].describe(field)
    assert field.metadata['meaning'] in descriptor.description
    ranges = len(descriptor.floating_point_range) + len(descriptor.integer_range)
    assert ranges == ('bounds' in field.metadata)
    assert descriptor.read_only == (field.name in TABLES[node].read_only)


@pytest.mark.parametrize('node', ['estimator', 'fusion'])
def test_a_direction_may_be_a_list_of_numbers(node):
    given = {'gravity': [0.0, -1.0], 'imu_from_base': [0.0, 0.0, 1.57]}
    values = TABLES[node].completed(given)
    assert (values['gravity'], values['imu_from_base']) == ('0.0, -1.0', '0.0, 0.0, 1.57')
    assert gravity_of(values['gravity']) == gravity_of(given['gravity'])
    for wrong in ({'gravity': True}, {'gravity': ['0', '-1']}, {'model_file': [0.0, -1.0]}):
        with refused(RequestError, 'wrong_type'):
            TABLES[node].completed(wrong)


# Rates and levels, with a clock of the test's own


class SilentPublisher:
    """As much of a publisher as `EstimatePublisher` needs."""

    def __init__(self):
        self.subscribers, self.published = 1, 0

    def get_subscription_count(self):
        return self.subscribers

    def publish(self, message):
        self.published += 1


class SilentNode:
    """As much of a node as `EstimatePublisher` needs."""

    def __init__(self):
        self.publishers = {}

    def create_publisher(self, kind, topic, qos, **options):
        return self.publishers.setdefault(topic, SilentPublisher())


def published_in(seconds, rate, centerline_rate, subscribers=1):
    """How many messages of each topic estimates of a steady rate bring."""
    node = SilentNode()
    serializer = MessageSerializer(types=RCLPY_TYPES, serialize=serialize, frame_id='base')
    outputs = EstimatePublisher(node, serializer, centerline_rate, OUTPUTS)
    for publisher in node.publishers.values():
        publisher.subscribers = subscribers
    estimate = random_estimate(3)
    for index in range(round(seconds * rate)):
        outputs.publish(estimate, 1000.0 + index / rate)
    return {topic: publisher.published for topic, publisher in node.publishers.items()}


@pytest.mark.parametrize(
    ('centerline_rate', 'expected'), [(30.0, 60), (0.0, 200), (1000.0, 200), (0.5, 1)]
)
def test_the_centerline_keeps_its_rate(centerline_rate, expected):
    counts = published_in(2.0, 100.0, centerline_rate)
    assert counts.pop('centerline') == pytest.approx(expected, abs=1)
    assert counts == dict.fromkeys(('state', 'shape', 'tip', 'tip_jacobian', 'curvature'), 200)


def test_nothing_is_published_for_nobody():
    assert not any(published_in(1.0, 100.0, 30.0, subscribers=0).values())


def error_at(stamp_ns=1):
    return Refusal(stamp_ns=stamp_ns, reason='no_wrench', sentence='no wrench', error=True)


def test_health_is_an_error_until_there_are_estimates_again():
    health = EstimatorHealth('/pressure', 100.0)
    state, settings = EstimatorState(), EstimatorSettings(input_timeout=0.5)
    assert health.report(state, settings, 100.4).level == Level.OK
    assert health.report(state, settings, 101.0).level == Level.ERROR
    health.record_pressure(random_estimate(), 101.1, 0.001)
    report = health.report(state, settings, 101.2)
    assert report.level == Level.OK
    assert float(report.values['rate_hz']) == pytest.approx(5.0)
    health.record_pressure(error_at(), 101.3, 0.001)
    assert health.report(state, settings, 101.4).level == Level.ERROR
    assert health.report(state, settings, 101.5).level == Level.ERROR
    health.record_pressure(random_estimate(), 101.6, 0.001)
    assert health.report(state, settings, 101.7).level == Level.OK
    assert health.report(state, settings, 105.0).level == Level.ERROR


def test_an_error_names_the_messages_dropped_meanwhile():
    health, image = EstimatorHealth('/pressure', 100.0), TrackerHealth('/image', 100.0)
    dropped = Refusal(stamp_ns=1, reason='no_stamp', sentence='no stamp', error=False)
    health.record_wrench(dropped, 100.1)
    health.record_pressure(error_at(), 100.2, 0.001)
    report = health.report(EstimatorState(), EstimatorSettings(), 100.3)
    assert (report.level, report.message) == (Level.ERROR, 'no wrench; no stamp')
    image.record_image(error_at(), 100.1)
    image.record_image(dropped, 100.2)
    assert image.report(TrackerState(), 100.3).message == 'no wrench; no stamp'


def test_values_of_an_estimate_are_empty_without_estimates():
    health, estimate = EstimatorHealth('/pressure', 100.0), random_estimate()

    def residual(now):
        return health.report(EstimatorState(), EstimatorSettings(), now).values['residual_rad']

    health.record_pressure(estimate, 100.1, 0.001)
    assert residual(100.2) == f'{estimate.shape.residual:.4g}'
    health.record_pressure(error_at(), 100.3, 0.001)
    assert residual(100.4) == ''
    health.record_pressure(estimate, 100.5, 0.001)
    assert residual(101.2) == ''  # silence


def test_pressure_that_cannot_be_used_is_silence():
    health = EstimatorHealth('/pressure', 100.0)
    dropped = Refusal(stamp_ns=1, reason='not_finite', sentence='holds NaN', error=False)
    health.record_pressure(dropped, 100.4, 0.001)
    report = health.report(EstimatorState(), EstimatorSettings(), 101.0)
    assert report.level == Level.ERROR
    assert report.message.endswith(dropped.sentence)


def frames(health, count, now, missing=(), reason=''):
    """Let a tracker have looked at some frames."""
    for _ in range(count):
        seen = range(TARGETS) if reason else missing
        tracking = Tracking(
            sightings=random_sightings(seen), curve=None, reason=reason, sentence=f'it is {reason}'
        )
        health.record_image(tracking, now)


def test_the_tracker_is_well_while_all_targets_are_seen():
    health, state = TrackerHealth('/image', 100.0), TrackerState()
    assert health.report(state, 101.0).level == Level.OK
    frames(health, 30, 101.5)
    report = health.report(state, 102.0)
    assert (report.level, report.values['rate_hz']) == (Level.OK, '30')
    assert (report.values['seen'], report.values['missing_ids']) == (str(TARGETS), '')
    # A slow camera is no silent one.
    report = health.report(state, 103.0)
    assert (report.level, report.values['rate_hz']) == (Level.OK, '0')
    assert report.message == 'tracking at 30 Hz'
    report = health.report(state, 104.0)
    assert (report.level, report.values['image_age_s']) == (Level.ERROR, '2.5')


def test_the_tracker_warns_of_targets_that_are_missing_some_of_the_time():
    health, state = TrackerHealth('/image', 100.0), TrackerState()
    frames(health, 1, 100.1, missing=(7, 2))
    frames(health, 1, 100.2, missing=(7,))
    frames(health, 1, 100.3)
    report = health.report(state, 101.0)
    assert report.level == Level.WARN
    assert report.message.endswith(' 2, 7')
    frames(health, 1, 101.1)
    assert health.report(state, 102.0).level == Level.OK


def test_the_tracker_is_an_error_while_nothing_is_explained():
    health, state = TrackerHealth('/image', 100.0), TrackerState()
    frames(health, 3, 100.1, reason='no_row')
    frames(health, 1, 100.2)
    assert health.report(state, 101.0).level == Level.WARN
    frames(health, 3, 101.1, reason='no_row')
    assert health.report(state, 102.0).level == Level.ERROR
    assert health.report(state, 103.0).level == Level.ERROR  # no frame since
    frames(health, 3, 103.1, reason='resting')
    assert health.report(state, 104.0).level == Level.WARN


def test_the_bow_of_an_arm_that_is_curved_at_rest_is_no_error():
    row = np.stack([np.linspace(0.0, 1.0, TARGETS), np.linspace(-1.0, 1.0, TARGETS) ** 2], axis=1)
    state = TrackerState(rest=RestSearch().with_frame(row, 0.1))
    for straight in (True, False):
        values = TrackerHealth('/image', 100.0, straight).report(state, 101.0).values
        assert bool(values['rest_bow']) is straight


@pytest.mark.parametrize(('error', 'level'), [(False, Level.WARN), (True, Level.ERROR)])
def test_the_tracker_tells_of_what_was_refused_once(error, level):
    health, state = TrackerHealth('/image', 100.0), TrackerState()
    refusal = Refusal(stamp_ns=0, reason='r', sentence='a jpeg is cut off', error=error)
    frames(health, 1, 100.1)
    health.note_refusal(refusal)
    report = health.report(state, 101.0)
    assert (report.level, report.message) == (level, refusal.sentence)
    assert health.report(state, 102.0).level == Level.OK


def test_the_tracker_is_an_error_until_images_can_be_looked_at_again():
    health, state = TrackerHealth('/image', 100.0), TrackerState()
    refusal = Refusal(stamp_ns=1, reason='wrong_size', sentence='wrong size', error=True)
    health.record_image(refusal, 100.1)
    for now in (101.0, 102.0):
        assert health.report(state, now).message == refusal.sentence
    frames(health, 1, 102.1)
    assert health.report(state, 103.0).level == Level.OK


def test_the_log_repeats_itself_once_a_minute():
    said = []
    log = Log(SimpleNamespace(warning=said.append, error=said.append))
    for second in range(120):
        log.warn('older', f'{second} older', float(second))
        log.error('no_wrench', f'{second} wrench', float(second))
    assert said == ['0 older', '0 wrench', '60 older', '60 wrench']


def test_what_others_send_once_they_have_begun_is_an_error_only_when_it_does_not_come():
    said = []
    log = Log(
        SimpleNamespace(
            warning=lambda text: said.append(f'warning: {text}'),
            error=lambda text: said.append(f'error: {text}'),
        )
    )
    for since_ready in (-math.inf, 0.2, 4.0, 6.0, 7.0):
        for reason in ('no_camera_info', 'wrong_size'):
            refusal = Refusal(
                stamp_ns=1,
                reason=reason,
                sentence=reason,
                error=True,
                awaits_others=reason == 'no_camera_info',
            )
            log.refusal(refusal, since_ready, 100.0 + max(since_ready, 0.0))
    assert said == ['warning: no_camera_info', 'error: wrong_size', 'error: no_camera_info']


def test_what_controllers_need_is_published_first():
    names = [topic.name for topic in in_order(OUTPUTS)]
    assert names == ['state', 'shape', 'tip', 'tip_jacobian', 'curvature', 'centerline']


# A second node


def fake_node(publishers, names, topics=('/p/tip', '/p/model_info', '/diagnostics')):
    """Make what `rival_sentences` asks a node for: who publishes on its topics, and who is."""
    return SimpleNamespace(
        publishers=[SimpleNamespace(topic_name=topic) for topic in topics],
        subscriptions=[],
        count_publishers=lambda topic: publishers.get(topic, 1),
        get_node_names_and_namespaces=lambda: names,
        get_name=lambda: 'estimator',
        get_namespace=lambda: '/p',
        get_fully_qualified_name=lambda: '/p/estimator',
    )


@pytest.mark.parametrize(
    ('publishers', 'names', 'sentence'),
    [
        ({}, [('estimator', '/p'), ('estimator', '/other'), ('tracker', '/p')], ''),
        ({'/p/model_info': 2, '/diagnostics': 3}, [('estimator', '/p')], ''),
        ({'/p/tip': 2}, [('estimator', '/p')], 'another node also publishes /p/tip'),
        ({}, 2 * [('estimator', '/p')], 'another node has the same name, /p/estimator'),
    ],
)
def test_a_second_node_in_its_place_is_noticed(publishers, names, sentence):
    assert '; '.join(rival_sentences(fake_node(publishers, names), ['/p/model_info'])) == sentence


def test_what_a_wrench_has_out_of_the_plane_is_always_told():
    health = EstimatorHealth('/pressure', 0.0)
    wrench = WrenchReading(
        stamp_ns=1, force_x=0.1, force_y=0.0, moment=0.0, frame_id='b', force_z=0.02, moment_y=-0.1
    )
    values = health.report(EstimatorState(wrench=wrench), EstimatorSettings(), 0.1).values
    assert [values[name] for name in ('force_z_n', 'moment_x_n_m', 'moment_y_n_m')] == [
        '0.02', '0', '-0.1',
    ]  # fmt: skip
    empty = health.report(EstimatorState(), EstimatorSettings(), 0.2).values
    assert empty['force_z_n'] == ''


@pytest.mark.parametrize(
    'end_load',
    [None, [[0.0, 0.0, 0.0, 0.0]], [[0.0, -0.3, 0.0, 66e3]], [[0.0, 0.0, 0.01, 10e3]]],
    ids=['no domain', 'never loaded', 'one weight', 'a moment'],
)
def test_the_warm_up_stays_inside_the_domain(end_load):
    domain = None if end_load is None else Domain(pressure=(0.0, 66e3), end_load=end_load)
    estimator = Estimator(arm=replace(paper_arm(), domain=domain))
    serializer = MessageSerializer(types=RCLPY_TYPES, serialize=serialize, frame_id='base')
    assert warm_up(estimator, serializer) == ''
    load = load_inside(estimator.arm)
    at = Load(pressure=33e3, force_x=load[0], force_y=load[1], moment=load[2])
    assert not locate_load(estimator.arm, at, 33e3).extrapolated


STARTED = """
import rclpy
from pneunet_ros.nodes.estimator import node as estimator

made, told = [], []
configured, tell = estimator.configured_estimator, estimator.EstimatorNode.publish_model_info
estimator.configured_estimator = lambda *given: made.append(given) or configured(*given)
estimator.EstimatorNode.publish_model_info = lambda self: told.append(self) or tell(self)
rclpy.init()
node = estimator.EstimatorNode()
print('made', len(made), 'told', len(told))
node.set_parameters([rclpy.parameter.Parameter('pressure_offset', value=5.0)])
print('made', len(made), 'told', len(told))
node.destroy_node()
rclpy.try_shutdown()
"""


def test_what_rclpy_declares_for_itself_configures_nothing():
    done = subprocess.run(
        [sys.executable, '-c', STARTED], capture_output=True, text=True, check=True
    )
    said = [line for line in done.stdout.splitlines() if line.startswith('made')]
    assert said == ['made 1 told 1', 'made 2 told 2']

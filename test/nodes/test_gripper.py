"""Several arms in one process: blocks of parameters, topics, shedding, and live is replay."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
import json
from multiprocessing import get_context
import os
import signal
import time
from types import SimpleNamespace

from pneunet_ros.core.errors import PneunetError, RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.gripper import GRIPPER_STATE
from pneunet_ros.messages.point_cloud import cloud_points
import pytest
from ruamel.yaml import YAML
from support.bursts import has_answered, RATES, RELIABLE, REPLAYS, text, write_bursts
from support.refusals import refused

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.estimator import configuration as estimator_configuration  # noqa: E402
from pneunet_ros.nodes.fusion import configuration as fusion_configuration  # noqa: E402
from pneunet_ros.nodes.gripper.configuration import (  # noqa: E402
    arms_of,
    block_of,
    check_blocks,
    check_own,
    GripperConfiguration,
    GripperSettings,
    is_used,
    parameters_of,
    TOPICS_OF,
)
from pneunet_ros.nodes.gripper.node import GripperNode  # noqa: E402
from pneunet_ros.nodes.load_shedding import LoadShedding, MOST_WAITING  # noqa: E402
from pneunet_ros.nodes.sensor_description import OtherDescriptions  # noqa: E402
from pneunet_ros.nodes.virtual_gripper.configuration import simulated_gripper  # noqa: E402
from pneunet_ros.nodes.virtual_gripper.node import VirtualGripperNode  # noqa: E402
from sensor_msgs.msg import FluidPressure, JointState  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from support.dds_peer import NodeProcess, Peer, running_node, SensorsPeer, TIMEOUT  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
ARMS = ('left', 'right')
READINGS = 12
KINDS = {'estimator': OUTPUTS, 'fusion': FUSION_OUTPUTS}
OWN_TOPIC = 'valves/one'


class ArmPeer(SensorsPeer):
    """All sensors of one arm of a gripper."""

    def __init__(self, arm: str, kind: str) -> None:
        outputs = tuple(replace(one, name=f'{arm}/{one.name}') for one in KINDS[kind])
        super().__init__(DOMAIN, f'{arm}/{kind}', outputs)
        topics = {name: f'{arm}/{name}' for name in self.sensors}
        topics['pressure'] = f'{arm}/{OWN_TOPIC}' if arm == 'left' else topics['pressure']
        self.sensors = {
            name: self.node.create_publisher(one.msg_type, topics[name], one.qos_profile)
            for name, one in self.sensors.items()
        }


@pytest.fixture(scope='module')
def gripper(tmp_path_factory):
    """Run a gripper that publishes every estimate."""
    reliable = [
        word.replace('/pneunet/', f'/pneunet/{arm}/').replace(name, wanted)
        for arm in ARMS
        for name, wanted in (('left/pressure', f'left/{OWN_TOPIC}'),)
        for word in RELIABLE
    ]
    rates = [word for arm in ARMS for word in ('-p', f'{arm}.centerline_rate:=0.0')]
    settings = ['-p', f'left.topics.pressure:={OWN_TOPIC}', '-p', 'left.watch_targets:=true']
    settings += ['-p', 'right.watch_targets:=true']
    output = tmp_path_factory.mktemp('gripper') / 'output'
    arguments = [*rates, *settings, *reliable]
    with running_node(output, DOMAIN, *arguments, node='gripper') as process:
        process.wait_for('ready: gripper')
        yield process
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text
        assert 'unknown parameters' not in process.text


@pytest.fixture(scope='module')
def replays():
    """Return a process for replays, as new as that of a node."""
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        yield pool


def test_every_topic_of_an_arm_may_have_another_name(gripper):
    peer = Peer(DOMAIN, 'right/estimator', ())
    below = '/pneunet/right/'

    def opened():
        names = (name for name, _ in peer.node.get_topic_names_and_types())
        return {name.removeprefix(below) for name in names if name.startswith(below)}

    assert peer.spin_until(lambda: {'fused/state', 'state', 'targets', 'model_info'} <= opened())
    assert opened() <= TOPICS_OF['estimator'] | TOPICS_OF['fusion']
    peer.close()


@pytest.mark.parametrize('kind', KINDS)
def test_each_arm_of_a_busy_gripper_is_its_replay(gripper, replays, kind, tmp_path):
    path = tmp_path / 'bursts.mcap'
    bursts = write_bursts(path, RATES['two frames'], READINGS)
    expected = replays.submit(REPLAYS[kind], path).result()
    peers = [ArmPeer(arm, kind) for arm in ARMS]
    for peer in peers:
        peer.connect([message for burst in bursts[:1] for message in burst])
    for number, burst in enumerate(bursts, 1):
        wanted = sum(name == 'pressure' for one in bursts[:number] for name, _ in one)
        for name, raw in burst:
            for peer in peers:
                peer.sensors[name].publish(raw)
        assert all(peer.spin_until(partial(has_answered, peer, wanted)) for peer in peers)
    names = [output.name for output in KINDS[kind]]
    for peer in peers:
        live = [
            dict(zip(names, map(text, messages), strict=True))
            for messages in zip(*peer.received.values(), strict=True)
        ]
        assert live == expected
        peer.close()


def test_nodes_of_one_arm_say_that_they_differ_until_something_is_set_while_they_run(tmp_path):
    unlike = ['-p', 'left.estimator.pressure_offset:=300.0', '-p', 'fusion:=true']
    domain = (DOMAIN + 75) % 101 + 1  # of no worker: a gripper of other tests has the same names
    with running_node(tmp_path / 'output', domain, *unlike, node='gripper') as process:
        process.wait_for('ready: gripper')
        peer = SensorsPeer(domain, 'gripper', ())
        sensors = {
            arm: peer.node.create_publisher(FluidPressure, f'{arm}/pressure', 10) for arm in ARMS
        }

        def differing():
            """Give what each node says of the others, once all have said something new."""
            peer.statuses.clear()
            names = {f'pneunet/{arm}/{kind}' for arm in ARMS for kind in KINDS}
            said = {}

            def is_complete():
                for status in peer.statuses:
                    values = {item.key: item.value for item in status.values}
                    said[status.name.partition(':')[0]] = values.get('other_descriptions', '')
                return names <= set(said)

            assert peer.spin_until(is_complete)
            return {name: words for name, words in said.items() if words}

        assert peer.spin_until(lambda: len(differing()) == 2)
        found = differing()
        assert set(found) == {'pneunet/left/estimator', 'pneunet/left/fusion'}
        assert all('pressure_offset' in words for words in found.values())

        nodes = {
            name: Peer(domain, name, ())
            for name in ('left/estimator', 'left/fusion', 'right/fusion')
        }
        assert nodes['left/fusion'].set(pressure_offset=25.0).successful
        assert peer.spin_until(lambda: nodes['left/estimator'].get('pressure_offset') == 25.0)
        assert peer.spin_until(lambda: not differing())
        assert nodes['right/fusion'].get('pressure_offset') == 0.0
        for node in nodes.values():
            node.close()

        assert not peer.trigger('zero_pressure').success  # nothing was read
        begin = time.monotonic()

        def are_zeroed():
            stamp = divmod(round(1e9 * (100.0 + time.monotonic() - begin)), 1_000_000_000)
            message = FluidPressure(fluid_pressure=-125.0)
            message.header.stamp.sec, message.header.stamp.nanosec = stamp
            for sensor in sensors.values():
                sensor.publish(message)
            peer.spin_for(0.05)
            return peer.trigger('zero_pressure').success

        assert peer.spin_until(are_zeroed)
        assert peer.spin_until(lambda: not differing())
        peer.close()
        assert process.end(signal.SIGTERM) == 0, process.text


def test_a_node_that_reads_another_pressure_is_of_another_arm():
    others = OtherDescriptions()
    said = {'node': '/p/other', 'pressure': '/valves/2', 'sensors': {'pressure_offset': 5.0}}
    text = json.dumps(said | {'sensors_set_ns': {'pressure_offset': 70}})
    assert others.take(text, '/valves/1') == ({}, {})
    assert list(others.differences('/p/one', {'pressure_offset': 0.0}, ['/p/other'])) == []
    assert others.take(text, '/valves/2')[0] == {'pressure_offset': 5.0}


def test_nodes_of_one_arm_with_different_models_say_so():
    others = OtherDescriptions()
    said = {'node': '/p/fusion', 'pressure': '/p', 'hash': 'abc', 'sensors': {}}
    others.take(json.dumps(said), '/p')
    (sentence,) = others.differences('/p/estimator', {'model': 'def'}, ['/p/fusion'])
    assert 'abc' in sentence and 'def' in sentence


def test_a_setting_is_newer_than_the_last_though_the_clock_was_set_back(monkeypatch):
    others, before = OtherDescriptions(), {'pressure_offset': 0.0}
    others.note_set(before, {'pressure_offset': 1.0}, {'pressure_offset': 2**62})
    others.note_set({'pressure_offset': 1.0}, {'pressure_offset': 2.0}, {})
    assert others.set_ns['pressure_offset'] > 2**62


def test_what_was_set_last_is_taken_over_with_its_time():
    others, before = OtherDescriptions(), {'pressure_offset': 0.0, 'wrench_sign': 1}
    said = {'node': '/p/estimator', 'sensors': {'pressure_offset': 5.0, 'wrench_sign': -1}}
    assert others.take(json.dumps(said), '/p') == ({}, {})  # as it was started: only reported
    newer = json.dumps(said | {'sensors_set_ns': {'pressure_offset': 70}})
    assert others.take(newer, '/p') == ({'pressure_offset': 5.0}, {'pressure_offset': 70})
    others.note_set(before, before | {'pressure_offset': 5.0}, {'pressure_offset': 70})
    assert others.set_ns == {'pressure_offset': 70}
    assert others.take(newer, '/p') == ({}, {})
    others.note_set(before, before | {'pressure_offset': 6.0}, {})
    assert others.set_ns['pressure_offset'] > 70
    assert others.take(newer, '/p') == ({}, {})  # what was set here is newer


@pytest.mark.parametrize('words', ['', '[]', '1', '{"node": "/a"}', '{"node": [], "sensors": 1}'])
def test_what_is_no_description_of_a_node_is_passed_over(words):
    others = OtherDescriptions()
    assert others.take(words, '/p') == ({}, {})
    assert list(others.differences('/p/fusion', {'wrench_sign': 1}, ['/a'])) == []


def test_a_node_that_is_gone_differs_no_more():
    others, own = OtherDescriptions(), {'wrench_sign': 1, 'pressure_offset': 0.0}
    others.take(json.dumps({'node': '/p/estimator', 'sensors': {'wrench_sign': -1}}), '/p')
    (sentence,) = others.differences('/p/fusion', own, ['/p/estimator'])
    assert 'wrench_sign' in sentence
    assert 'pressure_offset' not in sentence
    assert list(others.differences('/p/fusion', own, [])) == []
    assert list(others.differences('/p/estimator', own, ['/p/estimator'])) == []


def test_a_block_goes_to_the_nodes_that_have_its_parameters():
    block = block_of(
        'left',
        {
            'arms': ['left'],
            'left.wrench_sign': -1,
            'left.fusion.use_wrench': False,
            'left.camera_file': 'camera.yaml',
            'left.topics.pressure': 'valves/1',
            'right.wrench_sign': 1,
        },
    )
    assert block.topics == {'pressure': 'valves/1'}
    assert block.parameters == {
        'estimator': {'wrench_sign': -1},
        'fusion': {'wrench_sign': -1, 'use_wrench': False},
        'tracker': {'camera_file': 'camera.yaml'},
    }


@pytest.mark.parametrize('key', ['wrench_sing', 'fusion.wrench_required', 'topics', 'pump.rate'])
def test_a_key_that_nobody_knows_is_refused(key):
    with refused(RequestError, 'unknown_key') as caught:
        block_of('left', {f'left.{key}': 1})
    assert key in str(caught.value)


@pytest.mark.parametrize('arms', [(), ('a', 'a'), ('a b',), ('fusion',), ('',)])
def test_names_that_cannot_be_are_refused(arms):
    with pytest.raises(RequestError):
        GripperSettings(arms=arms)


def test_what_a_node_of_an_arm_would_refuse_is_refused_before_it_starts():
    check_blocks({'left': {'wrench_sign': -1}})
    for wrong in ({'wrench_sign': 2}, {'model_file': 'none.yaml'}, {'fusion': {'free_tip': 1}}):
        with pytest.raises(PneunetError):
            check_blocks({'left': wrong})


@pytest.mark.parametrize('of_node', [estimator_configuration, fusion_configuration])
def test_arms_of_one_model_may_differ_in_their_direction_of_gravity(of_node):
    configured = (
        of_node.configured_estimator
        if of_node is estimator_configuration
        else of_node.configured_fusion
    )
    values = of_node.PARAMETERS.completed({})
    one = configured(values, None)
    other = configured({**values, 'gravity': '0, -1'}, one)
    assert other != one


def test_the_shipped_parameters_are_the_defaults():
    (content,) = YAML(typ='safe').load(share_path('config/gripper.yaml')).values()
    given = content['ros__parameters']
    check_blocks(given)
    defaults = GripperSettings()
    names = ('arms', 'fusion', 'tracker', 'model_file', 'frame_id')
    assert {name: given[name] for name in names} == {
        name: list(value) if isinstance(value := getattr(defaults, name), tuple) else value
        for name in names
    }


MOUNTED = {
    'left.mount': [0.0, -0.045, 0.0, 0.0, 0.0, 0.0],
    'right.mount': [0.0, 0.045, 0.0, 3.1415927, 0.0, 0.0],
    'left.frame_id': 'left_base',
    'right.frame_id': 'right_base',
}


def test_every_mounted_arm_has_its_own_frame():
    settings = GripperSettings()
    _, gripper = arms_of(settings, MOUNTED)
    assert set(gripper.mounts) == set(ARMS)
    for wrong in (
        {'right.frame_id': 'left_base'},
        {'right.frame_id': settings.frame_id},
        {'right.estimator.frame_id': 'finger'},  # not that of its fusion
    ):
        with refused(RequestError, 'given_twice'):
            arms_of(settings, MOUNTED | wrong)
    of_estimators = MOUNTED | {f'{arm}.estimator.frame_id': f'{arm}_base' for arm in ARMS}
    for name in ('left.frame_id', 'right.frame_id'):
        del of_estimators[name]
    with refused(RequestError, 'given_twice'):
        arms_of(settings, of_estimators)


def test_no_two_arms_publish_the_transform_of_one_tip():
    both = {f'{arm}.publish_tf': True for arm in ARMS}
    with refused(RequestError, 'given_twice'):
        arms_of(GripperSettings(), both)
    arms_of(GripperSettings(), both | {'left.tip_frame': 'left_tip'})
    arms_of(GripperSettings(), {'left.publish_tf': True})


@pytest.mark.parametrize('name', ['presure', 'pressure_command'])
def test_a_topic_that_no_node_of_an_arm_has_is_refused(name):
    given = {f'left.topics.{name}': '/valves/one'}
    with refused(RequestError, 'unknown_key') as caught:
        arms_of(GripperSettings(), given)
    assert name in str(caught.value)


def test_a_topic_of_a_node_that_is_not_started_is_without_effect_but_not_refused():
    for name in ('image_raw', 'image_raw.compressed', 'camera_info'):
        arms_of(GripperSettings(), {f'left.topics.{name}': '/camera/one'})
        assert not is_used(GripperSettings(), f'topics.{name}')
        assert is_used(GripperSettings(tracker=True), f'topics.{name}')


def test_what_is_given_for_nodes_that_are_not_started_has_no_effect():
    without = GripperSettings(fusion=False)
    assert not is_used(without, 'mount') and not is_used(without, 'fusion.use_wrench')
    assert not is_used(without, 'clamp_pixel') and is_used(without, 'wrench_sign')
    assert is_used(GripperSettings(), 'mount') and is_used(without, 'topics.pressure')


@pytest.mark.parametrize('name', ['qos_overrides./gripper/state.publisher.depth', 'stations'])
def test_a_quality_of_service_of_a_topic_that_is_not_open_ends_no_gripper(name):
    node = SimpleNamespace(
        configuration=GripperConfiguration(node=GripperSettings(fusion=False)),
        members=[],
        has_parameter=lambda name: False,
        _parameter_overrides={name: 5},
    )
    if name == 'stations':
        with refused(RequestError, 'unknown_key'):
            GripperNode.check_given(node)
    else:
        GripperNode.check_given(node)


def test_a_model_is_given_to_the_nodes_of_an_arm_only_if_there_is_one():
    """Otherwise an empty one hides what a file gives to the node of an arm itself."""
    block = block_of('left', {})
    assert 'model_file' not in parameters_of(GripperSettings(), block, 'fusion')
    given = parameters_of(GripperSettings(model_file='a.yaml'), block, 'fusion')
    assert given['model_file'] == 'a.yaml'


def test_what_a_file_gives_a_node_of_an_arm_itself_is_not_hidden_by_the_gripper(tmp_path):
    path = tmp_path / 'hand.yaml'
    gripper = '/**/gripper: {ros__parameters: {arms: [left], model_file: a.yaml}}\n'
    node, given = '/hand/left/fusion', {'model_file': 'a.yaml'}
    for name in (node, 'hand/left/fusion', '/**/left/fusion'):
        path.write_text(f'{gripper}{name}: {{ros__parameters: {{model_file: b.yaml}}}}\n')
        with refused(RequestError, 'given_twice') as caught:
            check_own([path], node, given)
        assert 'model_file' in str(caught.value)
        check_own([path], '/hand/right/fusion', given)
        check_own([path], node, {'model_file': 'b.yaml'})
    path.write_text(f'{gripper}/**: {{ros__parameters: {{model_file: b.yaml}}}}\n')
    check_own([path], node, given)  # what all nodes are given is not its own


def test_the_gripper_does_not_start_where_it_would_hide_it(tmp_path):
    path = tmp_path / 'hand.yaml'
    path.write_text('/**/left/estimator: {ros__parameters: {model_file: b.yaml}}\n')
    model = ['-p', f'model_file:={share_path("config/paper_arm.yaml")}']
    words = [*model, '--params-file', str(path)]
    process = NodeProcess(tmp_path / 'output', DOMAIN, *words, node='gripper')
    assert process.process.wait(TIMEOUT) == 2
    assert 'its own model_file' in process.text


def test_mounts_are_of_all_arms_or_of_none():
    assert arms_of(GripperSettings(), {})[1] is None
    with refused(RequestError, 'missing'):
        arms_of(GripperSettings(), {'left.mount': MOUNTED['left.mount']})
    played, frames = simulated_gripper([], '/hand/gripper')
    assert set(played.mounts) == set(ARMS)
    assert frames == {arm: f'{arm}_base' for arm in ARMS}
    with refused(RequestError, 'missing'):
        simulated_gripper([share_path('config/fusion.yaml')], '/hand/gripper')


class Hand(Peer):
    """Commands a gripper, and hears its answer."""

    def __init__(self):
        state = replace(GRIPPER_STATE, name='gripper/state')
        super().__init__(DOMAIN, 'gripper', (state,))
        self.commands = self.node.create_publisher(JointState, 'gripper/command', 10)

    def grasp(self):
        """Return the next answer."""
        self.received['gripper/state'].clear()
        assert self.spin_until(lambda: self.received['gripper/state'])
        (point,) = cloud_points(self.received['gripper/state'][-1])
        return point

    def comes_to(self, holds):
        """Wait until an answer is as it should be, and the next is as well."""
        assert self.spin_until(lambda: holds(self.grasp()) and holds(self.grasp())), self.grasp()


def test_a_virtual_gripper_closes_on_its_object_with_the_wanted_force(tmp_path):
    own = ['-p', 'object_width:=0.03']
    own += ['-p', 'rate:=25.0', '-p', 'frame_rate:=10.0']  # less CPU
    arms = ['-p', f'model_file:={share_path("config/lab_arm.yaml")}']
    arms += ['--params-file', str(share_path('config/gripper.yaml'))]
    arms += [word for arm in ARMS for word in ('-p', f'{arm}.fusion.use_wrench:=false')]
    with (
        running_node(tmp_path / 'virtual', DOMAIN, *own, node='virtual_gripper') as virtual,
        running_node(tmp_path / 'gripper', DOMAIN, *arms, node='gripper') as process,
    ):
        virtual.wait_for('ready: virtual')
        process.wait_for('ready: gripper')
        hand = Hand()
        hand.comes_to(lambda point: point['touching'] == 0 and abs(point['width'] - 0.078) < 1e-3)
        assert hand.spin_until(lambda: hand.commands.get_subscription_count())
        hand.commands.publish(JointState(position=[0.0], effort=[0.03]))
        # An object of 30 N/m gives by 1 mm on each side.
        hand.comes_to(
            lambda point: (
                point['touching'] == 2
                and abs(point['force'] - 0.06) < 3e-3
                and abs(point['width'] - 0.028) < 1e-3
                and abs(point['balance_y']) < 3e-3
            )
        )
        hand.commands.publish(JointState(position=[0.07]))
        hand.comes_to(
            lambda point: (
                point['touching'] == 0
                and point['force'] == 0.0
                and abs(point['width'] - 0.07) < 1e-3
            )
        )
        hand.close()
        assert process.end() == 0 and virtual.end() == 0, process.text


@pytest.mark.parametrize('key', ['left: {wrench_sing: 1}', 'pressure_unit: kPa', 'ring: {a: 1}'])
def test_a_key_without_effect_is_one_sentence(tmp_path, key):
    """Whether it is in a block, or given to the gripper alone, or to an arm that is not there."""
    path = tmp_path / 'own.yaml'
    path.write_text(f'/**/gripper:\n  ros__parameters: {{{key}}}\n')
    process = NodeProcess(tmp_path / 'output', DOMAIN, '--params-file', str(path), node='gripper')
    assert process.process.wait(120) == 2
    last = process.text.splitlines()[-1]
    assert key.replace(': {', '.').partition(':')[0] in last
    assert 'Traceback' not in process.text


class Member:
    """A node of an arm whose service says this."""

    def __init__(self, name, success):
        self.name, self.success, self.asked = name, success, 0

    def get_fully_qualified_name(self):
        return self.name

    def reload_model(self, request, response):
        self.asked += 1
        response.success, response.message = self.success, 'said'
        return response


@pytest.mark.parametrize('of_gripper', [GripperNode, VirtualGripperNode])
def test_the_models_of_all_arms_are_read_again(of_gripper):
    members = [Member('/left/fusion', True), Member('/right/fusion', False)]
    gripper = object.__new__(of_gripper)
    gripper.members = members
    if of_gripper is VirtualGripperNode:
        gripper.members = {one.name: one for one in members}
    answer = gripper.reload_model(None, Trigger.Response())
    assert [one.asked for one in members] == [1, 1]
    assert not answer.success
    assert answer.message == '/left/fusion: said; /right/fusion: said'


@pytest.mark.parametrize(
    'timeout, span, full',
    [(0.5, 0.4, False), (0.5, 0.6, True), (0.001, 0.1, False), (0.001, 0.3, True)],
)
def test_readings_wait_for_input_timeout_and_are_never_lost_before_frames(timeout, span, full):
    shedding = LoadShedding()
    shedding.timeout = lambda: timeout
    shedding.span = lambda: round(1e9 * span)
    assert shedding.is_full() is full


@pytest.mark.parametrize(
    'interval_ns, most', [(1_000_000, MOST_WAITING), (40_000_000, 6), (100_000_000, 3)]
)
def test_frames_are_left_out_from_when_a_node_is_late_until_only_their_reading_waits(
    interval_ns, most
):
    shedding, taken, waiting, noted = LoadShedding(), [], [0], []
    shedding.backlog = lambda: (waiting[0], interval_ns * max(waiting[0] - 1, 0))
    take = shedding.drop_frames_if_late(lambda message, info: taken.append(message), noted.append)
    counts = [0, most - 1, most, most - 1, 2, 1, 0]
    for count in counts:
        waiting[0] = count
        take(count, f'number of {count}')
    assert taken == [0, most - 1, 1, 0]
    assert shedding.total == len(noted) == 3  # they do not look like frames that were lost
    assert shedding.sentence().startswith('3 frames')
    assert shedding.sentence() == ''
    waiting[0] = most
    assert shedding.sentence().startswith(f'{most} pressure readings')

"""The node as it runs: real processes, real DDS, and what it makes of good and bad input."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
import dataclasses
from importlib.util import find_spec
import json
import math
from multiprocessing import get_context
import os
import re
import signal
import time

import numpy as np
from pneunet_ros import __version__
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.effects import EFFECTS
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.files.model_file import load_model, model_hash, save_model
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.messages.estimate import OUTPUTS, SHAPE_POINT
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.offline.replay import input_topics, steps
from pneunet_ros.recordings.lab_files import write_lab
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support import made_recordings as bags
from support.lab_run import true_model
from support.manuals import same_as_running
from support.random_estimates import plain

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
import rclpy  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import FluidPressure, Imu  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from support.dds_peer import EstimatorPeer, running_node, START_TIMEOUT  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

# The node that most tests share, and those with a node of their own, must not hear each other.
DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
OTHER_DOMAIN = (DOMAIN + 50) % 101 + 1

# What gives every estimate on every topic, and takes every reading sent.
EVERYTHING = (
    *('-p', 'centerline_rate:=0.0', '-p', 'input_timeout:=600.0', '-p', 'publish_markers:=true'),
    *('-p', 'qos_overrides./pneunet/pressure.subscription.reliability:=reliable'),
    *('-p', 'qos_overrides./pneunet/end_wrench.subscription.reliability:=reliable'),
)


@pytest.fixture(scope='module')
def node(tmp_path_factory):
    """Run a node that ends cleanly when asked to, after all that these tests did to it."""
    output = tmp_path_factory.mktemp('node') / 'output'
    with running_node(output, DOMAIN, *EVERYTHING) as process:
        process.wait_for('ready')
        yield process
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


@pytest.fixture(scope='module')
def connected(node):
    peer = EstimatorPeer(DOMAIN)
    peer.connect()
    yield peer
    peer.close()


@pytest.fixture
def peer(connected):
    """Return the peer of a node that remembers nothing."""
    connected.start_anew()
    return connected


@pytest.fixture
def lonely_peer():
    """Give a peer for a node of the test's own."""
    peer = EstimatorPeer(OTHER_DOMAIN)
    yield peer
    peer.close()


# Live and replay


@pytest.fixture(scope='module')
def replays():
    """Return a process for replays, as new as that of a node.

    Kernels that many tests have compiled here, in whatever order, may differ in the last digit of
    a standard deviation.
    """
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        yield pool


MODEL = share_path('config/paper_arm.yaml')


def played_back(path, model=MODEL):
    """Replay a recording: each message with what it brings by topic, or None."""
    recording = open_recording(path)
    estimator = Estimator(arm=load_model(model))
    frame_id = estimator.settings.frame_id
    for step in steps(recording, estimator, input_topics(recording, estimator, {})):
        messages = None
        if isinstance(step.outcome, ShapeEstimate):
            messages = {
                output.name: output.encode(step.outcome, frame_id, ROSBAGS_TYPES)
                for output in OUTPUTS
            }
        yield step.message, messages


def live_answer(peer, topic, raw, *, is_expected):
    """Send a reading to the node, and return the messages by topic that it brings, or None."""
    publishers = {'pressure': peer.pressures, 'base_imu': peer.imus}
    publishers.get(topic.rsplit('/', 1)[1], peer.wrenches).publish(raw)
    if is_expected:
        assert peer.spin_until(lambda: all(peer.outputs().values())), peer.outputs()
    else:
        peer.barrier()
    got = {name: messages.pop() for name, messages in peer.received.items() if messages}
    assert not any(peer.outputs().values())
    return got or None


def exactly(messages):
    """Messages of either binding as text that tells the last bit of every number."""
    return messages and {name: repr(plain(messages[name])) for name in sorted(messages)}


def same_live_as_replayed(peer, replays, path, model=MODEL):
    """Compare all messages of all topics field by field; returns how many estimates there were."""
    estimates = 0
    expected = replays.submit(replayed_texts, path, model).result()
    for topic, raw, replayed in expected:
        live = live_answer(peer, topic, raw, is_expected=replayed is not None)
        assert exactly(live) == replayed
        estimates += live is not None
    return estimates


def replayed_texts(path, model):
    """Give topic, bytes and `exactly` of every step of a replay."""
    return [
        (message.topic, bytes(message.raw), exactly(messages))
        for message, messages in played_back(path, model)
    ]


def test_live_equals_replay_bit_for_bit(peer, replays, tmp_path):
    """A part of the shipped recording, over all its loads."""
    recording = open_recording(share_path('bags/table1'))
    part = tmp_path / 'part.mcap'
    with write_recording(part) as writer:
        topics = {topic.name: writer.add_copy(topic) for topic in recording.topics}
        for message in recording.raw_messages(list(topics)):
            if round(message.log_time_ns * 1e-9 / 0.05) % 20 == 0:
                writer.write_raw(topics[message.topic], message.log_time_ns, message.raw)
    assert same_live_as_replayed(peer, replays, part) > 80


def test_live_equals_replay_for_an_arm_with_a_past(lonely_peer, replays, tmp_path):
    """Lag, play, creep and softening, also where readings are refused and time jumps back."""
    effects = (
        EFFECTS['pressure_lag'](time_constant=0.2),
        EFFECTS['hysteresis'](width=1e3),
        EFFECTS['creep'](amplitude=0.1, time_constant=2.0),
        EFFECTS['softening'](loss=0.2),
    )
    model, readings = tmp_path / 'model.yaml', tmp_path / 'bad.mcap'
    save_model(dataclasses.replace(load_model(MODEL), effects=effects), model)
    write_bad_readings(readings)
    arguments = (*EVERYTHING, '-p', f'model_file:={model}')
    with running_node(tmp_path / 'output', OTHER_DOMAIN, *arguments) as node:
        node.wait_for('ready')
        lonely_peer.connect()
        assert same_live_as_replayed(lonely_peer, replays, readings, model) > 20
        assert node.end(signal.SIGTERM) == 0, node.text


def test_live_equals_replay_on_a_base_that_turns(lonely_peer, replays, tmp_path):
    """And an Imu in g among its readings."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    turning = dataclasses.replace(
        scenario,
        protocol=dataclasses.replace(scenario.protocol, duration=5.0, rest=0.2, ramp=0.3),
        rates=Rates(pressure=20.0, wrench=20.0, frames=1.0, imu=20.0),
        motion=LabMotion(gravity_y=-1.0, turn_angle=(0.0, 1.0), inertia=0.0),
    )
    recording = simulate(turning)
    imu = recording.imu.copy()
    imu[50] /= STANDARD_GRAVITY
    path = tmp_path / 'turning.mcap'
    given = dataclasses.replace(recording, imu=imu)
    write_lab(given, path, overwrite=False, on_progress=lambda: None)
    model = tmp_path / 'model.yaml'
    save_model(true_model(turning), model)
    arguments = (*EVERYTHING, '-p', f'model_file:={model}')
    with running_node(tmp_path / 'output', OTHER_DOMAIN, *arguments) as node:
        node.wait_for('ready')
        lonely_peer.connect()
        for _ in range(20):  # until the node hears them
            lonely_peer.imus.publish(Imu())
            lonely_peer.spin_for(0.05)
        lonely_peer.start_anew()
        assert same_live_as_replayed(lonely_peer, replays, path, model) > 80
        assert node.end(signal.SIGTERM) == 0, node.text


def write_bad_readings(path):
    """Good readings with all kinds of bad ones in between, and a jump back in time at the end."""
    good = [(kind, 1.0 + 0.05 * index) for index in range(10) for kind in ('wrench', 'pressure')]
    readings = [
        *((kind, at, 20e3 if kind == 'pressure' else 0.1) for kind, at in good),
        ('pressure', 1.50, math.nan),
        ('wrench', 1.50, math.inf),
        ('pressure', 1.50, 21e3),
        ('pressure', 1.50, 22e3),  # the same stamp again
        ('pressure', 1.45, 22e3),  # a little older
        ('pressure', 1.90, 23e3),
        ('pressure', 2.00, 24e3),  # the wrench is from 1.45
        ('wrench', 2.05, 0.12),
        ('pressure', 2.05, 25e3),
        ('pressure', 2.10, 80e3),
        ('pressure', 2.15, 67e3),  # extrapolated
        ('pressure', 2.20, 131e3),
        ('pressure', 3602.20, 26e3),  # an hour ahead, and of no consequence
        ('pressure', 2.25, 26e3),
        *((kind, at - 0.9, 30e3 if kind == 'pressure' else 0.2) for kind, at in good),
    ]
    with write_recording(path) as writer:
        topics = {
            'pressure': (writer.add(bags.PRESSURE, PRESSURE_TYPE), bags.pressure),
            'wrench': (writer.add(bags.WRENCH, WRENCH_TYPE), bags.wrench),
        }
        for index, (kind, seconds, value) in enumerate(readings):
            topic, make = topics[kind]
            writer.write(topic, index * bags.STEP_NS, make(round(seconds * 1e9), value))


def test_live_equals_replay_where_readings_are_refused(peer, replays, tmp_path):
    readings = tmp_path / 'bad.mcap'
    write_bad_readings(readings)
    before = peer.report()[2]
    assert same_live_as_replayed(peer, replays, readings) == 25
    after = peer.report()[2]
    reasons = [name.partition('/')[2] for name in after if '/' in name]
    assert {name: rejected(after, name) - rejected(before, name) for name in reasons} == {
        'not_finite': 2,
        'duplicate': 1,
        'older': 1,
        'stale_wrench': 2,
        'out_of_range': 2,
        'ahead': 1,
    }
    assert int(after['resets']) == int(before['resets']) + 1


# Bad input


def test_a_second_node_of_the_name_is_noticed_and_so_is_its_end(peer, tmp_path):
    expect_estimate(peer, 100.0)
    with running_node(tmp_path / 'second', DOMAIN) as second:
        second.wait_for('ready')
        # Names and topics of a process are discovered one after the other.
        both = '/pneunet/centerline', '/pneunet/estimator'
        assert peer.spin_until(lambda: all(one in peer.report()[2]['rivals'] for one in both))
        level, message, values = peer.report()
        assert level in (Level.WARN, Level.ERROR)  # meanwhile nobody sends any pressure
        assert values['rivals'] in message
        assert 'model_info' not in message
        assert second.end(signal.SIGTERM) == 0, second.text
    # On a busy machine the end is noticed only when the lease of its participant runs out.
    assert peer.spin_until(lambda: peer.report()[2]['rivals'] == '', timeout=60.0)


def test_publishers_that_compete_or_cannot_be_heard_are_named_while_they_last(peer):
    expect_estimate(peer, 100.0)
    rival = rclpy.create_node('rival', namespace='/pneunet', context=peer.context)
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    rival.create_publisher(FluidPressure, 'pressure', best_effort)  # the node wants reliable
    rival.create_publisher(String, 'targets', 1)
    assert peer.spin_until(lambda: '/pneunet/targets' in peer.report()[2]['mismatched'])
    level, message, values = peer.report()
    assert level >= Level.WARN
    assert '/pneunet/peer, /pneunet/rival' in values['rivals']
    assert '/pneunet/pressure of /pneunet/rival' in values['mismatched']
    assert values['mismatched'] in message
    rival.destroy_node()
    for kind in ('rivals', 'mismatched'):
        gone = peer.spin_until(lambda kind=kind: peer.report()[2][kind] == '', timeout=30.0)
        assert gone, peer.report()


def expect_estimate(peer, seconds, value=30e3):
    """Send good readings and return the shape."""
    peer.received['shape'].clear()
    peer.send(seconds, value)
    assert peer.spin_until(lambda: peer.received['shape'])
    (shape,) = peer.received['shape']
    sent = divmod(round(seconds * 1e9), 1_000_000_000)
    assert (shape.header.stamp.sec, shape.header.stamp.nanosec) == sent
    assert shape.is_dense
    assert np.isfinite(np.frombuffer(shape.data, SHAPE_POINT)['x']).all()
    return shape


def same_shape(left, right):
    """Whether two shapes agree but for what is left by solving from different neighbors."""
    angles = (np.frombuffer(message.data, SHAPE_POINT)['theta'] for message in (left, right))
    return np.allclose(*angles, rtol=0.0, atol=1e-8)


def pressure_with_bad_stamp(peer):
    message = FluidPressure(fluid_pressure=30e3)
    message.header.stamp.nanosec = 4_000_000_000
    peer.pressures.publish(message)


def test_dropped_readings_are_counted_by_reason(peer):
    expect_estimate(peer, 100.0)
    before = peer.report()[2]
    peer.pressure(100.1, math.nan)
    peer.pressure(100.0)
    peer.pressure(99.7)
    pressure_with_bad_stamp(peer)
    peer.barrier()
    level, _, after = peer.report()
    assert Level(level).name == 'WARN'
    for reason in ('not_finite', 'duplicate', 'older', 'unreadable'):
        assert rejected(after, reason) == rejected(before, reason) + 1
    assert len(peer.received['shape']) == 1
    expect_estimate(peer, 100.1)
    assert peer.report()[0] == Level.OK


def rejected(values, reason):
    """How many readings were rejected for a reason, by the values of diagnostics."""
    return int(values.get(f'rejected/{reason}', 0))


STOPPED = {
    'stale': (101.0, 30e3, 'stale_wrench', 'wrench_timeout = 0.5 s'),
    'absolute': (100.1, 131e3, 'out_of_range', 'set pressure_reference to absolute'),
    'too high': (100.1, 80e3, 'out_of_range', 'pressure 80 kPa is outside the calibrated range'),
}


@pytest.mark.parametrize('what', STOPPED)
def test_no_shape_is_better_than_a_wrong_one(peer, what):
    seconds, value, reason, words = STOPPED[what]
    expect_estimate(peer, 100.0)
    before = peer.report()[2]
    peer.pressure(seconds, value)
    peer.barrier()
    level, message, after = peer.report()
    assert Level(level).name == 'ERROR'
    assert words in message
    assert rejected(after, reason) == rejected(before, reason) + 1
    assert len(peer.received['shape']) == 1
    expect_estimate(peer, 101.1)


@pytest.mark.parametrize(
    ('reason', 'frame_id', 'force', 'level'),
    [('wrong_frame', 'tool0', 0.1, 'ERROR'), ('not_finite', 'pneunet_base', math.inf, 'WARN')],
)
def test_a_bad_wrench_is_refused_and_the_last_good_one_used(peer, reason, frame_id, force, level):
    good = expect_estimate(peer, 100.0)
    before = peer.report()[2]
    peer.wrench(100.1, force, frame_id)
    peer.barrier()
    peer.pressure(100.1)
    assert peer.spin_until(lambda: len(peer.received['shape']) == 2)
    assert same_shape(peer.received['shape'][-1], good)
    found, _, after = peer.report()
    assert Level(found).name == level
    assert rejected(after, reason) == rejected(before, reason) + 1


def test_without_a_wrench_there_is_no_estimate(peer):
    peer.pressure(100.0)
    peer.barrier()
    level, _, values = peer.report()
    assert Level(level).name == 'ERROR'
    assert int(values['rejected/no_wrench']) > 0
    assert not any(peer.outputs().values())
    expect_estimate(peer, 100.1)


def test_a_jump_back_in_time_starts_anew(peer):
    expect_estimate(peer, 100.0)
    before = peer.report()[2]
    expect_estimate(peer, 50.0)
    after = peer.report()[2]
    assert int(after['resets']) == int(before['resets']) + 1


def test_extrapolation_is_published_with_a_warning(peer):
    expect_estimate(peer, 100.0)
    peer.report()
    expect_estimate(peer, 100.1, 67e3)
    level, message, values = peer.report()
    assert Level(level).name == 'WARN'
    assert 'extrapolated' in message
    assert values['extrapolated'] == 'True'


def test_diagnostics_hold_all_numbers(peer):
    for index in range(20):
        expect_estimate(peer, 100.0 + 0.01 * index)
    level, message, values = peer.report()
    assert Level(level).name == 'OK', message
    assert float(values['residual_rad']) < 1e-6
    assert int(values['iterations']) >= 0
    assert float(values['solve_time_s']) > 0.0
    assert float(values['rate_hz']) >= 0.0
    assert 0.0 <= float(values['pressure_age_s']) <= float(values['wrench_age_s'])
    assert float(values['wrench_lag_s']) == 0.0
    assert 0.0 < float(values['latency_p50_s']) <= float(values['latency_p99_s'])
    assert int(values['estimates']) >= 20
    assert values['stable'] == 'True'
    assert values['warnings'] == ''
    assert float(values['pressure_offset_pa']) == 0.0
    assert values['model'] == model_name(share_path('config/paper_arm.yaml'))
    status, namespace = peer.statuses[-1], peer.node.get_namespace().strip('/')
    assert (status.name, status.hardware_id) == (f'{namespace}/estimator: shape', namespace)


def test_topics_and_services_are_those_of_the_page(peer):
    same_as_running(peer.node, 'estimator', left_out={'/tf', '/tf_static', 'joint_states'})


def test_markers_are_drawn_where_the_centerline_is(peer):
    drawn = []
    subscription = peer.node.create_subscription(MarkerArray, 'markers', drawn.append, 10)
    for index in range(200):
        expect_estimate(peer, 300.0 + 0.01 * index)
        if drawn:
            break
    assert drawn
    peer.start_anew()
    drawn.clear()
    peer.send(400.0)
    assert peer.spin_until(lambda: drawn and peer.received['centerline'])
    (path,), (markers,) = peer.received['centerline'], drawn
    line = markers.markers[0]
    assert line.header == path.header
    assert line.points == [pose.pose.position for pose in path.poses]
    peer.node.destroy_subscription(subscription)


# Services and parameters


def model_name(path):
    arm = load_model(path)
    return f'{arm.name} {model_hash(arm)[:12]}'


def test_model_info_is_there_for_those_who_come_late(peer):
    arm = load_model(share_path('config/paper_arm.yaml'))
    info = json.loads(peer.model_info())
    assert info['name'] == arm.name
    assert info['hash'] == model_hash(arm)
    assert info['pressure_range'] == [0.0, 66000.0]
    assert info['length'] == arm.length
    assert info['pressure_offset'] == 0.0
    assert info['effects'] == {}
    assert info['version'] == __version__


def test_zero_pressure_finds_the_offset(peer):
    assert not peer.trigger('zero_pressure').success
    for index in range(10):
        expect_estimate(peer, 100.0 + 0.01 * index, 300.0 + index % 2)
    answer = peer.trigger('zero_pressure')
    assert answer.success, answer.message
    try:
        assert peer.get('pressure_offset') == pytest.approx(-300.5)
        assert json.loads(peer.model_info())['pressure_offset'] == pytest.approx(-300.5)
        assert float(peer.report()[2]['pressure_offset_pa']) == pytest.approx(-300.5)
        zeroed = expect_estimate(peer, 101.0, 30e3 + 300.5)
    finally:
        assert peer.set(pressure_offset=0.0).successful
    assert same_shape(expect_estimate(peer, 101.1, 30e3), zeroed)


def test_another_model_is_used_and_a_bad_one_is_not(peer, tmp_path):
    arm = load_model(share_path('config/paper_arm.yaml'))
    file = tmp_path / 'model.yaml'
    save_model(dataclasses.replace(arm, name='mine', length=0.13), file)
    expect_estimate(peer, 100.0)
    assert peer.set(model_file=str(file)).successful
    try:
        assert json.loads(peer.model_info())['length'] == 0.13
        longer = expect_estimate(peer, 100.1)
        assert np.frombuffer(longer.data, SHAPE_POINT)['s'][-1] == 0.13

        file.write_text('name: nothing\n')
        answer = peer.trigger('reload_model')
        assert not answer.success
        assert str(file) in answer.message
        expect_estimate(peer, 100.2)

        save_model(dataclasses.replace(arm, name='mine', length=0.12), file, overwrite=True)
        answer = peer.trigger('reload_model')
        assert answer.success, answer.message
        assert answer.message.endswith(model_name(file))
        assert json.loads(peer.model_info())['length'] == 0.12

        turning = dataclasses.replace(arm, name='mine', gravity=gravity_of('world'))
        save_model(turning, file, overwrite=True)
        answer = peer.trigger('reload_model')  # nobody subscribed to the frames that it needs
        assert not answer.success and 'world' in answer.message
        assert json.loads(peer.model_info())['length'] == 0.12
        expect_estimate(peer, 100.3)

        refused = peer.set(model_file=str(tmp_path / 'nothing.yaml'))
        assert not refused.successful
        assert 'nothing.yaml' in refused.reason
        assert peer.get('model_file') == str(file)
    finally:
        assert peer.set(model_file='').successful
    assert json.loads(peer.model_info())['length'] == 0.112


def test_a_direction_of_gravity_may_be_set_and_taken_back(peer):
    # The accelerometer was subscribed to at the start.
    for direction in ('0, -1', [0.0, -1.0], [0, -1], ''):
        answer = peer.set(gravity=direction)
        assert answer.successful, answer.reason
    for wrong in (True, 1.0, ['0', '-1']):
        answer = peer.set(gravity=wrong)
        assert not answer.successful
        assert 'parameter gravity must be a text' in answer.reason


def test_the_turn_of_the_accelerometer_may_be_a_list(peer):
    assert peer.set(imu_from_base=[0.0, 0.0, 1.57]).successful
    try:
        info = json.loads(peer.model_info())
        assert info['sensors']['imu_from_base'] == '0.0, 0.0, 1.57'
        assert not peer.set(imu_from_base=[0.0, 1.57]).successful
    finally:
        assert peer.set(imu_from_base='').successful


def test_parameters_are_used_from_then_on(peer):
    plain_force = expect_estimate(peer, 100.0)
    assert peer.set(wrench_sign=-1).successful
    try:
        peer.pressure(100.1)  # the wrench that was taken by the old sign is not used
        peer.barrier()
        assert len(peer.received['shape']) == 1
        turned = expect_estimate(peer, 100.2)
        assert not same_shape(turned, plain_force)
    finally:
        assert peer.set(wrench_sign=1).successful
    assert peer.set(wrench_frame='tool0').successful
    peer.wrench(100.3, frame_id='tool0')
    peer.barrier()
    peer.received['shape'].clear()
    peer.pressure(100.3)
    assert peer.spin_until(lambda: peer.received['shape'])


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('wrench_timeout', -1.0),
        ('wrench_timeout', 1),
        ('wrench_yaw', math.nan),
        ('wrench_sign', 2),
        ('pressure_reference', 'relative'),
        ('stations', 11),
        ('frame_id', 'other'),
        ('effects_path', '/nowhere'),
        ('model_file', '/nowhere.yaml'),
    ],
)
def test_an_unfit_parameter_changes_nothing(peer, name, value):
    before = peer.get(name)
    answer = peer.set(**{name: value})
    assert not answer.successful
    assert answer.reason
    assert peer.get(name) == before
    expect_estimate(peer, 100.0)


# Starting and ending


def test_without_wrench_on_simulated_time_until_silence(tmp_path, lonely_peer):
    """The shipped parameters, but without a wrench, and a centerline now and then."""
    peer = lonely_peer
    missed = tmp_path / 'missed.yaml'
    missed.write_text('estimator:\n  ros__parameters: {stations: 30}\n')
    arguments = (
        *('--params-file', str(share_path('config/estimator.yaml'))),
        *('--params-file', str(missed)),
        *('-p', 'wrench_required:=false', '-p', 'use_sim_time:=true'),
        *('-p', 'centerline_rate:=5.0', '-p', 'wrench_timout:=1.0'),
    )
    with running_node(tmp_path / 'output', OTHER_DOMAIN, *arguments) as node:
        peer.barrier()
        begin = time.monotonic()
        seconds = 100.0
        counts = peer.outputs()
        while counts['shape'] <= 50 or counts['centerline'] < 5:
            assert time.monotonic() - begin < START_TIMEOUT, counts
            seconds += 0.01
            peer.pressure(seconds)
            peer.spin_for(0.01)
            counts = peer.outputs()
        assert peer.wrenches.get_subscription_count() == 0
        assert counts['centerline'] < counts['shape']
        assert counts['centerline'] <= 5.0 * (time.monotonic() - begin) + 2.0
        assert peer.report()[2]['wrench_age_s'] == ''

        assert peer.spin_until(lambda: peer.report()[0] == Level.ERROR)
        counts = peer.outputs()
        values = peer.report()[2]
        assert float(values['pressure_age_s']) > 0.5
        assert peer.outputs() == counts
        assert node.end(signal.SIGINT) == 0
    assert 'Traceback' not in node.text
    assert 'wrench_timout' in node.text
    assert 'missed.yaml' in node.text


def test_a_second_interrupt_changes_nothing(tmp_path):
    with running_node(tmp_path / 'output', OTHER_DOMAIN) as node:
        node.wait_for('ready')
        # Also while the interpreter ends: then Python has taken its own handlers away.
        while node.process.poll() is None:
            node.process.send_signal(signal.SIGINT)
            time.sleep(0.005)
        assert node.process.returncode == 0, node.text
    assert 'Traceback' not in node.text


def test_readings_that_a_busy_node_loses_are_counted_and_said(tmp_path, lonely_peer):
    with running_node(tmp_path / 'output', OTHER_DOMAIN) as node:
        node.wait_for('ready')
        lonely_peer.connect()
        lonely_peer.barrier()
        before = int(status_value(lonely_peer, LOST) or 0)
        node.process.send_signal(signal.SIGSTOP)
        for _ in range(5000):
            lonely_peer.pressures.publish(FluidPressure(fluid_pressure=1e4))
        time.sleep(0.5)
        node.process.send_signal(signal.SIGCONT)
        # How many it takes while the others come in is a matter of luck: it keeps five at a time.
        # A gap shows with the reading after it, so more come.
        assert lonely_peer.spin_until(lambda: lost_after_another(lonely_peer) > before)
        said = '; '.join(status.message for status in lonely_peer.statuses)
        assert '/pneunet/pressure' in said
        assert node.end() == 0


LOST = 'lost/pneunet/pressure'


def lost_after_another(peer):
    """Send another pressure, and return how many the last diagnostics say were lost."""
    peer.pressures.publish(FluidPressure(fluid_pressure=1e4))
    return int(status_value(peer, LOST) or 0)


def status_value(peer, key):
    """Return a value of the last diagnostics, or ''."""
    values = peer.statuses[-1].values if peer.statuses else []
    return {item.key: item.value for item in values}.get(key, '')


def test_an_interrupt_while_it_gets_ready_ends_it(tmp_path):
    with running_node(tmp_path / 'output', OTHER_DOMAIN) as node:
        node.wait_for('preparing')
        assert node.end(signal.SIGINT) == 0, node.text
    assert 'Traceback' not in node.text


WRONG = {
    'no model': (['-p', 'model_file:=/nowhere.yaml'], 'cannot read the model file /nowhere.yaml'),
    'integer': (
        ['-p', 'wrench_timeout:=1'],
        'wrench_timeout must be a number with a decimal point',
    ),
    'mixed list': (['-p', 'x:=[1, 2.0]'], 'invalid ROS arguments'),
    'qos': (
        ['-p', 'qos_overrides./pneunet/shape.publisher.reliability:=some'],
        'invalid qos_overrides parameter',
    ),
}
if find_spec('tf2_msgs') is None:
    WRONG['no tf2'] = (['-p', 'publish_tf:=true'], 'apt install ros-jazzy-tf2-msgs')


@pytest.mark.parametrize('what', WRONG)
def test_a_wrong_start_is_one_sentence(tmp_path, what):
    arguments, words = WRONG[what]
    with running_node(tmp_path / 'output', OTHER_DOMAIN, *arguments) as node:
        assert node.process.wait(START_TIMEOUT) == 2, node.text
    said = [line for line in node.text.splitlines() if not re.match(r'\[(INFO|ERROR)\]', line)]
    assert len(said) == 1
    assert words in said[0]

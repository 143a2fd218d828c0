"""The node `fusion` as it runs: a process of its own, real DDS, sensors lost and back."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
import json
from multiprocessing import get_context
import os
import signal

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.estimate import FusedEstimate, Mode
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.readings import decode_targets, targets_message
from pneunet_ros.offline.fuse import fusion_steps, fusion_topics
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.random_estimates import plain

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from support.dds_peer import END_FORCE, FusionPeer, running_node  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
RECORDING = share_path('bags/lab_day/heldout.mcap')
MODEL = share_path('config/paper_arm.yaml')
EVERYTHING = (
    *('-p', 'centerline_rate:=0.0'),
    *(
        word
        for name in ('pressure', 'targets', 'end_wrench')
        for word in ('-p', f'qos_overrides./pneunet/{name}.subscription.reliability:=reliable')
    ),
)
# What is left of the recording, by sensor: from when to when (s) it is silent.
LOSSES = {'end_wrench': [(1.5, 5.5)], 'pressure': [(3.0, 4.5)], 'targets': [(6.0, 7.2)]}
END = 8.5
TIMEOUT = 0.5  # s, of pressure and of targets
CHANGES = [
    ('FUSED', 0.0),
    ('CAMERA_ONLY', 3.0 + TIMEOUT),
    ('FUSED', 4.5),
    ('PREDICTION', 6.0 + TIMEOUT),
    ('FUSED', 7.2),
]
PERIOD = 0.15  # s, of a frame and a pressure reading
SECOND = 1_000_000_000


def last(name):
    return name.rpartition('/')[2]


@pytest.fixture(scope='module')
def lossy(tmp_path_factory):
    """Write a recording with losses, doubled and broken messages; returns its path."""
    path = tmp_path_factory.mktemp('lossy') / 'lossy.mcap'
    recording = open_recording(RECORDING)
    begin = None
    with write_recording(path) as writer:
        topics = {topic.name: writer.add_copy(topic) for topic in recording.topics}
        for number, message in enumerate(recording.raw_messages(list(topics))):
            begin = message.log_time_ns if begin is None else begin
            since = (message.log_time_ns - begin) / SECOND
            spans = LOSSES[last(message.topic)]
            if since > END or any(low < since < high for low, high in spans):
                continue
            topic = topics[message.topic]
            writer.write_raw(topic, message.log_time_ns, message.raw)
            if number % 50 == 7:
                writer.write_raw(topic, message.log_time_ns, message.raw)  # doubled
    return path


@pytest.fixture(scope='module')
def node(tmp_path_factory):
    """Run a node that ends cleanly when asked to, after all that these tests did to it."""
    output = tmp_path_factory.mktemp('node') / 'output'
    with running_node(output, DOMAIN, *EVERYTHING, node='fusion') as process:
        process.wait_for('ready')
        yield process
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


@pytest.fixture(scope='module')
def connected(node, tmp_path_factory):
    peer = FusionPeer(DOMAIN)
    path = part(RECORDING, 4.0, 4.5, tmp_path_factory.mktemp('part') / 'part.mcap')
    peer.connect(messages_of(path))
    yield peer
    peer.close()


@pytest.fixture
def peer(connected):
    """Return the peer of a node that remembers nothing."""
    connected.start_anew()
    return connected


@pytest.fixture
def patient(peer):
    """Return the peer of a node that takes no pause of this test for silence."""
    assert peer.set(target_timeout=600.0).successful
    yield peer
    assert peer.set(target_timeout=0.5).successful


def replayed(path):
    """Give topic, bytes and, as text, all messages of each step of a replay, or None."""
    recording = open_recording(path)
    fusion = Fusion(arm=load_model(MODEL))
    topics = fusion_topics(recording, {}, wrench=True)
    steps = []
    for step in fusion_steps(recording, fusion, topics):
        said = None
        if isinstance(step.outcome, FusedEstimate):
            said = {
                output.name: repr(
                    plain(output.encode(step.outcome, fusion.sensors.frame_id, ROSBAGS_TYPES))
                )
                for output in FUSION_OUTPUTS
            }
        steps.append((last(step.message.topic), bytes(step.message.raw), said))
    return steps


def test_live_equals_replay_bit_for_bit_while_sensors_are_lost_and_come_back(peer, lossy):
    # In a new process, as the node is one: what many tests have compiled here, in whatever order,
    # may differ in the last digit.
    with ProcessPoolExecutor(1, mp_context=get_context('spawn')) as pool:
        steps = pool.submit(replayed, lossy).result()
    made = []
    for name, raw, expected in steps:
        peer.sensors[name].publish(raw)
        if expected is None:
            peer.barrier()
        else:
            assert peer.spin_until(lambda: all(peer.outputs().values())), peer.outputs()
            made += peer.modes()
        got = {topic: messages.pop() for topic, messages in peer.received.items() if messages}
        assert not any(peer.outputs().values())
        said = {topic: repr(plain(message)) for topic, message in got.items()}
        assert (said or None) == expected
    begin = made[0][1]
    changes = [next(group) for _, group in groupby(made, key=lambda item: item[0])]
    assert [Mode(mode).name for mode, _ in changes] == [mode for mode, _ in CHANGES]
    assert [(stamp - begin) / SECOND for _, stamp in changes] == pytest.approx(
        [since for _, since in CHANGES], abs=PERIOD
    )
    values = peer.report()[2]
    assert int(values['rejected/duplicate']) > 0
    assert float(values['nis_mean']) < float(values['nis_limit'])


def messages_of(path):
    """Return sensor and bytes of every message of a recording."""
    recording = open_recording(path)
    messages = recording.raw_messages([topic.name for topic in recording.topics])
    return [(last(message.topic), bytes(message.raw)) for message in messages]


def in_turn(peer, path):
    """Send the messages of a recording one after the other."""
    for name, raw in messages_of(path):
        peer.sensors[name].publish(raw)
        peer.barrier()


def part(path, begin, end, into, names=('pressure', 'targets')):
    """Write what some sensors of a recording say between two times (s)."""
    recording = open_recording(path)
    names = [topic.name for topic in recording.topics if last(topic.name) in names]
    messages = list(recording.raw_messages(names))
    start = messages[0].log_time_ns
    with write_recording(into) as writer:
        topics = {name: writer.add_copy(recording.topic(name)) for name in names}
        for message in messages:
            if begin <= (message.log_time_ns - start) / SECOND < end:
                writer.write_raw(topics[message.topic], message.log_time_ns, message.raw)
    return into


def test_nothing_is_published_without_targets_and_that_is_said(patient, tmp_path):
    in_turn(patient, part(RECORDING, 0.0, 1.0, tmp_path / 'p.mcap', names=('pressure',)))
    level, _, values = patient.report()
    assert not any(patient.outputs().values())
    assert level == Level.ERROR
    assert int(values['rejected/too_uncertain']) > 10
    assert values['mode'] == 'none'
    in_turn(patient, part(RECORDING, 1.0, 1.6, tmp_path / 'pt.mcap'))
    patient.take_all()
    assert {mode for mode, _ in patient.modes()} == {Mode.FUSED}


def test_without_a_wrench_it_says_that_force_is_not_judged(patient, tmp_path):
    in_turn(patient, part(RECORDING, 4.0, 5.0, tmp_path / 'pt.mcap'))
    assert patient.report()[2]['force_judged'].startswith('no: ')
    wrench = part(RECORDING, 5.0, 5.6, tmp_path / 'w.mcap', ('pressure', 'targets', 'end_wrench'))
    in_turn(patient, wrench)
    assert patient.report()[2]['force_judged'] == 'yes'


def moved(path, into):
    """Write a recording in which every other target is seen 0.4 mm to either side."""
    recording = open_recording(path)
    (name,) = (topic.name for topic in recording.topics if last(topic.name) == 'targets')
    with write_recording(into) as writer:
        topics = {topic.name: writer.add_copy(topic) for topic in recording.topics}
        for message in recording.messages(list(topics)):
            if message.topic != name:
                writer.write_raw(topics[message.topic], message.log_time_ns, message.raw)
                continue
            seen = decode_targets(message.message, 'pneunet_base', None)
            y = seen.y + np.where(np.arange(seen.y.size) % 2, 4e-4, -4e-4)
            wrong = targets_message(seen.stamp_ns, seen.x, y, 'pneunet_base', ROSBAGS_TYPES)
            writer.write(topics[name], message.log_time_ns, wrong)
    return into


def test_a_running_nis_beyond_noise_is_a_warning_that_names_diagnose(patient, tmp_path):
    good = part(RECORDING, 4.0, 5.2, tmp_path / 'pt.mcap')
    in_turn(patient, good)
    values = patient.report()[2]
    assert (values['mode'], values['ambiguous']) == ('fused', 'False')
    assert float(values['nis_mean']) < float(values['nis_limit'])
    patient.start_anew()
    patient.report()
    in_turn(patient, moved(good, tmp_path / 'moved.mcap'))
    level, message, values = patient.report()
    assert level >= Level.WARN
    assert 'diagnose' in message
    assert float(values['nis_mean']) > float(values['nis_limit'])


def test_a_frame_in_another_frame_id_is_counted(patient):
    before = patient.report()[2]
    nothing = np.zeros(23)
    message = targets_message(1, nothing, nothing, 'camera', ROSBAGS_TYPES)
    patient.sensors['targets'].publish(bytes(serialize(message, POINTS_TYPE)))
    patient.barrier()
    level, _, after = patient.report()
    assert level >= Level.WARN
    count = 'frames_unused/unreadable'
    assert int(after[count]) == int(before.get(count, 0)) + 1


def test_parameters_are_checked_and_a_second_node_is_noticed(peer, tmp_path):
    assert not peer.set(target_timeout=0.0).successful
    assert peer.set(target_timeout=0.25).successful
    assert json.loads(peer.model_info())['settings'] == {'FusionSettings.target_timeout': 0.25}
    assert peer.set(target_timeout=0.5).successful
    with running_node(tmp_path / 'second', DOMAIN, node='fusion') as second:
        second.wait_for('ready')
        assert peer.spin_until(lambda: f'/pneunet/{END_FORCE}' in peer.report()[2]['rivals'])
        assert '/pneunet/fusion' in peer.report()[2]['rivals']
        assert second.end(signal.SIGTERM) == 0, second.text


def test_what_it_cannot_use_at_the_start_is_one_sentence(tmp_path):
    arguments = ('-p', 'model_file:=/nowhere/model.yaml')
    with running_node(tmp_path / 'output', DOMAIN, *arguments, node='fusion') as process:
        assert process.process.wait(180) == 2
    first, *others = process.text.splitlines()
    assert first.endswith('loading')
    assert len(others) == 1
    assert '/nowhere/model.yaml' in others[0]

"""The tracker as it runs: real processes, real DDS, and what it makes of good and bad images."""

from __future__ import annotations

from dataclasses import replace
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
import tracemalloc
from types import SimpleNamespace

import numpy as np
from pneunet_ros import __version__
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.compressed_image import COMPRESSED_TYPE
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.messages.targets import TARGET_POINT
from pneunet_ros.messages.tracker import (
    CAMERA_INFO_TYPE,
    decode_camera_info,
    decode_compressed_image,
    decode_image,
    outputs_of,
)
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.vision.camera.camera_settings import (
    AreaLimits,
    CameraSettings,
    HomographyPlane,
    PosePlane,
    RestPlane,
)
from pneunet_ros.vision.overlay import curve_in_image, draw
from pneunet_ros.vision.tracker import Tracker, TrackerState, Tracking
import pytest
from support import films as filmed
from support.manuals import same_as_running
from support.random_estimates import plain

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.nodes.ros_types import RCLPY_TYPES  # noqa: E402
from pneunet_ros.nodes.ros_types import serialize as to_bytes  # noqa: E402
from pneunet_ros.nodes.tracker.camera import Camera  # noqa: E402
from pneunet_ros.nodes.tracker.node import TrackerNode  # noqa: E402
from pneunet_ros.nodes.tracker.warm_up import warm_up  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from support.dds_peer import CameraPeer, running_node, START_TIMEOUT, TIMEOUT  # noqa: E402

# The node that most tests share, and those with a node of their own, must not hear each other.
DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
OTHER_DOMAIN = (DOMAIN + 50) % 101 + 1

CHECKOUT = Path(__file__).resolve().parents[2]
COUNT = len(filmed.ARM.target_arclength)
REST = filmed.REST
FILM = filmed.pictures()
LAST = FILM[-1]
BLACK = np.zeros_like(LAST)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.fixture(scope='module')
def node(tmp_path_factory):
    """Run a node that ends cleanly when asked to, after all that these tests did to it."""
    output = tmp_path_factory.mktemp('node') / 'output'
    compressed = ('-p', 'image_transport:=compressed')
    with running_node(output, DOMAIN, *compressed, node='tracker') as process:
        process.wait_for('ready')
        yield process
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


@pytest.fixture(scope='module')
def connected(node):
    peer = CameraPeer(DOMAIN, COMPRESSED_TYPE)
    connect(peer)
    yield peer
    peer.close()


@pytest.fixture
def peer(connected):
    """Return the peer of a node that knows the camera, and nothing of the arm."""
    connected.infos.publish(info())
    connected.barrier()
    connected.start_anew()
    return connected


def info(stamp_ns=1, **fields):
    """Return a serialized camera_info."""
    return serialize(replace(filmed.info_message(stamp_ns), **fields), CAMERA_INFO_TYPE)


def frame(picture, stamp_ns, kind=COMPRESSED_TYPE):
    """Return a serialized image of a picture, or of the bytes of a file."""
    if kind == IMAGE_TYPE:
        return serialize(filmed.image_message(stamp_ns, picture), kind)
    data = picture if isinstance(picture, bytes) else filmed.encoded(picture, '.jpg')
    return serialize(filmed.compressed_message(stamp_ns, data), kind)


def connect(peer):
    """Wait until every frame that is sent brings everything."""
    reliable = (ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)
    assert peer.spin_until(lambda: peer.taken_as() == [reliable], START_TIMEOUT), peer.taken_as()
    for index in range(100):
        peer.infos.publish(info())
        peer.barrier()
        peer.images.publish(frame(FILM[0], filmed.stamp_of(index), peer.kind))
        peer.spin_for(0.05)
        if all(peer.outputs().values()):
            break


def show(peer, picture, stamp_ns):
    """Publish a frame and return its targets."""
    already = len(peer.received['targets'])
    peer.images.publish(frame(picture, stamp_ns, peer.kind))
    assert peer.spin_until(lambda: len(peer.received['targets']) > already)
    cloud = peer.received['targets'][-1]
    assert 1_000_000_000 * cloud.header.stamp.sec + cloud.header.stamp.nanosec == stamp_ns
    assert cloud.header.frame_id == 'pneunet_base'
    return np.frombuffer(cloud.data, TARGET_POINT)


def show_film(peer, film=FILM, begin=0):
    """Show frames one after the other; returns the targets of the last one."""
    points = None
    for index, picture in enumerate(film, start=begin):
        points = show(peer, picture, filmed.stamp_of(index))
    return points


def seen(points):
    """How many targets were seen; those that were not are NaN through and through."""
    gone = np.isnan(points['x'])
    for name in TARGET_POINT.names:
        assert name == 'id' or (np.isnan(points[name]) == gone).all()
    assert points['id'].tolist() == list(range(COUNT))
    return int(np.count_nonzero(~gone))


def rejected(values, reason):
    """How many messages were rejected for a reason, by the values of diagnostics."""
    return int(values.get(f'rejected/{reason}', 0))


# Live and offline


def offline(readings, tracker):
    """Yield what a tracker makes of serialized messages, by topic."""
    state = TrackerState()
    for kind, message in readings:
        try:
            decode = decode_camera_info if kind == CAMERA_INFO_TYPE else decode_compressed_image
            state, outcome = tracker.step(state, decode(message))
        except MessageError:
            outcome = None
        brought = {}
        if isinstance(outcome, Tracking):
            for output, result in outputs_of(outcome):
                brought[output.name] = output.encode(result, 'pneunet_base', ROSBAGS_TYPES)
        yield brought


def exactly(messages):
    """Messages of either binding as text that tells the last bit of every number."""
    return {name: repr(plain(message)) for name, message in messages.items()}


def readings_of_all_kinds():
    """List (type, message): a film with all that can come between its frames."""
    stamps = iter(range(1, 10**12, filmed.PERIOD_NS))
    jpegs = [filmed.encoded(picture, '.jpg') for picture in filmed.pictures(hidden=9)]
    shown = [
        *jpegs[:7],
        jpegs[7][:-500],
        jpegs[7],
        filmed.encoded(BLACK, '.png'),
        jpegs[8],
        filmed.encoded(FILM[9], '.png'),
        filmed.encoded(FILM[9][:, ::-1], '.png'),
        b'nothing',
        filmed.encoded(FILM[9][:-4], '.png'),
        *jpegs[10:],
    ]
    messages = [(COMPRESSED_TYPE, filmed.compressed_message(next(stamps), data)) for data in shown]
    again = filmed.compressed_message(1 + filmed.PERIOD_NS * (len(shown) - 1), jpegs[0])
    back = [filmed.compressed_message(next(stamps), data) for data in jpegs]
    moved = [
        (CAMERA_INFO_TYPE, replace(filmed.info_message(5), d=np.array([-0.1, 0.02, 0, 0, 0.0]))),
        *((COMPRESSED_TYPE, message) for message in back),
    ]
    return [
        (CAMERA_INFO_TYPE, filmed.info_message(1)),
        *messages,
        (COMPRESSED_TYPE, again),
        *moved,
    ]


def test_live_equals_offline_bit_for_bit(peer):
    tracker = Tracker(filmed.ARM, load_camera(share_path('config/camera.yaml')))
    readings = readings_of_all_kinds()
    frames = curves = 0
    for (kind, message), expected in zip(readings, offline(readings, tracker), strict=True):
        publisher = peer.infos if kind == CAMERA_INFO_TYPE else peer.images
        publisher.publish(serialize(message, kind))
        if expected:
            assert peer.spin_until(
                lambda: all(peer.received[name] for name in expected)  # noqa: B023
            ), (peer.outputs(), list(expected))
        else:
            peer.barrier()
        got = {name: messages.pop() for name, messages in peer.received.items() if messages}
        assert not any(peer.outputs().values())
        assert exactly(got) == exactly(expected)
        frames += 'targets' in expected
        curves += 'measured_curvature' in expected
    assert frames == len(readings) - 6
    assert curves > 10


# Bad input


def test_black_frames_bring_no_targets_and_say_so(peer):
    assert seen(show_film(peer)) == COUNT
    peer.report()
    for messages in peer.received.values():
        messages.clear()
    for index in range(20, 25):
        assert seen(show(peer, BLACK, filmed.stamp_of(index))) == 0
    level, said, values = peer.report()
    assert (Level(level).name, values.get('reason')) == ('ERROR', 'no_areas'), said
    assert int(values['unexplained/no_areas']) >= 5
    assert (values['seen'], values['missing']) == ('0', str(COUNT))
    assert peer.outputs() == {'targets': 5, 'measured_centerline': 0, 'measured_curvature': 0}
    assert not any(cloud.is_dense for cloud in peer.received['targets'])
    assert seen(show(peer, LAST, filmed.stamp_of(25))) == COUNT


def test_what_is_refused_is_counted_by_reason_and_brings_nothing(peer):
    show_film(peer)
    before = peer.report()[2]
    cut = [filmed.encoded(LAST, kind)[:-1000] for kind in ('.jpg', '.png')]
    for picture, index in ((cut[0], 20), (cut[1], 20), (LAST[:-8], 20), (LAST, 11), (LAST, 10)):
        peer.images.publish(frame(picture, filmed.stamp_of(index)))
    peer.infos.publish(info(binning_x=2, binning_y=2))
    peer.barrier()
    level, said, after = peer.report()
    assert Level(level).name == 'ERROR', said
    reasons = {name.partition('/')[2] for name in after if name.startswith('rejected/')}
    counts = {name: rejected(after, name) - rejected(before, name) for name in reasons}
    assert {name: count for name, count in counts.items() if count} == {
        'unreadable': 2,
        'wrong_size': 1,
        'duplicate': 1,
        'older': 1,
        'wrong_camera_info': 1,
    }, said
    assert len(peer.received['targets']) == len(FILM)
    assert seen(show(peer, LAST, filmed.stamp_of(20))) == COUNT


def test_a_target_that_is_hidden_is_missing(peer):
    *film, hidden = filmed.pictures(hidden=9)
    show_film(peer, film)
    peer.report()
    points = show(peer, hidden, filmed.stamp_of(len(film)))
    assert seen(points) == COUNT - 1
    assert np.isnan(points['x'][9])
    assert not peer.received['targets'][-1].is_dense
    assert peer.received['targets'][-2].is_dense
    assert peer.spin_until(lambda: len(peer.received['measured_centerline']) > 0)
    level, said, values = peer.report()
    assert Level(level).name == 'WARN', said
    assert (values['seen'], values['missing'], values['missing_ids']) == ('22', '1', '9')


def test_an_image_stamped_ahead_is_told_by_the_next(peer):
    show_film(peer)
    show(peer, LAST, filmed.stamp_of(20) + 5_000_000_000)
    before = peer.report()[2]
    assert seen(show(peer, LAST, filmed.stamp_of(21))) == COUNT
    level, said, after = peer.report()
    assert Level(level).name == 'WARN' and 'in the future' in said
    assert rejected(after, 'ahead') - rejected(before, 'ahead') == 1
    assert after['resets'] == before['resets']


def test_a_jump_back_in_time_starts_anew(peer):
    assert seen(show_film(peer, begin=1000)) == COUNT
    peer.report()
    assert seen(show(peer, FILM[0], filmed.stamp_of(0))) == 0
    level, _, values = peer.report()
    assert Level(level).name == 'WARN'
    assert values['rest_frames'] == '1'


# What it says


def test_diagnostics_hold_all_numbers(peer):
    show_film(peer)
    peer.report()
    for index in range(20, 30):
        show(peer, LAST, filmed.stamp_of(index))
    level, message, values = peer.report()
    assert Level(level).name == 'OK', message
    assert float(values['rate_hz']) >= 0.0
    assert float(values['image_age_s']) >= 0.0
    assert (values['seen'], values['missing'], values['missing_ids']) == (str(COUNT), '0', '')
    assert values['reason'] == ''
    assert int(values['frames']) >= int(values['explained']) >= 17
    assert 0.0 < float(values['latency_p50_s']) <= float(values['latency_p99_s'])
    assert values['rest_frames'] == '5'
    assert 0.0 < float(values['rest_bow']) < 1e-3
    assert float(values['scale_mm_per_px']) == pytest.approx(0.26, rel=0.01)
    assert values['model'].startswith(filmed.ARM.name)


def test_topics_and_services_are_those_of_the_page(peer):
    same_as_running(peer.node, 'tracker', left_out={'image_raw'})


def test_the_annotated_image_shows_what_was_seen(peer):
    pictures = []
    late = peer.node.create_subscription(Image, 'image_annotated', pictures.append, 10)
    assert peer.spin_until(lambda: late.get_publisher_count() > 0)
    shown = [filmed.encoded(picture, '.jpg') for picture in FILM]
    tracker = Tracker(filmed.ARM, load_camera(share_path('config/camera.yaml')))
    lens = decode_camera_info(filmed.info_message(1))
    state, _ = tracker.step(TrackerState(), lens)
    compared = 0
    for index, data in enumerate(shown):
        stamp_ns = filmed.stamp_of(index)
        show(peer, data, stamp_ns)
        image = decode_compressed_image(filmed.compressed_message(stamp_ns, data))
        state, tracking = tracker.step(state, image)
        # The first ones may pass before the node knows of the subscription.
        if not peer.spin_until(lambda: pictures, TIMEOUT if compared or index == 10 else 0.2):
            continue
        picture = pictures.pop()
        assert (picture.header.stamp.nanosec, picture.header.frame_id) == (stamp_ns, 'camera')
        assert (picture.width, picture.height, picture.encoding) == (640, 480, 'bgr8')
        curve = tracking.curve and curve_in_image(tracking.curve, state.plane, state.lens)
        expected = draw(image, tracking, curve)
        np.testing.assert_array_equal(np.array(picture.data).reshape(480, 640, 3), expected)
        compared += 1
    peer.node.destroy_subscription(late)
    assert compared >= 2


@pytest.mark.parametrize('subscribers', [0, 1])
def test_what_nobody_wants_is_not_drawn(subscribers):
    """The node itself, but for ROS: a frame with a curve, and somebody or nobody there."""
    published = []

    def out(name):
        return SimpleNamespace(
            get_subscription_count=lambda: subscribers,
            publish=lambda message: published.append(name),
        )

    node = SimpleNamespace(
        configuration=SimpleNamespace(
            tracker=Tracker(filmed.ARM, load_camera(share_path('config/camera.yaml')))
        ),
        serializer=MessageSerializer(types=RCLPY_TYPES, serialize=to_bytes, frame_id='base'),
        state=TrackerState(),
        outputs={name: out(name) for name in ('targets', *CURVES)},
        annotated=out('image_annotated'),
        health=SimpleNamespace(
            published=lambda latency: None, record_image=lambda outcome, now: None
        ),
        note_message=lambda topic, info: None,
    )
    for name in ('publish', 'annotate', 'take_step'):
        setattr(node, name, getattr(TrackerNode, name).__get__(node))
    camera = SimpleNamespace(
        nodes={'/tracker': node}, topic='/image_raw', decode=decode_compressed_image
    )
    Camera.take_camera_info(camera, filmed.info_message(1))
    for index, picture in enumerate(FILM):
        message = filmed.compressed_message(filmed.stamp_of(index), filmed.encoded(picture))
        Camera.take_image(camera, message, {'received_timestamp': 0})
    assert published.count('targets') == len(FILM)
    curves = len(FILM) - REST + 1
    assert published.count('image_annotated') == subscribers * len(FILM)
    for name in CURVES:
        assert published.count(name) == subscribers * curves


CURVES = ('measured_centerline', 'measured_curvature')


def test_model_info_is_there_for_those_who_come_late(peer):
    about = json.loads(peer.model_info())
    assert about['name'] == filmed.ARM.name
    assert about['targets'] == COUNT
    assert about['plane'] == 'rest'
    assert about['camera_file'].endswith('camera.yaml')
    assert about['frame_id'] == 'pneunet_base'
    assert about['version'] == __version__


# Services and parameters


def test_reset_forgets_the_arm_and_keeps_the_camera(peer):
    assert seen(show_film(peer)) == COUNT
    assert peer.trigger('reset').success
    # The arm is bent: scale and base frame are unknown until it is at rest again.
    assert seen(show(peer, LAST, filmed.stamp_of(20))) == 0
    assert seen(show_film(peer, FILM[: REST - 1], begin=21)) == 0
    assert seen(show_film(peer, FILM[:REST], begin=30)) == COUNT


def test_another_camera_file_is_used_and_a_bad_one_is_not(peer, tmp_path):
    file = tmp_path / 'camera.yaml'
    file.write_text('schema_version: 1\nrest_frames: 2\n')
    assert seen(show_film(peer)) == COUNT
    assert peer.set(camera_file=str(file)).successful
    try:
        assert json.loads(peer.model_info())['camera_file'] == str(file)
        assert seen(show(peer, FILM[0], filmed.stamp_of(20))) == 0
        assert seen(show(peer, FILM[0], filmed.stamp_of(21))) == COUNT

        file.write_text('schema_version: 1\nrest_frame: 3\n')
        answer = peer.trigger('reload_model')
        assert not answer.success
        assert str(file) in answer.message
        assert seen(show(peer, FILM[0], filmed.stamp_of(22))) == COUNT

        file.write_text('schema_version: 1\nrest_frames: 1\n')
        answer = peer.trigger('reload_model')
        assert answer.success, answer.message
        assert seen(show(peer, FILM[0], filmed.stamp_of(23))) == COUNT

        refused = peer.set(camera_file=str(tmp_path / 'nothing.yaml'))
        assert not refused.successful
        assert 'nothing.yaml' in refused.reason
        assert peer.get('camera_file') == str(file)
    finally:
        assert peer.set(camera_file='').successful


@pytest.mark.parametrize(
    ('name', 'value'),
    [('image_transport', 'raw'), ('frame_id', 'other'), ('model_file', '/nowhere.yaml')],
)
def test_an_unfit_parameter_changes_nothing(peer, name, value):
    before = peer.get(name)
    answer = peer.set(**{name: value})
    assert not answer.successful
    assert answer.reason
    assert peer.get(name) == before


@pytest.mark.parametrize('method', ['rest', 'homography', 'pose'])
def test_a_new_start_knows_the_camera_whatever_the_plane_comes_from(method):
    corners = np.array([[0.0, 0.08], [0.12, 0.08], [0.12, 0.0], [0.0, 0.0]])
    away = 600.0 * 0.00026
    planes = {
        'rest': RestPlane(),
        'homography': HomographyPlane(
            pixels=np.array([[100, 90], [530, 90], [530, 400], [100, 400]]), points=corners
        ),
        'pose': PosePlane(position=(0.055, 0.03, away), quaternion=(1.0, 0.0, 0.0, 0.0)),
    }
    tracker = Tracker(filmed.ARM, CameraSettings(plane=planes[method]))
    state, _ = tracker.step(TrackerState(), decode_camera_info(filmed.info_message(1)))
    before = state
    for index, picture in enumerate(FILM[:2]):
        image = decode_image(filmed.image_message(filmed.stamp_of(index), picture))
        state, _ = tracker.step(state, image)
    state = tracker.reset(state)
    assert state.lens is before.lens
    assert (state.plane is None) == (before.plane is None) == (method == 'rest')
    assert (state.row, state.stamps.last_ns, state.rest.frames) == (None, None, 0)
    assert (state.frames, state.resets) == (2, 1)
    assert tracker.reset(TrackerState()).lens is None


NOTHING_IS_COMPILED_LATE = """
import gc
import cv2
from support import films as filmed
from support.manuals import same_as_running
import numpy as np
from numba.core.dispatcher import Dispatcher
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.nodes.ros_types import RCLPY_TYPES, serialize
from pneunet_ros.nodes.tracker.configuration import configured_tracker, PARAMETERS
from pneunet_ros.nodes.tracker.warm_up import warm_up
from pneunet_ros.vision.overlay import curve_in_image, draw
from pneunet_ros.messages.tracker import decode_camera_info, decode_image
from pneunet_ros.vision.tracker import TrackerState

def compiled():
    kernels = [item for item in gc.get_objects() if isinstance(item, Dispatcher)]
    return {(item.py_func.__name__, str(found)) for item in kernels for found in item.signatures}

tracker = configured_tracker({item.name: item.default for item in PARAMETERS.fields}, None).tracker
serializer = MessageSerializer(types=RCLPY_TYPES, serialize=serialize, frame_id='base')
assert warm_up(tracker, serializer) == ''
before = compiled()
assert before
state, _ = tracker.step(TrackerState(), decode_camera_info(filmed.info_message(1)))
film = list(filmed.pictures(hidden=9))
half = film[-1].copy()
half[:, 300:] = 90
noise = np.random.default_rng(0).integers(0, 256, half.shape, np.uint8)
dots = np.zeros_like(half)
for u in range(20, 620, 40):
    for v in range(20, 460, 40):
        cv2.circle(dots, (u, v), 5, 255, -1)
for index, grey in enumerate([*film, half, film[-1], 0 * half, noise, dots, film[-1]]):
    image = decode_image(filmed.image_message(filmed.stamp_of(index), grey))
    state, tracking = tracker.step(state, image)
    if tracking.curve is not None:
        draw(image, tracking, curve_in_image(tracking.curve, state.plane, state.lens))
assert state.explained >= 9
print(sorted(compiled() - before))
"""


def test_the_drawn_arm_does_not_grow_with_the_dots_of_the_camera_file():
    settings = CameraSettings(area=AreaLimits(smallest=2e3, largest=4e4))
    tracker = Tracker(filmed.ARM, settings)
    serializer = MessageSerializer(types=RCLPY_TYPES, serialize=to_bytes, frame_id='base')
    tracemalloc.start()
    try:
        assert warm_up(tracker, serializer) == ''
        assert tracemalloc.get_traced_memory()[1] < 1e8
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.skipif('PNEUNET_NO_NUMBA' in os.environ, reason='nothing is compiled at all')
def test_no_kernel_is_compiled_while_images_wait():
    command = [sys.executable, '-c', NOTHING_IS_COMPILED_LATE]
    path = os.pathsep.join([str(CHECKOUT), str(CHECKOUT / 'test')])
    done = subprocess.run(
        command, env=os.environ | {'PYTHONPATH': path}, capture_output=True, text=True
    )
    assert (done.stdout, done.returncode) == ('[]\n', 0), done.stderr


# Cameras of other manners, starting and ending


def test_raw_images_of_cameras_that_come_and_change(tmp_path):
    """Best effort, then reliable; camera_info late, and only once; then silence, and the end."""
    peer = CameraPeer(OTHER_DOMAIN, IMAGE_TYPE)
    peer.node.destroy_publisher(peer.images)
    peer.node.destroy_publisher(peer.infos)
    arguments = ('--params-file', str(share_path('config/tracker.yaml')), '-p', 'frame:=base')
    with running_node(tmp_path / 'output', OTHER_DOMAIN, *arguments, node='tracker') as node:
        node.wait_for('ready')
        # On a busy machine the node has waited too long before the first report is heard.
        assert peer.spin_until(lambda: peer.report()[2]['image_age_s'] == '')

        peer.images = peer.advertise(BEST_EFFORT)
        assert peer.spin_until(lambda: peer.images.get_subscription_count() > 0)
        for _ in range(10):
            refused = keep_sending(peer)
            if int(refused[2].get('rejected/no_camera_info', 0)) > 0:
                break
        assert Level(refused[0]).name == 'ERROR'
        assert int(refused[2]['rejected/no_camera_info']) > 0
        assert not any(peer.outputs().values())

        latched = peer.node.create_publisher(CameraInfo, 'camera_info', LATCHED)
        latched.publish(info())
        for _ in range(50):
            keep_sending(peer, 0.2)
            if peer.received['targets']:
                break
        assert (ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE) in peer.taken_as()

        peer.node.destroy_publisher(peer.images)
        peer.images = peer.advertise(RELIABLE)
        reliable = [(ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE)]
        assert peer.spin_until(lambda: peer.taken_as() == reliable)
        assert peer.trigger('reset').success
        assert seen(show_film(peer, begin=10_000)) == COUNT

        # An older error may stand in the first report after the film.
        assert peer.spin_until(lambda: float(peer.report()[2]['image_age_s']) > 2.0)
        assert peer.report()[0] == Level.ERROR
        node.process.send_signal(signal.SIGINT)
        assert node.end(signal.SIGINT) == 0
    peer.close()
    assert 'Traceback' not in node.text
    assert re.search(r'\bframe\b', node.text)


def keep_sending(peer, seconds=TIMEOUT):
    """Send resting frames until diagnostics come, at most so long; return these, or None."""
    peer.statuses.clear()
    end = time.monotonic() + seconds
    while not peer.statuses:
        if time.monotonic() > end:
            return None
        peer.sent = getattr(peer, 'sent', 0) + 1
        peer.images.publish(frame(FILM[0], filmed.stamp_of(peer.sent), peer.kind))
        peer.spin_for(0.05)
    status = peer.statuses[-1]
    return status.level[0], status.message, {item.key: item.value for item in status.values}


def test_a_wrong_start_is_one_sentence(tmp_path):
    wrong = ('-p', 'camera_file:=/nowhere.yaml')
    with running_node(tmp_path / 'output', OTHER_DOMAIN, *wrong, node='tracker') as node:
        assert node.process.wait(START_TIMEOUT) == 2, node.text
    (said,) = (line for line in node.text.splitlines() if not line.startswith('['))
    assert '/nowhere.yaml' in said

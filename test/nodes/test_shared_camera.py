"""Several arms before one camera, in one process: real images over real DDS."""

from __future__ import annotations

from dataclasses import replace
import os
import signal
from types import SimpleNamespace

import numpy as np
from pneunet_ros.core.errors import CameraError
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.share import share_path
from pneunet_ros.files.camera_file import load_camera
from pneunet_ros.messages.builders import IMAGE_TYPE
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.targets import TARGETS_OUTPUT
from pneunet_ros.messages.tracker import CAMERA_INFO_TYPE, decode_camera_info, decode_image
from pneunet_ros.recordings.message_store import serialize
from pneunet_ros.vision.several_rows import step_rows
from pneunet_ros.vision.tracker import Tracker, TrackerState
import pytest
from support import films, rows_film
from support.refusals import refused

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.gripper.configuration import check_blocks  # noqa: E402
from pneunet_ros.nodes.ros_types import message_class  # noqa: E402
from pneunet_ros.nodes.tracker.camera import Camera, COMPILING  # noqa: E402
from support.dds_peer import Peer, running_node, START_TIMEOUT  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
ARMS = tuple(rows_film.POSES)
IMAGES, INFOS = '/camera/image_raw', '/camera/camera_info'
CAMERA = load_camera(share_path('config/camera.yaml'))
MODEL = str(share_path('config/paper_arm.yaml'))


def block(arm):
    u, v = rows_film.clamp_pixel(arm)
    topics = {'image_raw': IMAGES, 'camera_info': INFOS}
    return {'clamp_pixel': f'{u}, {v}', 'topics': topics}


def arguments():
    """Return the blocks of all arms, as words of a command line."""
    values = {'arms': f'[{", ".join(ARMS)}]', 'fusion': 'false', 'tracker': 'true'}
    values['model_file'] = MODEL
    for arm in ARMS:
        values[f'{arm}.clamp_pixel'] = repr(block(arm)['clamp_pixel'])
        values |= {f'{arm}.topics.{name}': topic for name, topic in block(arm)['topics'].items()}
    return [word for name, value in values.items() for word in ('-p', f'{name}:={value}')]


def info_message(index):
    return films.info_message(
        films.stamp_of(index), rows_film.WIDTH, rows_film.HEIGHT, rows_film.CAMERA
    )


def messages():
    """Return the images of the film."""
    return [
        films.image_message(films.stamp_of(index), picture)
        for index, picture in enumerate(rows_film.pictures())
    ]


def expected(images):
    """Return where each arm has its targets, x, y and std by frame, by the trackers alone."""
    arm = films.ARM
    trackers = [
        Tracker(arm, replace(CAMERA, clamp_pixel=rows_film.clamp_pixel(name))) for name in ARMS
    ]
    lens = decode_camera_info(info_message(0))
    states = [state for state, _ in step_rows(trackers, [TrackerState()] * len(ARMS), lens)]
    found = {name: [] for name in ARMS}
    for image in images:
        states, outcomes = zip(*step_rows(trackers, states, decode_image(image)), strict=True)
        for name, outcome in zip(ARMS, outcomes, strict=True):
            seen = outcome.sightings
            found[name].append(np.array([seen.x, seen.y, seen.std]))
    return found


class RowsPeer(Peer):
    """The camera before the arms, and who hears their targets."""

    def __init__(self):
        outputs = tuple(replace(TARGETS_OUTPUT, name=f'{arm}/targets') for arm in ARMS)
        super().__init__(DOMAIN, 'gripper', outputs)
        self.images = self.node.create_publisher(message_class(IMAGE_TYPE), IMAGES, 10)
        self.infos = self.node.create_publisher(message_class(CAMERA_INFO_TYPE), INFOS, 10)

    def fewest(self):
        """Return of how many frames all arms have said what they see."""
        return min(map(len, self.received.values()))


def test_three_arms_before_one_camera_are_tracked_as_one_image_after_another(tmp_path):
    images = messages()
    wanted = expected(images)
    with running_node(tmp_path / 'output', DOMAIN, *arguments(), node='gripper') as process:
        process.wait_for('ready: gripper')
        peer = RowsPeer()
        assert peer.spin_until(lambda: peer.infos.get_subscription_count(), START_TIMEOUT)
        first = serialize(images[0], IMAGE_TYPE)

        def is_heard():
            peer.infos.publish(serialize(info_message(0), CAMERA_INFO_TYPE))
            peer.images.publish(first)
            peer.spin_for(0.1)
            return peer.fewest()

        assert peer.spin_until(is_heard, START_TIMEOUT)
        assert peer.images.get_subscription_count() == 1  # for all arms
        peer.barrier()
        assert peer.trigger('reset').success
        for clouds in peer.received.values():
            clouds.clear()
        for count, image in enumerate(images, 1):
            peer.images.publish(serialize(image, IMAGE_TYPE))
            assert peer.spin_until(lambda count=count: peer.fewest() >= count), count
        for arm in ARMS:
            assert len(peer.received[f'{arm}/targets']) == len(images)
            for cloud, values in zip(peer.received[f'{arm}/targets'], wanted[arm], strict=True):
                points = cloud_points(cloud)
                for name, value in zip(('x', 'y', 'std'), values, strict=True):
                    np.testing.assert_array_equal(points[name], value.astype(points[name].dtype))
        peer.close()
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


def test_arms_of_one_camera_without_a_row_of_their_own_are_refused_before_they_start():
    given = {'arms': list(ARMS), 'tracker': True, 'fusion': False, 'model_file': MODEL}
    blocks = {arm: block(arm) for arm in ARMS}
    check_blocks(given | blocks)
    same = block('upper')['clamp_pixel']
    for changed in ({'clamp_pixel': same}, {'clamp_pixel': ''}):
        with refused(CameraError, 'missing'):
            check_blocks(given | blocks | {'lower': blocks['lower'] | changed})
    own = {'image_raw': '/other/image_raw', 'camera_info': '/other/camera_info'}
    check_blocks(given | blocks | {'lower': {'topics': own}})


def test_no_image_is_searched_until_the_kernels_are_compiled(monkeypatch):
    refused = []
    node = SimpleNamespace(
        note_message=lambda topic, info: None, refuse=lambda it: refused.append(it.reason)
    )
    camera = object.__new__(Camera)
    camera.nodes, camera.topic, camera.decode = {'arm': node}, IMAGES, pytest.fail
    monkeypatch.setattr(jit, 'is_waiting', lambda: True)
    camera.take_image(message=None, info={})
    assert refused == [COMPILING]

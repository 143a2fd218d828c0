"""The running node is shown targets: what it says of them in its diagnostics."""

from __future__ import annotations

import os
import signal

import numpy as np
from pneunet_ros.files.model_file import load_model
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.readings import TARGETS, targets_message
from pneunet_ros.model.equilibrium import solve
import pytest
from support.example_arms import PAPER_ARM

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.nodes.ros_types import message_class, RCLPY_TYPES  # noqa: E402
from support.dds_peer import EstimatorPeer, running_node  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
ARGUMENTS = (
    *('-p', 'input_timeout:=600.0', '-p', 'watch_time:=10.0'),
    *(
        word
        for topic in ('pressure', 'end_wrench', TARGETS.name)
        for word in ('-p', f'qos_overrides./pneunet/{topic}.subscription.reliability:=reliable')
    ),
)
ARM = load_model(PAPER_ARM)
PERIOD = 0.02  # s
FRAMES = 15


@pytest.fixture(scope='module')
def peer(tmp_path_factory):
    """Return the peer of a node that hears readings and targets."""
    output = tmp_path_factory.mktemp('node') / 'output'
    with running_node(output, DOMAIN, *ARGUMENTS) as process:
        process.wait_for('ready')
        peer = EstimatorPeer(DOMAIN)
        peer.targets = peer.node.create_publisher(message_class(POINTS_TYPE), TARGETS.name, 10)
        peer.connect()
        assert peer.spin_until(lambda: peer.targets.get_subscription_count() == 1)
        yield peer
        peer.close()
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


def place():
    """Where the targets are under the load that the peer sends."""
    shape = solve(ARM, pressure=30e3, force=(0.1, 0.05), stations=2241)  # 0.05 mm apart
    return (
        np.interp(ARM.target_arclength, shape.arclength, values) for values in (shape.x, shape.y)
    )


def shown(peer, x, y, frame_id='pneunet_base', first=100.0):
    """Show targets at every reading; returns the diagnostics that follow."""
    peer.report()
    for index in range(FRAMES):
        seconds = first + PERIOD * index
        peer.send(seconds)
        peer.barrier()
        stamp_ns = round(seconds * 1e9)
        peer.targets.publish(targets_message(stamp_ns, x, y, frame_id, RCLPY_TYPES))
        peer.barrier()
    return peer.report()


def test_targets_in_their_places_are_no_news(peer):
    peer.start_anew()
    x, y = place()
    level, message, values = shown(peer, x, y)
    assert (level, message.split()[0]) == (Level.OK, 'estimating')
    assert float(values['disagreement']) < 0.2 < float(values['disagreement_limit'])
    assert int(values['targets_matched']) >= FRAMES - 1  # the first has no period to be within


def test_targets_elsewhere_are_a_warning_that_ends_with_them(peer):
    peer.start_anew()
    x, y = place()
    y[19:] += 3e-3
    level, _, values = shown(peer, x, y)
    assert level == Level.WARN
    assert float(values['disagreement']) > float(values['disagreement_limit'])
    assert int(values['worst_target']) >= 19
    assert float(values['worst_station_m']) == ARM.target_arclength[int(values['worst_target'])]
    assert peer.spin_until(lambda: peer.report()[0] == Level.OK)  # after watch_time
    _, _, values = peer.report()
    assert values['disagreement'] == values['worst_target'] == ''


def test_targets_of_another_frame_are_refused(peer):
    peer.start_anew()
    x, y = place()
    level, _, values = shown(peer, x, y, frame_id='camera')
    assert level == Level.WARN
    assert int(values['targets_unmatched/unreadable']) == FRAMES
    assert values['disagreement'] == ''

"""Simulated time that jumps: forward, back and to zero. Nodes say it once, and go on."""

from __future__ import annotations

import os

from pneunet_ros.messages.builders import nanoseconds, Output
from pneunet_ros.messages.readings import PRESSURE_TYPE
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from rosgraph_msgs.msg import Clock  # noqa: E402
from support.dds_peer import Peer, running_node  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
SIM_TIME = ['-p', 'use_sim_time:=true']
SAID = '/clock jumped'
JUMPS = (9000.0, 1400.0, 0.0, 2.0)  # s, after 5000


class Simulator(Peer):
    """Publishes /clock."""

    def __init__(self, name, outputs=()):
        super().__init__(DOMAIN, name, outputs)
        self.clock = self.node.create_publisher(Clock, '/clock', 10)

    def tick(self, seconds):
        """Let time be so late; returns the stamps (s) heard of pressures then."""
        for part in range(10):
            message = Clock()
            message.clock.sec, message.clock.nanosec = int(seconds), part * 10_000_000
            self.clock.publish(message)
            self.spin_for(0.05)
        heard = [1e-9 * nanoseconds(one.header.stamp) for one in self.received.get('pressure', ())]
        for messages in self.received.values():
            messages.clear()
        return heard


def test_the_virtual_arm_reads_at_every_moment_once(tmp_path):
    pressure = Output(name='pressure', type=PRESSURE_TYPE, build=None)
    arguments = [*SIM_TIME, '-p', 'camera:=none']
    with running_node(tmp_path / 'output', DOMAIN, *arguments, node='virtual_arm') as process:
        process.wait_for('ready')
        peer = Simulator('virtual_arm', (pressure,))
        level, _, _ = peer.report()
        assert level == 1  # time stands still
        assert peer.spin_until(lambda: any(peer.tick(5000.0)))
        for seconds in JUMPS:
            peer.tick(seconds)
            heard = peer.tick(seconds)
            assert heard and all(0.0 <= stamp - seconds < 0.2 for stamp in heard)
            assert len(set(heard)) == len(heard) and 0.0 not in heard
        assert process.text.count(SAID) == 1
        peer.close()
        assert process.end() == 0, process.text


def test_the_nodes_of_a_gripper_go_on(tmp_path):
    with running_node(tmp_path / 'output', DOMAIN, *SIM_TIME, node='gripper') as process:
        process.wait_for('ready: gripper')
        peer = Simulator('gripper')
        for seconds in (5000.0, *JUMPS):
            peer.tick(seconds)
            assert peer.trigger('reset').success
        names = {status.name.partition(':')[0] for status in peer.statuses}
        assert {'pneunet/gripper', 'pneunet/left/fusion', 'pneunet/right/estimator'} <= names
        assert process.text.count(SAID) == 1
        peer.close()
        assert process.end() == 0, process.text

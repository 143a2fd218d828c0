"""The virtual arm as it runs, in a process of its own: commands, readings, truth; the stack."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import time

import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.messages.builders import Output, POINTS_TYPE
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from geometry_msgs.msg import WrenchStamped  # noqa: E402
from pneunet_ros.core.health import Level  # noqa: E402
from pneunet_ros.nodes.topics import latched_qos  # noqa: E402
from sensor_msgs.msg import FluidPressure  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from support.dds_peer import Peer, running_node, START_TIMEOUT  # noqa: E402

DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
OTHER_DOMAIN = (DOMAIN + 50) % 101 + 1
TIP_TYPE = 'geometry_msgs/msg/PoseStamped'
HEARD = {
    'end_wrench': WRENCH_TYPE,
    'pressure': PRESSURE_TYPE,
    'targets': POINTS_TYPE,
    'true_tip': TIP_TYPE,
    'tip': 'geometry_msgs/msg/PoseWithCovarianceStamped',
}


class Commander(Peer):
    """Commands the arm and hears all its sensors, and an estimator's tip."""

    def __init__(self, domain):
        outputs = tuple(Output(name=name, type=kind, build=None) for name, kind in HEARD.items())
        super().__init__(domain, 'virtual_arm', outputs)
        self.commands = self.node.create_publisher(FluidPressure, 'pressure_command', 10)
        self.loads = self.node.create_publisher(WrenchStamped, 'force_command', 10)

    def last(self, name):
        """Return the next message of a topic."""
        self.received[name].clear()
        assert self.spin_until(lambda: self.received[name]), name
        return self.received[name][-1]

    def tip(self):
        place = self.last('true_tip').pose.position
        return np.array([place.x, place.y])

    def settled_tip(self):
        """Return the tip as soon as it stands still."""
        tips = [self.tip()]

        def still():
            tips.append(self.tip())
            return np.abs(tips[-1] - tips[-2]).max() < 1e-6

        assert self.spin_until(still)
        return tips[-1]

    def command(self, pressure):
        """Command a pressure, and wait until the sensor says so."""

        def there():
            self.commands.publish(FluidPressure(fluid_pressure=float(pressure)))
            return abs(self.last('pressure').fluid_pressure - pressure) < 300.0

        assert self.spin_until(there), self.last('pressure').fluid_pressure

    def load(self, x=0.0, y=0.0, frame_id='pneunet_base'):
        """Put a load on the free end, and wait until the arm was told."""
        message = WrenchStamped()
        message.header.frame_id = frame_id
        message.wrench.force.x, message.wrench.force.y = x, y
        self.loads.publish(message)
        self.barrier()


@pytest.fixture(scope='module')
def node(tmp_path_factory):
    output = tmp_path_factory.mktemp('arm') / 'output'
    with running_node(output, DOMAIN, '-p', 'noise:=false', node='virtual_arm') as process:
        process.wait_for('ready')
        yield process
        assert process.end(signal.SIGTERM) == 0, process.text
        assert 'Traceback' not in process.text


@pytest.fixture(scope='module')
def connected(node):
    peer = Commander(DOMAIN)
    for publisher in (peer.commands, peer.loads):
        assert peer.spin_until(lambda publisher=publisher: publisher.get_subscription_count())
    yield peer
    peer.close()


@pytest.fixture
def peer(connected):
    """Return the peer of an unconditioned arm."""
    assert connected.trigger('reset').success
    return connected


def key(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


def test_the_arm_follows_its_command(peer):
    assert peer.tip() == pytest.approx([0.112, 0.0], abs=1e-6)
    peer.command(30e3)
    assert peer.settled_tip() == pytest.approx([0.0803, 0.0658], abs=5e-4)
    peer.command(0.0)
    assert peer.settled_tip() == pytest.approx([0.112, 0.0], abs=1e-3)


def test_every_pressure_has_a_wrench_and_a_truth_of_its_stamp(peer):
    for name in ('pressure', 'end_wrench', 'true_tip'):
        peer.received[name].clear()

    def stamps(name):
        return [key(message) for message in peer.received[name]]

    def complete():
        """Whether all of 30 pressures are there: a busy machine may lose a message in between."""
        wanted = set(stamps('pressure')[-33:-3])
        others = set(stamps('end_wrench')) & set(stamps('true_tip'))
        return len(wanted) == 30 and wanted <= others

    begin = time.time()
    assert peer.spin_until(complete)
    assert stamps('pressure') == sorted(set(stamps('pressure')))
    assert begin - 1.0 < stamps('pressure')[-1][0] + 1.0 < time.time() + 2.0


def test_targets_are_as_a_tracker_publishes_them(peer):
    points = cloud_points(peer.last('targets'))
    assert points['id'].tolist() == list(range(23))
    assert points['x'] == pytest.approx(0.005 * np.arange(23), abs=1e-6)
    assert points['y'] == pytest.approx(np.zeros(23), abs=1e-6)


def test_a_load_moves_the_arm_and_is_felt(peer):
    assert peer.last('end_wrench').wrench.force.y == 0.0
    peer.load(y=0.02)
    assert peer.spin_until(lambda: peer.last('end_wrench').wrench.force.y == 0.02)
    assert peer.tip()[1] > 0.005
    peer.load(y=-0.02)
    assert peer.spin_until(lambda: peer.tip()[1] < -0.005)


def test_effects_are_hidden_while_it_runs(peer):
    peer.command(30e3)
    plain = peer.settled_tip()
    assert peer.set(effects='gravity.weight_y=-1.0 pressure_offset.offset=2000').successful
    try:
        assert peer.spin_until(lambda: peer.tip()[1] < plain[1] - 0.005)
        assert peer.last('pressure').fluid_pressure == pytest.approx(28e3, abs=300.0)
        about = json.loads(lab_info(peer))
        assert set(about['effects']) == {'gravity', 'pressure_offset'}
    finally:
        assert peer.set(effects='').successful
    assert peer.spin_until(lambda: np.abs(peer.tip() - plain).max() < 5e-4)


def lab_info(peer):
    """Subscribe late to lab_info and return what comes."""
    said = []
    late = peer.node.create_subscription(
        String, 'lab_info', lambda message: said.append(message.data), latched_qos()
    )
    assert peer.spin_until(lambda: said)
    peer.node.destroy_subscription(late)
    return said[-1]


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('effects', 'gravity.weight=1'),
        ('effects', 'gravity'),
        ('scenario_file', '/nowhere.yaml'),
        ('time_constant', -1.0),
        ('camera', 'images'),
    ],
)
def test_an_unfit_parameter_changes_nothing(peer, name, value):
    before = peer.get(name)
    answer = peer.set(**{name: value})
    assert not answer.successful
    assert answer.reason
    assert peer.get(name) == before


def test_a_scenario_brings_its_effects(peer, tmp_path):
    file = tmp_path / 'heavy.yaml'
    shutil.copy(share_path('scenarios/lab_arm.yaml'), tmp_path)
    text = share_path('scenarios/unloaded_ramp.yaml').read_text()
    file.write_text(f'{text}effects: {{gravity: {{weight_y: -1.0}}}}\n')
    assert peer.set(scenario_file=str(file)).successful
    try:
        assert peer.spin_until(lambda: peer.tip()[1] < -0.005)
        file.write_text('name: nothing\n')
        assert not peer.trigger('reload_model').success
    finally:
        assert peer.set(scenario_file='').successful


def test_commands_that_cannot_be_used_change_nothing_and_are_counted(peer):
    peer.command(20e3)
    peer.commands.publish(FluidPressure(fluid_pressure=math.nan))
    peer.load(x=0.1, frame_id='tool0')
    peer.load(x=math.inf)
    peer.barrier()
    peer.report()
    level, _, values = peer.report()
    assert level == Level.OK
    assert float(values['command_pa']) == 20e3
    assert float(values['force_x_n']) == 0.0
    assert int(values['rejected/not_finite']) >= 2
    assert int(values['rejected/wrong_frame']) >= 1

    def is_said():
        peer.load(x=0.1, frame_id='tool0')
        level, message, _ = peer.report()
        return level == Level.WARN and 'tool0' in message

    assert peer.spin_until(is_said)


def test_a_command_goes_as_far_as_the_arm(peer):
    peer.commands.publish(FluidPressure(fluid_pressure=1e6))
    assert peer.spin_until(lambda: float(peer.report()[2]['command_pa']) == 66e3)


# The stack in one process


def test_one_process_runs_arm_and_estimator(tmp_path):
    """The estimator predicts the arm by the model that knows the truth about it."""
    model = share_path('config/lab_arm.yaml')
    parameters = tmp_path / 'stack.yaml'
    parameters.write_text(
        f'/**/estimator: {{ros__parameters: {{model_file: {model}}}}}\n'
        '/**/virtual_arm: {ros__parameters: {rate: 50.0}}\n'
    )
    arguments = ('--params-file', str(parameters))
    stack = ('virtual_arm', 'estimator')
    output = tmp_path / 'output'
    with running_node(output, OTHER_DOMAIN, *arguments, node='stack', positional=stack) as process:
        process.wait_for('estimator]: ready: lab-arm')
        peer = Commander(OTHER_DOMAIN)
        peer.spin_until(lambda: peer.commands.get_subscription_count())
        peer.command(30e3)
        peer.received['tip'].clear()
        peer.received['true_tip'].clear()
        assert peer.spin_until(lambda: len(peer.received['tip']) > 20)
        true = {key(message): message.pose.position for message in peer.received['true_tip']}
        apart = [
            math.hypot(there.x - true[key(tip)].x, there.y - true[key(tip)].y)
            for tip in peer.received['tip']
            if key(tip) in true
            for there in [tip.pose.pose.position]
        ]
        peer.close()
        assert len(apart) > 10
        # 60 Pa of noise are about 0.15 mm here.
        assert max(apart) < 1e-3
        assert process.end(signal.SIGINT) == 0, process.text
    assert 'Traceback' not in process.text


def test_a_stack_with_an_unknown_node_is_one_sentence(tmp_path):
    output = tmp_path / 'output'
    with running_node(output, OTHER_DOMAIN, node='stack', positional=('planner',)) as process:
        assert process.process.wait(START_TIMEOUT) == 2, process.text
    assert 'planner' in process.text

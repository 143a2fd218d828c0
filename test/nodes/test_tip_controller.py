"""The example of a controller: alone, and in the loop with real processes over DDS."""

from __future__ import annotations

from contextlib import contextmanager
import importlib.util
import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.share import share_path
from pneunet_ros.messages.builders import Output
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from support.dds_peer import Peer, running_node, START_TIMEOUT  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / 'examples' / 'tip_controller.py'
WALL = ROOT / 'examples' / 'soft_wall.py'
MODEL = share_path('config/lab_arm.yaml')
DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
PATH = [(0.1038, 0.0363), (0.0896, 0.0572), (0.0462, 0.0812)]
PRESS = 0.01  # N
RATE = 50.0  # Hz, of the readings


@pytest.fixture(scope='module')
def example():
    """Import the example."""
    found = importlib.util.spec_from_file_location('tip_controller', EXAMPLE)
    module = importlib.util.module_from_spec(found)
    # A dataclass looks its module up.
    sys.modules['tip_controller'] = module
    found.loader.exec_module(module)
    yield module
    del sys.modules['tip_controller']


# The controller alone, with an arm that turns in a circle


def arm(pressure):
    """Return tip and slope of an arm whose tip goes along a circle of 0.1 m."""
    angle = pressure / 40e3
    tip = 0.1 * math.cos(angle), 0.1 * math.sin(angle)
    return tip, (-tip[1] / 40e3, tip[0] / 40e3)


COMPLIANCE = 4.0  # m/N


def inputs(controller, seconds, begin=0.0, estimates=True, wall=None, known=True):
    """Let a valve follow and the estimates come at 50 Hz; returns commands and last force.

    wall: the pressure at which the tip meets a wall of 2 N/m; known: whether the force is.
    """
    commands, pressure, force = [], controller.command, 0.0
    for step in range(round(50 * seconds)):
        now = begin + step / 50
        behind = 0.0 if wall is None else 0.1 / 40e3 * max(pressure - wall, 0.0)
        force = behind / (1.0 / 2.0 + COMPLIANCE)
        tip, slope = arm(pressure - force * COMPLIANCE * 40e3 / 0.1)
        if estimates:
            length = math.hypot(*slope)
            push = (-force * slope[0] / length, -force * slope[1] / length)
            controller.take_state(tip, slope, ((COMPLIANCE, 0.0), (0.0, COMPLIANCE)), now)
            controller.take_force(*(push if known else (math.nan, math.nan)), now)
        commands.append(controller.step(now))
        pressure += (commands[-1] - pressure) * 0.2
    return commands, force


def on_circle(*pressures):
    return [arm(pressure)[0] for pressure in pressures]


def test_it_goes_from_target_to_target(example):
    controller = example.TipController(path=on_circle(20e3, 45e3, 10e3))
    assert controller.step(-1.0) == 0.0
    assert controller.mode == 'waiting'
    commands, _ = inputs(controller, 12.0)
    assert controller.mode == 'driving'
    assert len(controller.reached) == 3
    assert max(controller.reached) < 1e-3
    assert commands[-1] == pytest.approx(10e3, abs=100.0)
    assert max(commands) < 47e3
    assert np.abs(np.diff(commands)).max() <= 20e3 / 50 + 1e-6


def test_it_goes_to_the_nearest_point_of_a_target_beside_its_way(example):
    (x, y), _ = arm(30e3)
    controller = example.TipController(path=[(1.05 * x, 1.05 * y)])
    assert inputs(controller, 6.0)[0][-1] == pytest.approx(30e3, abs=100.0)
    assert controller.reached == [pytest.approx(0.005, abs=1e-4)]


def test_it_goes_no_further_than_it_may(example):
    controller = example.TipController(path=on_circle(60e3), max_pressure=30e3)
    assert max(inputs(controller, 6.0)[0]) == 30e3
    assert controller.reached == []


def test_without_estimates_it_holds_and_then_vents_and_comes_back(example):
    controller = example.TipController(path=on_circle(40e3))
    inputs(controller, 6.0)
    held, _ = inputs(controller, 1.4, begin=6.0, estimates=False)
    assert controller.mode == 'holding'
    assert len(set(held[20:])) == 1
    vented, _ = inputs(controller, 4.0, begin=7.4, estimates=False)
    assert controller.mode == 'waiting'
    assert vented[-1] == 0.0
    assert np.diff(vented).min() >= -20e3 / 50 - 1e-6
    again, _ = inputs(controller, 4.0, begin=11.4)
    assert controller.mode == 'driving'
    assert again[0] < 401.0
    assert again[-1] == pytest.approx(40e3, abs=100.0)


@pytest.mark.parametrize('press', [0.005, 0.01])
def test_it_presses_a_wall_as_wanted_and_lets_go(example, press):
    controller = example.TipController(path=on_circle(45e3), press=press)
    commands, force = inputs(controller, 8.0, wall=25e3)
    assert controller.mode == 'pressing'
    assert force == pytest.approx(press, rel=0.02)
    assert controller.reached == []
    assert max(commands) < 1.1 * commands[-1]
    controller.path = on_circle(10e3)
    assert inputs(controller, 6.0, begin=8.0, wall=25e3)[1] == 0.0
    assert controller.command == pytest.approx(10e3, abs=200.0)


def test_where_the_force_is_not_known_it_holds_and_then_vents(example):
    """As the fusion has it where two forces explain the targets."""
    controller = example.TipController(path=on_circle(45e3))
    inputs(controller, 8.0, wall=25e3)
    held, _ = inputs(controller, 1.4, begin=8.0, wall=25e3, known=False)
    assert controller.mode == 'holding'
    assert len(set(held[20:])) == 1
    assert inputs(controller, 4.0, begin=9.4, wall=25e3, known=False)[0][-1] == 0.0
    assert inputs(controller, 8.0, begin=13.4, wall=25e3)[1] == pytest.approx(0.01, rel=0.02)


def test_a_component_across_the_way_need_not_be_known(example):
    """As F1 of a straight arm, which nothing tells."""
    controller = example.TipController(path=on_circle(45e3))
    controller.take_state((0.1, 0.0), (0.0, 1e-6), ((1.0, 0.0), (0.0, 1.0)), 0.0)
    controller.take_force(math.nan, -0.02, 0.0)
    assert controller.resistance == pytest.approx(0.02)
    controller.take_force(0.01, math.nan, 1.0)
    assert math.isnan(controller.resistance)
    assert controller.felt == 0.0


def test_numbers_that_are_none_are_no_estimates(example):
    controller = example.TipController(path=on_circle(40e3))
    no_slack = ((1.0, 0.0), (0.0, 1.0))
    controller.take_state((0.1, 0.0), (math.nan, 1e-6), no_slack, 0.0)
    controller.take_state((math.nan, 0.0), (0.0, 1e-6), no_slack, 0.0)
    controller.take_state((0.1, 0.0), (0.0, 0.0), no_slack, 0.0)
    controller.take_force(0.0, 0.0, 0.0)
    assert not controller.valid(0.1)
    assert controller.step(0.1) == 0.0
    assert controller.mode == 'waiting'
    # In a play gap the slope is zero; the last one shows the way.
    controller.take_state((0.1, 0.0), (0.0, 1e-6), no_slack, 0.2)
    controller.take_state((0.1, 0.0), (0.0, 0.0), no_slack, 0.2)
    controller.take_force(0.0, 0.0, 0.2)
    assert controller.valid(0.3)
    assert controller.step(0.3) > 0.0


def test_after_a_loss_tip_and_jacobian_are_of_one_moment(example):
    controller = example.TipController(path=on_circle(40e3))
    inputs(controller, 2.0)
    inputs(controller, 1.0, begin=2.0, estimates=False)
    assert not controller.valid(3.0)
    tip, slope = arm(10e3)
    controller.take_state(tip, slope, controller.compliance, 3.0)
    controller.take_force(0.0, 0.0, 3.0)
    assert controller.valid(3.0)
    assert (controller.tip, controller.slope) == (tip, slope)


def test_the_path_lies_where_the_tip_goes(example):
    default = re.search(r'default = \[(.*)\]', EXAMPLE.read_text()).group(1)
    numbers = [float(number) for number in default.split(',')]
    model = load_model(MODEL)
    for place, pressure in zip(
        zip(numbers[::2], numbers[1::2], strict=True), (15e3, 25e3, 35e3, 25e3), strict=True
    ):
        assert solve(model, pressure).tip[:2] == pytest.approx(place, abs=1e-4)


def test_the_page_shows_the_example(checkout):
    page = (checkout / 'docs/controller.md').read_text()
    (sample,) = re.findall(r'```text\n(.*?)```', page, re.DOTALL)
    assert len(sample.splitlines()) > 10
    example = EXAMPLE.read_text()
    parts = re.split(r'\n *# \.\.\.\n', sample.strip('\n'))
    assert len(parts) >= 2
    for part in parts:
        assert part.strip('\n') in example


# In the loop


class Observer(Peer):
    """Sees the truth and what is commanded."""

    def __init__(self, domain):
        kinds = {
            'true_tip': 'geometry_msgs/msg/PoseStamped',
            'pressure_command': PRESSURE_TYPE,
            'force_command': WRENCH_TYPE,
        }
        outputs = tuple(Output(name=name, type=kind, build=None) for name, kind in kinds.items())
        super().__init__(domain, 'virtual_arm', outputs)

    def command(self):
        return self.received['pressure_command'][-1].fluid_pressure

    def miss(self, target):
        """How far the true tip is from a target (m)."""
        place = self.received['true_tip'][-1].pose.position
        return math.dist(target, (place.x, place.y))

    def push(self, seconds):
        """How the wall has pushed in the last while (N): mean and standard deviation."""
        last = self.received['force_command'][-round(100 * seconds) :]
        forces = [math.hypot(one.wrench.force.x, one.wrench.force.y) for one in last]
        return np.mean(forces), np.std(forces)

    def presses_steadily(self, force):
        """Whether the wall has been pressed with about this force (N) for two seconds."""
        mean, std = self.push(2.0)
        return std < 0.1 * force and abs(mean - force) < 0.25 * force


@contextmanager
def running_example(script, said, *arguments):
    """Run an example that is gone afterwards in any case."""
    with said.open('w') as stream:
        process = subprocess.Popen(
            [sys.executable, str(script), '--ros-args', *arguments],
            env=os.environ | {'ROS_DOMAIN_ID': str(DOMAIN)},
            stdout=stream,
            stderr=stream,
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()


def wait_for(peer, output, words, process):
    """Wait until a process has written something, and hear what is said meanwhile."""
    end = time.monotonic() + START_TIMEOUT
    while words not in output.read_text():
        assert time.monotonic() < end, output.read_text()
        assert process.poll() is None, output.read_text()
        peer.spin_for(0.05)


def test_it_drives_the_virtual_arm_presses_a_wall_and_goes_safe_without_a_fusion(tmp_path):
    """There is no force sensor: what the wall is pressed with is estimated."""
    path = ', '.join(str(number) for point in PATH for number in point)
    said = tmp_path / 'controller'
    fuse = ('-p', f'model_file:={MODEL}', '-p', 'use_wrench:=false')
    with (
        running_node(tmp_path / 'arm', DOMAIN, '-p', f'rate:={RATE}', node='virtual_arm') as arm,
        running_node(tmp_path / 'fusion', DOMAIN, *fuse, node='fusion') as fusion,
        running_example(WALL, tmp_path / 'wall') as wall,
    ):
        arm.wait_for('ready')
        fusion.wait_for('ready')
        peer = Observer(DOMAIN)
        with running_example(EXAMPLE, said, '-p', f'path:=[{path}]') as controller:
            # The wall is where the second target is.
            for number in range(1, len(PATH)):
                wait_for(peer, said, f'target {number} of {len(PATH)} reached', controller)
            wait_for(peer, said, 'pressing', controller)
            assert peer.spin_until(lambda: peer.presses_steadily(PRESS)), peer.push(2.0)
            assert peer.miss(PATH[-1]) > 0.02
            pressed = peer.command()

            fusion.process.kill()
            wait_for(peer, said, 'holding', controller)
            assert peer.command() == pytest.approx(pressed, abs=5e3)
            wait_for(peer, said, 'venting', controller)
            assert peer.spin_until(lambda: peer.command() == 0.0)
            assert peer.spin_until(lambda: peer.miss((0.112, 0.0)) < 3e-3)
            for process in (controller, wall):
                assert process.poll() is None
                process.send_signal(signal.SIGTERM)
                assert process.wait(START_TIMEOUT) == 0, said.read_text()
        peer.close()
    assert 'Traceback' not in said.read_text() + (tmp_path / 'wall').read_text()

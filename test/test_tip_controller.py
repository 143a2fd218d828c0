"""The example of a controller: alone, and in the loop with real processes over DDS."""

from __future__ import annotations

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
from pneunet_ros.messages.readings import PRESSURE_TYPE
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from support.dds_peer import Peer, running_node, START_TIMEOUT  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
EXAMPLE = ROOT / 'examples' / 'tip_controller.py'
MODEL = share_path('config/lab_arm.yaml')
DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
PATH = [(0.1038, 0.0363), (0.0896, 0.0572), (0.1038, 0.0363)]


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


def inputs(controller, seconds, begin=0.0, estimates=True):
    """Let a valve follow and the estimates come at 50 Hz; returns the commands."""
    commands, pressure = [], controller.command
    for step in range(round(50 * seconds)):
        now = begin + step / 50
        if estimates:
            tip, slope = arm(pressure)
            controller.take_tip(*tip, now)
            controller.take_slope(*slope)
        commands.append(controller.step(now))
        pressure += (commands[-1] - pressure) * 0.2
    return commands


def on_circle(*pressures):
    return [arm(pressure)[0] for pressure in pressures]


def test_it_goes_from_target_to_target(example):
    controller = example.TipController(path=on_circle(20e3, 45e3, 10e3))
    assert controller.step(-1.0) == 0.0
    assert controller.mode == 'waiting'
    commands = inputs(controller, 12.0)
    assert controller.mode == 'driving'
    assert len(controller.reached) == 3
    assert max(controller.reached) < 1e-3
    assert commands[-1] == pytest.approx(10e3, abs=100.0)
    assert max(commands) < 47e3
    assert np.abs(np.diff(commands)).max() <= 20e3 / 50 + 1e-6


def test_it_goes_to_the_nearest_point_of_a_target_beside_its_way(example):
    (x, y), _ = arm(30e3)
    controller = example.TipController(path=[(1.05 * x, 1.05 * y)])
    assert inputs(controller, 6.0)[-1] == pytest.approx(30e3, abs=100.0)
    assert controller.reached == [pytest.approx(0.005, abs=1e-4)]


def test_it_goes_no_further_than_it_may(example):
    controller = example.TipController(path=on_circle(60e3), max_pressure=30e3)
    assert max(inputs(controller, 6.0)) == 30e3
    assert controller.reached == []


def test_without_estimates_it_holds_and_then_vents_and_comes_back(example):
    controller = example.TipController(path=on_circle(40e3))
    inputs(controller, 6.0)
    held = inputs(controller, 1.4, begin=6.0, estimates=False)
    assert controller.mode == 'holding'
    assert len(set(held[20:])) == 1
    vented = inputs(controller, 4.0, begin=7.4, estimates=False)
    assert controller.mode == 'waiting'
    assert vented[-1] == 0.0
    assert np.diff(vented).min() >= -20e3 / 50 - 1e-6
    again = inputs(controller, 4.0, begin=11.4)
    assert controller.mode == 'driving'
    assert again[0] < 401.0
    assert again[-1] == pytest.approx(40e3, abs=100.0)


def test_numbers_that_are_none_are_no_estimates(example):
    controller = example.TipController(path=on_circle(40e3))
    controller.take_slope(math.nan, 1e-6)
    controller.take_slope(0.0, 0.0)
    controller.take_tip(math.nan, 0.0, 0.0)
    assert controller.step(0.1) == 0.0
    assert controller.mode == 'waiting'
    # In a play gap the slope is zero; the last one shows the way.
    controller.take_slope(0.0, 1e-6)
    controller.take_slope(0.0, 0.0)
    controller.take_tip(0.1, 0.0, 0.2)
    assert controller.step(0.3) > 0.0


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
        kinds = {'true_tip': 'geometry_msgs/msg/PoseStamped', 'pressure_command': PRESSURE_TYPE}
        outputs = tuple(Output(name=name, type=kind, build=None) for name, kind in kinds.items())
        super().__init__(domain, 'virtual_arm', outputs)

    def command(self):
        return self.received['pressure_command'][-1].fluid_pressure

    def miss(self, target):
        """How far the true tip is from a target (m)."""
        place = self.received['true_tip'][-1].pose.position
        return math.dist(target, (place.x, place.y))


def wait_for(peer, output, words, process):
    """Wait until a process has written something, and hear what is said meanwhile."""
    end = time.monotonic() + START_TIMEOUT
    while words not in output.read_text():
        assert time.monotonic() < end, output.read_text()
        assert process.poll() is None, output.read_text()
        peer.spin_for(0.05)


def test_it_drives_the_virtual_arm_and_goes_safe_without_an_estimator(tmp_path):
    path = ', '.join(str(number) for point in PATH for number in point)
    said = tmp_path / 'controller'
    model = ('-p', f'model_file:={MODEL}')
    with (
        running_node(tmp_path / 'arm', DOMAIN, '-p', 'camera:=none', node='virtual_arm') as arm,
        running_node(tmp_path / 'estimator', DOMAIN, *model) as estimator,
        said.open('w') as stream,
    ):
        arm.wait_for('ready')
        estimator.wait_for('ready')
        peer = Observer(DOMAIN)
        controller = subprocess.Popen(
            [sys.executable, str(EXAMPLE), '--ros-args', '-p', f'path:=[{path}]'],
            env=os.environ | {'ROS_DOMAIN_ID': str(DOMAIN)},
            stdout=stream,
            stderr=stream,
        )
        try:
            for number in range(1, len(PATH) + 1):
                wait_for(peer, said, f'target {number} of {len(PATH)} reached', controller)
            assert peer.spin_until(lambda: peer.miss(PATH[-1]) < 3e-3)
            assert peer.command() == pytest.approx(15e3, abs=1e3)

            estimator.process.kill()
            wait_for(peer, said, 'holding', controller)
            assert peer.command() == pytest.approx(15e3, abs=1e3)
            wait_for(peer, said, 'venting', controller)
            assert peer.spin_until(lambda: peer.command() == 0.0)
            assert peer.spin_until(lambda: peer.miss((0.112, 0.0)) < 3e-3)
            assert controller.poll() is None

            controller.send_signal(signal.SIGTERM)
            assert controller.wait(START_TIMEOUT) == 0, said.read_text()
            assert 'Traceback' not in said.read_text()
        finally:
            if controller.poll() is None:
                controller.kill()
                controller.wait()
            peer.close()

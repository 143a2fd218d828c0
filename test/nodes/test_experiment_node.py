"""One experiment on the virtual arm: what is commanded is recorded; without an arm, no file."""

from __future__ import annotations

import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, TARGETS
from pneunet_ros.recordings.dataset_reader import read_run
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from pneunet_ros.nodes.experiment import run_experiment  # noqa: E402
import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import FluidPressure  # noqa: E402
from support.dds_peer import running_node  # noqa: E402
from support.refusals import refused  # noqa: E402

DOMAIN = (int(os.environ['ROS_DOMAIN_ID']) + 25) % 101 + 1
CORNERS = [[0.0, 0.0, 0.0, 0.0], [1.0, 8000.0, 0.1, -0.05], [3.0, 8000.0, 0.1, -0.05]]


def experiment(path: Path, corners: list[list[float]]) -> subprocess.CompletedProcess[str]:
    """Run the experiment in a process of its own, as `explore --live` does."""
    command = [sys.executable, '-m', 'pneunet_ros.nodes.experiment', str(path)]
    environment = os.environ | {'ROS_DOMAIN_ID': str(DOMAIN)}
    return subprocess.run(
        command,
        input=json.dumps(corners),
        text=True,
        capture_output=True,
        env=environment,
        timeout=300.0,
        check=False,
    )


def test_an_experiment_is_recorded_as_it_was_commanded(tmp_path):
    path = tmp_path / 'one.mcap'
    with running_node(tmp_path / 'said', DOMAIN, '-p', 'noise:=false', node='virtual_arm'):
        done = experiment(path, CORNERS)
    assert done.returncode == 0, done.stderr
    run, _ = read_run(path, 23)
    assert run.loaded
    assert 2.0 < 1e-9 * (run.reading_stamp_ns[-1] - run.reading_stamp_ns[0]) < 3.5
    assert run.pressure[0] < 1500.0
    assert run.pressure[-1] == pytest.approx(8000.0, abs=100.0)
    assert run.force[-1] == pytest.approx([0.1, -0.05], abs=1e-6)
    assert np.isfinite(run.x[-1]).all()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_experiment_that_is_interrupted_vents_the_arm(tmp_path, number):
    path = tmp_path / 'one.mcap'
    context = Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    listener = rclpy.create_node('listener', namespace='/pneunet', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(listener)
    heard: list[float] = []
    listener.create_subscription(
        FluidPressure, 'pressure_command', lambda said: heard.append(said.fluid_pressure), 100
    )

    def listen(until) -> None:
        end = time.monotonic() + 60.0
        while not until() and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.02)

    with running_node(tmp_path / 'said', DOMAIN, '-p', 'noise:=false', node='virtual_arm'):
        command = [sys.executable, '-m', 'pneunet_ros.nodes.experiment', str(path)]
        with subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            text=True,
            env=os.environ | {'ROS_DOMAIN_ID': str(DOMAIN)},
        ) as process:
            process.stdin.write(json.dumps(CORNERS))
            process.stdin.close()
            listen(lambda: heard and heard[-1] > 5000.0)
            process.send_signal(number)
            listen(lambda: process.poll() is not None)
            listen(lambda: heard and heard[-1] == 0.0)
    assert process.returncode == 130
    assert max(heard) > 5000.0
    assert heard[-1] == 0.0
    assert not list(tmp_path.glob('one*'))
    executor.shutdown()
    listener.destroy_node()
    context.try_shutdown()


def test_without_an_arm_it_says_so(tmp_path):
    done = subprocess.run(
        [
            sys.executable,
            '-c',
            'from pneunet_ros.nodes import experiment; experiment.PATIENCE = 0.5; '
            'raise SystemExit(experiment.main())',
            str(tmp_path / 'none.mcap'),
        ],
        input=json.dumps(CORNERS),
        text=True,
        capture_output=True,
        env=os.environ | {'ROS_DOMAIN_ID': str(DOMAIN)},
        timeout=300.0,
        check=False,
    )
    assert done.returncode == 2
    assert '/pneunet/pressure' in done.stderr
    assert not (tmp_path / 'none.mcap').exists()


class ShortOfPressure:
    """Stands for the node of an experiment: its pressure stops 3 s before the end."""

    corners = np.array(CORNERS)

    def __init__(self):
        now = time.monotonic()
        self.counts = {PRESSURE.name: 50, END_WRENCH.name: 100, TARGETS.name: 30}
        self.heard_at = dict.fromkeys(self.counts, now) | {PRESSURE.name: now - 3.0}
        self.pressures = self.forces = self

    def resolve_topic_name(self, name):
        return f'/p/{name}'

    def get_subscription_count(self):
        return 1

    def waited(self, ready):
        return ready()

    def spin(self, seconds, step):
        step(0.0)

    def command(self, seconds):
        pass

    def record_into(self, writer):
        pass


def test_a_sensor_that_falls_silent_makes_no_recording(tmp_path):
    with refused(RecordingError, 'silence') as caught:
        run_experiment(ShortOfPressure(), tmp_path / 'short.mcap')
    assert '/p/pressure' in str(caught.value)
    assert not list(tmp_path.iterdir())

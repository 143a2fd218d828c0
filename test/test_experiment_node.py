"""One experiment on the virtual arm: what is commanded is recorded; without an arm, no file."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
from pneunet_ros.recordings.dataset_reader import read_run
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from support.dds_peer import running_node  # noqa: E402

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
    assert 'nothing comes on /pneunet/pressure' in done.stderr
    assert not (tmp_path / 'none.mcap').exists()

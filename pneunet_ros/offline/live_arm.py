"""Experiments on a live arm, each in a separate process with ROS."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
import json
from pathlib import Path
import signal
import subprocess
import sys

from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.without_ros import GET_ROS
from pneunet_ros.exploration.experiment_design import Experiment
from pneunet_ros.exploration.safe_set import SafeSet

NAMESPACE = '/pneunet'
NODE = 'pneunet_ros.nodes.experiment'
STDERR = 2  # file descriptor
VENTED = 10.0  # s, in which an interrupted experiment vents the arm


def recorder_of(namespace: str) -> Callable[[Experiment, SafeSet, Path], None]:
    """Return the function that runs an experiment on a live arm and writes its recording.

    The arm subscribes to `pressure_command` and `force_command` in a namespace. RequestError if
    ROS is not available.
    """
    if find_spec('rclpy') is None:
        raise RequestError(
            f'--live needs ROS 2: {GET_ROS}; without ROS 2, use --by-hand', reason='not_installed'
        )

    def record(experiment: Experiment, safe: SafeSet, path: Path) -> None:
        corners = safe.corners(experiment)
        command = [sys.executable, '-m', NODE, str(path)]
        command += ['--ros-args', '-r', f'__ns:={namespace}']
        pipe = subprocess.PIPE
        # Its prompts belong on stderr: stdout may be one JSON object.
        with subprocess.Popen(
            command, stdin=pipe, stdout=STDERR, stderr=pipe, text=True
        ) as process:
            try:
                _, errors = process.communicate(json.dumps(corners.tolist()))
            except KeyboardInterrupt:
                process.send_signal(signal.SIGINT)  # the signal may not have come from a terminal
                process.wait(VENTED)
                raise
        if process.returncode:
            why = errors.strip().splitlines() or ['the process ended without a message']
            raise RequestError(f'the experiment failed: {why[-1]}', reason='failed')

    return record

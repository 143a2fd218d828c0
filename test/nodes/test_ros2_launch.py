"""Launch files by `launch` itself, where it is: ROS 2 has it, no package index does."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros
pytest.importorskip('launch_ros', reason='no launch_ros here: it comes with ROS 2')
packages = pytest.importorskip('ament_index_python.packages')
try:
    LAUNCH = Path(packages.get_package_share_directory('pneunet_ros'), 'launch')
except packages.PackageNotFoundError:
    pytest.skip('pneunet_ros is not installed by colcon here', allow_module_level=True)

RUN = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
path, *given = sys.argv[1:]
service = LaunchService()
named = [one.split(':=') for one in given]
included = IncludeLaunchDescription(path, launch_arguments=named)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""
MARK = 'PNEUNET_TEST_LAUNCH'


def launched_processes(mark):
    """Give the command lines of all processes that have a mark in their environment."""
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        try:
            if f'{MARK}={mark}'.encode() in (process / 'environ').read_bytes():
                found.append((process / 'cmdline').read_bytes().replace(b'\0', b' ').decode())
        except OSError:
            continue
    return found


@pytest.mark.parametrize(
    'given',
    [
        'estimate model_file:=missing.yaml',
        'estimate params_file:=missing.yaml',
        'track camera_file:=missing.yaml',
        'demo rviz:=perhaps',
        'demo swing_period:=abc',
        'demo effects:=hysteresis.widht=3',
        'demo model_file:=missing.yaml',
        'gripper params_file:=missing.yaml',
        'gripper object_width:=wide virtual:=true',
    ],
)
def test_what_is_refused_leaves_no_process(given, tmp_path):
    name, *arguments = given.split()
    environment = os.environ | {MARK: str(tmp_path), 'ROS_LOG_DIR': str(tmp_path)}
    command = [sys.executable, '-c', RUN, str(LAUNCH / f'{name}.launch.py'), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert 'process started' not in done.stdout + done.stderr
    assert arguments[0].split('=')[-1] in done.stdout + done.stderr
    assert launched_processes(tmp_path) == []

"""What ROS makes of a call that a signal cut off is no crash; an error without a signal is one."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip('rclpy')
pytestmark = pytest.mark.ros

PROGRAM = """
import signal
import sys
from pneunet_ros.nodes.process import run


def make_node():
    try:
        {before}
    except KeyboardInterrupt:
        pass
    raise RuntimeError('a call was cut off')


sys.exit(run([make_node], '', ['node']))
"""


@pytest.mark.parametrize(
    ('before', 'code', 'said'),
    [('signal.raise_signal(signal.SIGINT)', 0, ''), ('pass', 1, 'a call was cut off\n')],
)
def test_an_error_after_a_signal_is_the_end(before, code, said):
    done = subprocess.run(
        [sys.executable, '-c', PROGRAM.format(before=before)],
        env=os.environ,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code
    assert done.stderr.endswith(said)
    assert bool(done.stderr) == bool(said)


def test_signals_are_handled_before_anything_that_takes_a_while_is_imported():
    """Else Ctrl-C in the first second is a traceback, and nothing is said for seconds."""
    code = (
        'import sys, pneunet_ros.nodes.start;'
        'print([one for one in ("numpy", "rclpy", "email", "subprocess") if one in sys.modules])'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == '[]'

"""`make live`: all nodes as processes of their own, seen together, and all gone at the end."""

from __future__ import annotations

import math
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytestmark = [pytest.mark.ros, pytest.mark.slow]
pytest.importorskip('rclpy', reason="no rclpy here: pip install '.[ros]'")

from support.dds_peer import START_TIMEOUT  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
LIVE = [sys.executable, str(ROOT / 'examples' / 'live.py')]
LINE = re.compile(
    r' *([\d.]+) kPa +tip +(-?[\d.]+) +(-?[\d.]+) mm +from the true one +([\d.]+) mm, '
    r'fused +([\d.]+|-) mm +pull +([\d.]+) mN, force off by +([\d.]+|-) mN +'
    r'(\d+)/23 targets, +([\d.]+) mm from the shape +([\d.]+) estimates/s +([\d.]+) frames/s'
)


def numbers(text):
    """Return the numbers of every line printed, from the third on."""
    found = [match for line in text.splitlines() if (match := LINE.fullmatch(line))]
    return [
        [math.nan if number == '-' else float(number) for number in match.groups()]
        for match in found[2:]
    ]


def started(output, **environment):
    with output.open('w') as stream:
        return subprocess.Popen(
            LIVE,
            env=os.environ | {'PYTHONPATH': str(ROOT)} | environment,
            stdout=stream,
            stderr=subprocess.STDOUT,
        )


def children(process):
    """Return the processes that a process has started."""
    listed = Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text()
    return [int(number) for number in listed.split()]


def test_estimate_camera_and_truth_agree(tmp_path):
    output = tmp_path / 'output'
    process = started(output, LIVE_SECONDS='8')
    assert process.wait(3 * START_TIMEOUT) == 0, output.read_text()
    seen = numbers(output.read_text())
    assert len(seen) >= 4, output.read_text()
    for _, _, _, miss, _, _, _, targets, beside, estimates, frames in seen:
        # A mN of noise of the force sensor moves the tip by up to 4 mm here.
        assert miss < 8.0
        assert targets == 23
        # One estimate beside one frame: that noise again, over the whole shape.
        assert beside < 8.0
        assert estimates > 10
        assert frames > 1
    assert np.median([beside for *_, beside, _, _ in seen]) < 1.5
    # Where the machine is too busy for the tracker, frames are late and nothing is fused.
    assert np.nanmin([fused for *_, fused, _, _, _, _, _, _ in seen]) < 0.5
    assert np.nanmin([force for *_, force, _, _, _, _ in seen]) < 2.0
    assert 'Traceback' not in output.read_text()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_all_of_it(tmp_path, number):
    output = tmp_path / 'output'
    process = started(output)
    end = time.monotonic() + START_TIMEOUT
    while output.read_text().count('preparing') < 4:
        assert time.monotonic() < end, output.read_text()
        time.sleep(0.1)
    nodes = children(process)
    assert len(nodes) == 4
    process.send_signal(number)
    assert process.wait(START_TIMEOUT) == 0, output.read_text()
    assert 'Traceback' not in output.read_text()
    for node in nodes:
        with pytest.raises(ProcessLookupError):
            os.kill(node, 0)

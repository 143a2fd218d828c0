"""An interrupt that was caught leaves the exit code alone, wherever it was raised."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import sys
from pneunet_ros.core.interrupt import forget_interrupt
try:
    exec('raise KeyboardInterrupt')
except KeyboardInterrupt:
    {then}
sys.exit(130)
"""


@pytest.mark.parametrize(('then', 'code'), [('pass', -2), ('forget_interrupt()', 130)])
def test_an_interrupt_of_code_made_from_text_is_forgotten(then, code, tmp_path):
    (tmp_path / 'interrupted.py').write_text(PROGRAM.format(then=then))
    command = [sys.executable, '-m', 'interrupted']
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == code

"""The tab key: the shell asks, and verbs and options are the answer."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

pytest.importorskip('argcomplete', reason="no argcomplete: pip install '.[completion]'")


@pytest.mark.parametrize(
    ('line', 'answers'),
    [
        ('pneunet pre', {'predict '}),
        ('pneunet predict --mo', {'--model', '--moment'}),
        ('pneunet calibrate --law ma', {'majidi '}),
    ],
)
def test_a_line_is_completed(line, answers, tmp_path):
    asked = {
        '_ARGCOMPLETE': '1',
        '_ARGCOMPLETE_IFS': '\n',
        '_ARGCOMPLETE_STDOUT_FILENAME': str(tmp_path / 'answers'),
        'COMP_LINE': line,
        'COMP_POINT': str(len(line)),
    }
    command = [sys.executable, '-m', 'pneunet_ros.cli']
    subprocess.run(command, env=os.environ | asked, check=True, timeout=300)
    assert set((tmp_path / 'answers').read_text().splitlines()) == answers

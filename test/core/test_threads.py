"""Linear algebra in commands and nodes: one thread, asked for before numpy is there."""

from __future__ import annotations

import os
import subprocess
import sys

from pneunet_ros.core.threads import THREADS
import pytest

STARTS = {
    'pneunet_ros.cli.__main__': "sys.argv = ['pneunet', '--version']; module.main()",
    'pneunet_ros.nodes.start': "module.start('estimator', arguments=['estimator', '--help'])",
}


@pytest.mark.parametrize('asked', ['', '3'])
@pytest.mark.parametrize('name', STARTS)
def test_a_process_has_one_thread_unless_told(name, asked):
    code = (
        f'import os, sys, importlib; module = importlib.import_module({name!r})\n'
        "assert 'numpy' not in sys.modules\n"
        f'try:\n    {STARTS[name]}\nexcept SystemExit:\n    pass\n'
        f'print(*(os.environ[name] for name in {THREADS!r}))'
    )
    environment = {key: value for key, value in os.environ.items() if key not in THREADS}
    if asked:
        environment |= dict.fromkeys(THREADS, asked)
    done = subprocess.run(
        [sys.executable, '-c', code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-3:] == [asked or '1'] * 3

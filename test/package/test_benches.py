"""Every bench starts: it imports what it needs, and says what its options are."""

from __future__ import annotations

from pathlib import Path
import subprocess
import sys

import pytest

BENCHES = sorted(
    path
    for path in (Path(__file__).parents[2] / 'bench').glob('*.py')
    if '__main__' in path.read_text()
)


@pytest.mark.parametrize('bench', BENCHES, ids=lambda path: path.stem)
def test_a_bench_starts(bench):
    done = subprocess.run(
        [sys.executable, str(bench), '--help'], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert '--json' in done.stdout

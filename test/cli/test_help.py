"""The help of a verb is there at once: it imports nothing that only its work needs."""

from __future__ import annotations

import subprocess
import sys

from pneunet_ros.cli.main import GROUPS, VERBS, verbs_in_groups

# What no help needs: libraries that fit, draw or look, and the rooms that answer questions.
HEAVY = (
    *(f'scipy.{part}' for part in ('interpolate', 'linalg', 'optimize', 'sparse', 'special')),
    *('scipy.signal', 'scipy.stats', 'sklearn', 'matplotlib', 'numba', 'cv2', 'PIL', 'dask'),
    *(f'pneunet_ros.{room}' for room in ('vision', 'fusion', 'discovery', 'reports')),
    *('pneunet_ros.calibration.parameters', 'pneunet_ros.exploration.experiment_design'),
    'pneunet_ros.recordings.dataset_reader',
)
ASK = """
import contextlib, io, sys
from pneunet_ros.cli.main import main
for words in {lines!r}:
    try:
        with contextlib.redirect_stdout(io.StringIO()) as said:
            sys.argv[1:] = [*words, '--help']
            main()
    except SystemExit as error:
        assert not error.code and said.getvalue()
    print(*words, *(name for name in {heavy!r} if name in sys.modules))
"""


def test_no_help_imports_what_draws_or_fits():
    """One process for all: the first line with a module is of the verb that imports it."""
    lines = [[], *([verb.name] for verb in VERBS)]
    asked = [sys.executable, '-c', ASK.format(heavy=HEAVY, lines=lines)]
    found = subprocess.run(asked, capture_output=True, text=True, check=True)
    assert [line.split() for line in found.stdout.splitlines()] == lines


def test_every_verb_stands_in_one_group_of_the_help():
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(verb.name for verb in VERBS)
    assert all(f'  {name} ' in verbs_in_groups() for name in grouped)

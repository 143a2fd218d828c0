"""The public API: all that is listed is there, and nothing is imported before its use."""

from __future__ import annotations

import subprocess
import sys

import pneunet_ros
import pytest


def imported(code):
    """Return the modules of the package and of numpy that some code imports."""
    listed = 'print(*(name for name in sys.modules if name.startswith(("pneunet_ros.", "numpy"))))'
    command = [sys.executable, '-c', f'import sys; {code}; {listed}']
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.split()


@pytest.mark.parametrize('name', pneunet_ros.__all__)
def test_what_is_listed_is_there_and_says_what_it_is(name):
    assert getattr(pneunet_ros, name).__doc__
    assert name in dir(pneunet_ros)


def test_the_api_has_the_names_of_the_contract():
    assert {
        *('load_model', 'save_model', 'solve', 'solve_tip', 'solve_many'),
        *('Estimator', 'Tracker', 'Fusion', 'calibrate', 'diagnose'),
    } <= set(pneunet_ros.__all__)


def test_importing_the_package_imports_nothing():
    assert imported('import pneunet_ros') == []


def test_a_name_imports_what_it_needs_and_no_more():
    modules = imported('from pneunet_ros import load_model')
    assert 'pneunet_ros.files.model_file' in modules
    assert not {
        name for name in modules if name.startswith(('pneunet_ros.vision', 'pneunet_ros.diag'))
    }


def test_another_name_is_an_error_that_names_it():
    with pytest.raises(AttributeError, match="'pneunet_ros' has no attribute 'sovle'"):
        _ = pneunet_ros.sovle


@pytest.mark.parametrize('words', [['--version'], ['--help'], ['replya']])
def test_version_help_and_a_typo_import_no_verb(words):
    run = (
        'from contextlib import suppress\nfrom pneunet_ros.cli.main import main\n'
        f'with suppress(SystemExit): main({words})'
    )
    code = f'exec({run!r})'
    modules = imported(code)
    assert not {name for name in modules if name.startswith(('numpy', 'pneunet_ros.model'))}

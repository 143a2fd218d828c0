"""What README.md promises a new user: its commands run, its examples print what they show."""

from __future__ import annotations

import doctest
from pathlib import Path
import re
import shlex

from pneunet_ros.cli.main import main, VERBS
import pytest

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / 'README.md').read_text(encoding='utf-8')
SHELL = [
    line.split('#')[0].strip()
    for block in re.findall(r'```sh\n(.*?)```', README, re.DOTALL)
    for line in block.splitlines()
]
COMMANDS = [line for line in SHELL if line.startswith('pneunet ') and 'VERB' not in line]


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder that looks like a fresh clone from within, to write into."""
    for name in ('config', 'bags', 'scenarios'):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize('command', COMMANDS)
def test_commands_run(command: str, checkout: Path) -> None:
    assert main(shlex.split(command)[1:]) == 0


def test_there_are_commands_to_run() -> None:
    assert len(COMMANDS) >= 4


def test_python_example_prints_what_it_shows(checkout: Path) -> None:
    example = '\n'.join(re.findall(r'```python\n(.*?)```', README, re.DOTALL))
    test = doctest.DocTestParser().get_doctest(example, {}, 'README.md', 'README.md', 0)
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(test)
    assert runner.tries >= 8
    assert runner.failures == 0


@pytest.mark.parametrize('verb', VERBS, ids=lambda verb: verb.name)
def test_every_verb_is_documented(verb) -> None:
    assert re.search(rf'pneunet {verb.name}\b|make {verb.name}\b', README)


def test_make_targets_exist() -> None:
    named = set(re.findall(r'^make ([a-z-]+)', '\n'.join(SHELL), re.MULTILINE))
    known = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    assert named <= known
    assert {'demo', 'test', 'check', 'bench'} <= named


def test_linked_files_exist() -> None:
    links = re.findall(r'\]\((?!https?:)([^)#]+)\)', README)
    assert links
    assert all((ROOT / link).exists() for link in links)

"""The walk-through of the lab day, run as it stands in docs/walkthrough.md."""

from __future__ import annotations

from pathlib import Path
import re
import shlex

from pneunet_ros.cli.main import main
import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / 'docs/walkthrough.md').read_text(encoding='utf-8')
COMMANDS = [
    line
    for block in re.findall(r'```sh\n(.*?)```', PAGE, re.DOTALL)
    for line in block.splitlines()
]


def test_the_page_goes_all_the_way():
    verbs = [shlex.split(command)[1] for command in COMMANDS]
    assert verbs == ['check', 'calibrate', 'replay', 'replay', 'export', 'export']


@pytest.mark.slow
def test_the_page_says_what_happens(tmp_path, monkeypatch, capsys):
    for name in ('config', 'bags'):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    for command in COMMANDS:
        assert main(shlex.split(command)[1:]) == 0, command
    capsys.readouterr()
    (example,) = re.findall(r'```python\n(.*?)```', PAGE, re.DOTALL)
    exec(compile(example, 'walkthrough.md', 'exec'), {})
    said = [float(item) for item in re.findall(r'off by ([\d.]+) mm', capsys.readouterr().out)]
    (promised,) = re.findall(r'prints ([\d.]+) mm before and ([\d.]+) mm after', PAGE)
    assert said == pytest.approx([float(item) for item in promised], abs=0.05)
    assert said[1] < 0.5 * said[0]

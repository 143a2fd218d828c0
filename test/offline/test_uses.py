"""What `check` says of a recording is what the verbs do with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.reports import figure as report_figure
import pytest
from support.small_diagnosis import without_figures

TIMES = np.arange(0.0, 40.0, 0.5)
PRESSURES = 10.0 * np.minimum(TIMES // 4.0, 9.0 - TIMES // 4.0)  # kPa, stairs up and down
LENGTH = 112.0  # mm


def table(*, tip: bool, load: bool) -> str:
    """Return a table of an arm that bends as a circle, its tip as motion capture sees it."""
    noise = np.random.default_rng(4)
    kappa = np.maximum(PRESSURES, 0.1) * 0.25e-3  # 1/mm
    columns = {'time_s': TIMES, 'kPa': PRESSURES + 0.05 * noise.standard_normal(TIMES.size)}
    if tip:
        angle = kappa * LENGTH
        x, y = np.sin(angle) / kappa, (1.0 - np.cos(angle)) / kappa
        columns['tip_x_mm'] = x + 0.1 * noise.standard_normal(TIMES.size)
        columns['tip_y_mm'] = y + 0.1 * noise.standard_normal(TIMES.size)
    if load:
        columns['force_x_n'] = 0.1 + 1e-3 * noise.standard_normal(TIMES.size)
    rows = [
        ','.join(f'{value:.6f}' for value in row) for row in zip(*columns.values(), strict=True)
    ]
    return '\n'.join([','.join(columns), *rows])


@pytest.fixture
def recording(tmp_path, monkeypatch, capsys):
    """Return a function that imports a table and asks `check` about it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(report_figure, 'DOTS_PER_INCH', 20)

    def ask(**what) -> dict[str, dict]:
        Path('t.csv').write_text(table(**what))
        assert main(['import', 't.csv', '--output', 'r.mcap', '--overwrite']) == 0
        capsys.readouterr()
        assert main(['check', 'r.mcap', '--json']) == 0
        return json.loads(capsys.readouterr().out)['recordings'][0]['uses']

    return ask


def test_a_pose_of_the_tip_calibrates_as_check_says(recording, monkeypatch):
    without_figures(monkeypatch)
    uses = recording(tip=True, load=False)
    assert uses['calibrate unloaded'] == {
        'usable': True,
        'reason': 'with tip_pose as the target at the tip',
    }
    assert not uses['calibrate loaded']['usable']
    assert main(['calibrate', '--unloaded', 'r.mcap', '--output', 'm.yaml']) != 2
    assert uses['diagnose']['usable']
    words = ['diagnose', '--model', 'm.yaml', '--train', 'r.mcap', '--output', 'd']
    assert main(words) == 0


def test_an_arm_that_hardly_rests_is_not_diagnosed_and_both_say_why(tmp_path, monkeypatch, capsys):
    pytest.importorskip('mujoco', reason="needs MuJoCo: pip install '.[mujoco]'")
    monkeypatch.chdir(tmp_path)
    model = ['--model', str(share_path('config/lab_arm.yaml'))]
    assert main(['simulate', 'ringing', '--output', 'ring.mcap']) == 0
    capsys.readouterr()
    main(['check', 'ring.mcap', *model, '--json'])
    uses = json.loads(capsys.readouterr().out)['recordings'][0]['uses']
    assert not uses['diagnose']['usable']
    assert 'show the arm in motion' in uses['diagnose']['reason']
    words = ['diagnose', *model, '--train', 'ring.mcap', '--output', 'd', '--json']
    assert main(words) == 2
    assert json.loads(capsys.readouterr().out)['reason'] == 'in_motion'
    assert main([word for word in words if word != '--json']) == 2
    assert uses['diagnose']['reason'] in capsys.readouterr().err


def test_an_unloaded_recording_names_the_option_that_replays_it(recording, capsys):
    uses = recording(tip=False, load=False)
    assert uses['replay']['usable']
    assert main(['replay', 'r.mcap']) == 2
    assert '--no-wrench-required' in capsys.readouterr().err
    assert '--no-wrench-required' in uses['replay']['reason']
    assert main(['replay', 'r.mcap', '--no-wrench-required']) == 0


def test_what_lacks_targets_is_refused_by_the_verbs_that_need_them(recording):
    uses = recording(tip=False, load=True)
    for use, words in {
        'replay --fuse': ['replay', 'r.mcap', '--fuse'],
        'calibrate unloaded': ['calibrate', '--unloaded', 'r.mcap', '--output', 'm.yaml'],
        'track': ['track', 'r.mcap'],
    }.items():
        assert not uses[use]['usable']
        assert main(words) == 2
    assert uses['replay']['usable']
    assert main(['replay', 'r.mcap']) == 0

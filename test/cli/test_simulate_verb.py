"""The verb `simulate`: what it prints, what it writes, and what it refuses in one sentence."""

from __future__ import annotations

import errno
import json
from pathlib import Path
import shutil

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.cli.verbs.simulate import shipped_names
from pneunet_ros.core.share import share_path
from pneunet_ros.recordings.dataset_reader import read_run
import pytest
from support.refusals import refusal


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run the verb; returns its exit code and what stands on stdout and stderr."""
    monkeypatch.setenv('COLUMNS', '200')
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        try:
            code = main(['simulate', *arguments])
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return run


def test_a_shipped_scenario_by_its_name(run):
    code, out, err = run('strings', '--output', 'out.mcap')
    assert (code, err) == (0, '')
    assert ('0.150 to 0.250 N' in out, '0.000 to 0.275 N' in out) == (True, True)
    assert ('400 ' in out, '23 ' in out) == (True, True)
    assert ('out.mcap' in out, 'out.truth.npz' in out) == (True, True)
    assert read_run('out.mcap', 23)[0].loaded


def test_what_is_continued_is_never_replaced(run):
    assert run('strings', '--output', 'day.mcap')[0] == 0
    told = Path('day.mcap').read_bytes(), Path('day.truth.npz').read_bytes()
    for output in ('day.mcap', 'day'):  # both have the truth day.truth.npz
        words = ('random_mix', '--after', 'day.mcap', '--output', output, '--overwrite', '--json')
        code, out, _ = run(*words)
        assert (code, json.loads(out)['reason']) == (2, 'overwrites_input')
    assert (Path('day.mcap').read_bytes(), Path('day.truth.npz').read_bytes()) == told


def test_help_names_the_shipped_scenarios(run):
    _, out, _ = run('--help')
    assert all(name in out.replace('\n', ' ') for name in shipped_names())


def test_seeds_and_effects_as_json(run):
    def answer(*arguments):
        code, out, err = run(*arguments, '--output', 'out.mcap', '--overwrite', '--json')
        assert (code, err, out.count('\n')) == (0, '', 1)
        with np.load('out.truth.npz') as truth:
            return json.loads(out), truth['target_x'], read_run('out.mcap', 23)[0].pressure

    first, x, pressure = answer('unloaded_ramp')
    assert (first['loaded'], first['wrench_readings'], first['frames']) == (False, 0, 400)
    assert first['scenario']['seed'] == 1
    assert first['truth'] == 'out.truth.npz'
    again, other_x, other_pressure = answer('unloaded_ramp', '--seed', '2')
    assert again['scenario']['seed'] == 2
    assert np.array_equal(x, other_x)  # the same arm
    assert not np.array_equal(pressure, other_pressure)  # other noise
    arm, other_x, other_pressure = answer('unloaded_ramp', '--arm-seed', '5')
    assert arm['arm'] == 'lab-arm-5'
    assert not np.array_equal(x, other_x)
    assert np.array_equal(pressure, other_pressure)
    heavy, other_x, _ = answer('unloaded_ramp', '--effect', 'gravity.weight_y=-0.5')
    assert heavy['scenario']['effects']['gravity']['weight_y'] == -0.5
    assert np.abs(x - other_x).max() > 1e-3


def test_a_recording_after_another_one(run):
    effect = ('--effect', 'softening.loss=0.3')
    assert run('unloaded_ramp', *effect, '--output', 'first.mcap')[0] == 0
    tips = []
    for after in ((), ('--after', 'first.mcap')):
        code, _, _ = run('strings', *effect, *after, '--output', 'x.mcap', '--overwrite')
        assert code == 0
        with np.load('x.truth.npz') as truth:
            tips.append(truth['x'][:, -1])
    assert np.abs(tips[1] - tips[0]).max() > 1e-4


def test_the_memory_of_another_arm_is_refused(run):
    effects = ('--effect', 'hysteresis.width=3000')
    assert run('strings', *effects, '--output', 'first.mcap')[0] == 0
    with np.load('first.truth.npz') as content:
        arrays = {name: content[name] for name in content.files}
    memory = json.loads(str(arrays['memory']))
    memory['time'] = 0.0
    memory['past']['hysteresis'].append(0.0)
    np.savez('first.truth.npz', **arrays | {'memory': np.array(json.dumps(memory))})
    words = ('strings', *effects, '--after', 'first.mcap', '--output', 'x.mcap', '--json')
    assert refusal(run(*words)) == 'other_arm'


def test_a_scenario_file_of_the_user(run, tmp_path):
    for name in ('lab_arm', 'strings'):
        shutil.copy(share_path(f'scenarios/{name}.yaml'), tmp_path)
    assert run('strings.yaml', '--output', 'here/out.mcap')[0] == 0
    assert Path('here/out.truth.npz').is_file()


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['jump'], 'not_found'),
        (['jump.yaml'], 'not_found'),
        (['strings', '--effect', 'gravity'], 'wrong_form'),
        (['strings', '--effect', 'drag.c=1'], 'unknown_key'),
        (['strings', '--effect', 'gravity.g=1'], 'unknown_key'),
        (['strings', '--effect', 'load_offset.offset=9'], 'out_of_bounds'),
        (['strings', '--seed', '-1'], 'usage'),
        (['strings', '--after', 'none.mcap'], 'no_truth'),
        (['strings', '--output', 'out.csv.db3'], 'wrong_suffix'),
    ],
)
def test_what_is_wrong_is_one_sentence_and_leaves_nothing(run, tmp_path, arguments, reason):
    output = [] if '--output' in arguments else ['--output', 'out.mcap']
    assert refusal(run(*arguments, *output, '--json')) == reason
    assert not list(tmp_path.iterdir())


def test_a_recording_that_would_not_fit_into_memory_is_refused(run, tmp_path):
    text = share_path('scenarios/unloaded_ramp.yaml').read_text()
    shutil.copy(share_path('scenarios/lab_arm.yaml'), tmp_path)
    (tmp_path / 'long.yaml').write_text(text.replace('duration: 40.0', 'duration: 1.0e5'))
    assert refusal(run('long.yaml', '--output', 'out.mcap', '--json')) == 'too_large'
    assert not (tmp_path / 'out.mcap').exists()


@pytest.mark.parametrize('name', ['[/]', '[bold]x', r'\x1b[2J'])
def test_no_name_of_a_scenario_is_markup(run, tmp_path, name):
    text = share_path('scenarios/unloaded_ramp.yaml').read_text()
    shutil.copy(share_path('scenarios/lab_arm.yaml'), tmp_path)
    lines = [f'name: "{name}"' if line.startswith('name:') else line for line in text.split('\n')]
    (tmp_path / 'odd.yaml').write_text('\n'.join(lines))
    code, out, err = run('odd.yaml', '--output', 'out.mcap')
    assert (code, err) == (0, '')
    assert f'{name} ' in out


def test_recording_and_truth_stand_together_or_not_at_all(run, tmp_path, monkeypatch):
    def fail(path):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('pneunet_ros.recordings.recording_writer.write_checksums', fail)
    assert refusal(run('unloaded_ramp', '--output', 'out.mcap', '--json')) == 'unwritable'
    assert list(tmp_path.iterdir()) == []


def test_existing_files_are_refused(run, tmp_path):
    (tmp_path / 'out.truth.npz').write_text('precious')
    assert refusal(run('strings', '--output', 'out.mcap', '--json')) == 'exists'
    assert (tmp_path / 'out.truth.npz').read_text() == 'precious'

"""The verb `explore`: what it writes after a recording, what it refuses, and how it waits."""

from __future__ import annotations

from functools import partial
import io
import json
from pathlib import Path
import re

from pneunet_ros import load_model
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.conclusion import withdraw_name
from pneunet_ros.discovery.result import Discovery
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.exploration import exploration
from pneunet_ros.exploration.experiments import BEGINNING, experiments
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.offline import live_arm
from pneunet_ros.offline.live_arm import NAMESPACE, recorder_of
from pneunet_ros.recordings import dataset_reader
from pneunet_ros.recordings.dataset_reader import read_run
import pytest
from support.refusals import refusal, refused
from support.small_diagnosis import without_figures

ARM = share_path('scenarios/lab_arm.yaml')
SCENARIO = """schema_version: 1
name: small
arm: lab_arm.yaml
protocol: {kind: slow_ramp}
rates: {pressure: 10.0, wrench: 10.0, frames: 2.0}
detail: {elements: 64, stations: 9}
"""


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run the verb in a folder of its own; returns exit code, stdout and stderr."""
    without_figures(monkeypatch)
    monkeypatch.chdir(tmp_path)
    Path('small.yaml').write_text(SCENARIO)
    Path('lab_arm.yaml').write_bytes(ARM.read_bytes())

    def run(*arguments):
        try:
            code = main(['explore', *arguments])
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return run


def test_after_a_recording_all_files_are_there_and_it_says_what_to_type(run):
    hidden = ('--effect', 'pressure_elongation.strain_per_pascal=2e-6')
    code, out, err = run(
        '--simulated', 'small.yaml', *hidden, '--recordings', '1', '--output', 'out'
    )
    assert code == 1, err  # nothing has tested the name yet
    content = json.loads(Path('out/exploration.json').read_text())
    assert content['answer'] == 'named'
    assert content['clear'] is False
    (row,) = content['rounds']
    assert row['effects'] == ['pressure_elongation']
    assert row['recorded'] == BEGINNING.words
    assert row['rms_after_m'] < 0.8 * row['rms_before_m']  # of what is left beside placement
    assert row['rms_predicted_m'] is None
    assert 'pressure_elongation' not in row['rivals']  # it is named; what is beside it?
    assert content['safe']['pressure'] == [0.0, 66000.0]
    arm = load_model('out/diagnosis/model.yaml')
    assert [effect.name for effect in arm.effects] == ['pressure_elongation']
    assert re.search(r'pneunet (diagnose|replay) ', ' '.join(out.split()))
    assert 'pressure_elongation' in Path('out/exploration.html').read_text()
    assert refusal(run('--simulated', 'small.yaml', '--output', 'out', '--json')) == 'exists'


def test_nothing_missing_without_a_load_says_what_could_not_have_been_seen(run):
    code, out, err = run('--simulated', 'small.yaml', '--recordings', '1', '--output', 'out')
    assert code == 1, err
    content = json.loads(Path('out/exploration.json').read_text())
    assert content['answer'] == 'none'
    assert content['clear'] is False
    assert {'load_offset', 'stiffening', 'extensibility'} <= {*content['undetectable']}
    assert 'pressure_gain' not in content['undetectable']  # no recording could ever show it
    assert 'load_offset' in out


@pytest.mark.slow
def test_a_name_that_a_law_overrules_is_taken_back_in_every_file(run, monkeypatch):
    def overruled(investigation, *, on_progress):
        diagnosis = withdraw_name(investigation, 'a law says it better')
        return Discovery(searched=True, overruling=diagnosis)

    monkeypatch.setattr('pneunet_ros.discovery.discovery.discover', overruled)
    hidden = ('--effect', 'pressure_elongation.strain_per_pascal=2e-6')
    code, out, err = run('--simulated', 'small.yaml', *hidden, '--recordings', '1',
                         '--output', 'out', '--json')  # fmt: skip
    assert code == 1, err
    kept = json.loads(Path('out/exploration.json').read_text())
    diagnosis = json.loads(Path('out/diagnosis/diagnosis.json').read_text())
    assert json.loads(out)['rounds'] == kept['rounds']
    for content in (json.loads(out), kept, kept['rounds'][0], diagnosis):
        assert content['answer'] == 'unknown'
    for content in (kept['rounds'][0], diagnosis):
        assert content['effects'] == []
        assert 'pressure_elongation' in content['notes'][0]
    assert not load_model('out/diagnosis/model.yaml').effects
    assert 'pressure_elongation' in kept['rounds'][0]['rivals']  # it is in question again


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        ((), 'usage'),
        (('--simulated', 'small.yaml', '--recordings', '0'), 'out_of_bounds'),
        (('--simulated', 'nothing'), 'not_found'),
        (('--simulated', 'small.yaml', '--pressure', '0', '1e6'), 'out_of_range'),
        (('--simulated', 'small.yaml', '--pressure', '3e4', '3e4'), 'out_of_bounds'),
        (('--simulated', 'small.yaml', '--largest-force', '-1'), 'out_of_bounds'),
        (('--simulated', 'small.yaml', '--largest-force', '9'), 'out_of_range'),
        (('--by-hand', '--effect', 'creep.amplitude=0.1'), 'exclusive'),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_recorded(run, arguments, reason):
    assert refusal(run(*arguments, '--output', 'out', '--json')) == reason
    assert not Path('out').exists()


def test_by_hand_it_says_what_to_do_and_waits(run, monkeypatch):
    monkeypatch.setattr('sys.stdin', io.StringIO('\n'))  # once Enter, then nobody
    words = ('--by-hand', '--pressure', '0', '50000', '--output', 'out', '--json')
    code, out, err = run(*words)
    assert code == 2
    assert json.loads(out)['reason'] == 'not_found'  # one JSON object and nothing else
    assert 'recording_01.mcap' in err
    assert f'{BEGINNING.seconds:g} s: {BEGINNING.words}' in err
    assert '  26.0   30.0   0.000   0.000' in err
    assert err.count('Enter') == 2
    assert 'end_wrench' not in err
    loaded = next(item for item in experiments() if item.loaded)
    monkeypatch.setattr(exploration, 'BEGINNING', loaded)
    monkeypatch.setattr('sys.stdin', io.StringIO())
    assert 'needs end_wrench' in run('--by-hand', '--output', 'under_load', '--json')[2]


def test_a_recording_under_load_without_the_load_is_refused(run, monkeypatch):
    loaded = next(item for item in experiments() if item.loaded)
    monkeypatch.setattr(exploration, 'BEGINNING', loaded)
    without = partial(read_run, settings=EstimatorSettings(wrench_required=False))
    monkeypatch.setattr(dataset_reader, 'read_run', without)
    code, out, _ = run('--simulated', 'small.yaml', '--output', 'out', '--json')
    assert code == 2
    assert json.loads(out)['reason'] == 'not_loaded'


@pytest.fixture
def stand_in(monkeypatch, tmp_path):
    """Give a function that puts lines of Python in the place of the node of experiments."""

    def put(*lines):
        (tmp_path / 'stand_in.py').write_text('\n'.join(('import json, signal, sys', *lines)))
        monkeypatch.setenv('PYTHONPATH', str(tmp_path))
        monkeypatch.setattr(live_arm, 'NODE', 'stand_in')
        monkeypatch.setattr(live_arm, 'find_spec', lambda name: object())

    return put


def test_a_live_experiment_is_a_process_with_the_corners(monkeypatch, stand_in, tmp_path):
    stand_in("json.dump([sys.argv[1:], json.load(sys.stdin)], open(sys.argv[1], 'w'))")
    item = next(item for item in experiments() if item.loaded)
    safe, path = SafeSet(low=1e3, high=2e3, force=0.5), tmp_path / 'one.mcap'
    recorder_of('/left')(item, safe, path)
    arguments, corners = json.loads(path.read_text())
    assert arguments == [str(path), '--ros-args', '-r', '__ns:=/left']
    assert corners == safe.corners(item).tolist()
    stand_in("sys.exit('first\\nno valve')")
    with refused(RequestError, 'failed'):
        recorder_of(NAMESPACE)(item, safe, tmp_path / 'two.mcap')
    monkeypatch.setattr(live_arm, 'find_spec', lambda name: None)
    with refused(RequestError, 'not_installed'):
        recorder_of(NAMESPACE)


def test_a_live_experiment_asks_on_stderr(capfd, stand_in, tmp_path):
    stand_in("print('Press Enter')")
    item = next(item for item in experiments() if item.loaded)
    recorder_of(NAMESPACE)(item, SafeSet(low=1e3, high=2e3, force=0.5), tmp_path / 'one.mcap')
    assert capfd.readouterr() == ('', 'Press Enter\n')


def test_who_is_interrupted_waits_until_the_arm_is_vented(stand_in, tmp_path):
    vented = tmp_path / 'vented'
    stand_in(
        'import os, time',
        'try:',
        '    os.kill(os.getppid(), signal.SIGINT)',
        '    time.sleep(60)',
        'except KeyboardInterrupt:',
        '    time.sleep(1)',
        f'    open({str(vented)!r}, "w").close()',
    )
    item = next(item for item in experiments() if item.loaded)
    with pytest.raises(KeyboardInterrupt):
        recorder_of(NAMESPACE)(item, SafeSet(low=1e3, high=2e3, force=0.5), tmp_path / 'one.mcap')
    assert vented.exists()

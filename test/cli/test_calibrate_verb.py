"""The verb `calibrate`: recordings of the lab to a model that replays; what it refuses."""

from __future__ import annotations

from argparse import Namespace
import contextlib
import dataclasses
from functools import cache
import hashlib
import io
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.calibration import calibration
from pneunet_ros.calibration.result import Fit
from pneunet_ros.cli.main import main
from pneunet_ros.cli.provenance import provenance_of
from pneunet_ros.core.errors import ModelError, RecordingError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import save_model
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.offline.calibration_files import knowledge_file, load_knowledge, save_knowledge
from pneunet_ros.recordings.lab_files import write_lab
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.refusals import refusal, refused

FRAME_RATE = 1.0  # Hz, few frames, to be quick
FREE, LOADED = ('unloaded_ramp', 'unloaded_staircase'), ('force_sweeps', 'strings')
LATER = 'dead_weights'


@cache
def recorded(name: str):
    scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
    rates = dataclasses.replace(scenario.rates, frames=FRAME_RATE)
    return simulate(dataclasses.replace(scenario, rates=rates))


@pytest.fixture(scope='module')
def lab(tmp_path_factory) -> Path:
    """Return a folder with recordings of the lab."""
    folder = tmp_path_factory.mktemp('lab')
    for name in (*FREE, *LOADED, LATER):
        write_lab(
            recorded(name), folder / f'{name}.mcap', overwrite=False, on_progress=lambda: None
        )
    return folder


@pytest.fixture
def run(capsys, monkeypatch, lab, tmp_path):
    """Run the verb in a folder of its own; returns its exit code, stdout and stderr."""
    monkeypatch.setenv('COLUMNS', '200')
    monkeypatch.chdir(tmp_path)

    def run(*arguments, verb='calibrate'):
        try:
            code = main([verb, *(str(item) for item in arguments)])
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return run


def files(lab: Path, names) -> list[Path]:
    return [lab / f'{name}.mcap' for name in names]


def all_of(lab: Path) -> list:
    return ['--unloaded', *files(lab, FREE), '--loaded', *files(lab, LOADED)]


@pytest.fixture(scope='module')
def model(lab, tmp_path_factory) -> tuple[Path, dict]:
    """Return a calibrated model and what the verb said of it as JSON."""
    path = tmp_path_factory.mktemp('model') / 'lab.yaml'
    said = io.StringIO()
    arguments = ['calibrate', *all_of(lab), '--output', path, '--no-compare', '--json']
    with contextlib.redirect_stdout(said):
        assert main([str(item) for item in arguments]) == 0
    return path, json.loads(said.getvalue())


def test_what_programs_are_told(model, lab):
    path, said = model
    assert said['converged'] is True
    assert (said['output'], said['report']) == (str(path), None)
    names = [item['name'] for item in said['quantities']]
    assert 'moment_law.rigidity.0.1' in names
    assert 'intrinsic_curvature.curvature.0.0' in names
    assert all(0.0 < item['std'] <= 1.001 * item['prior_std'] for item in said['quantities'])
    assert set(said['noise']) == {
        'pressure_std', 'force_std', 'moment_std', 'target_std', 'placement_std',
        'registration_std', 'drift_std',
    }  # fmt: skip
    assert [item['loaded'] for item in said['recordings']] == [False, False, True, True]
    for item in said['recordings']:
        # At a frame a second, motion counts as noise: less than 1.
        assert 0.3 < item['chi_squared_per_coordinate'] < 1.4
        assert item['rms'] < 5e-4  # 1 mN and 60 Pa move the end by tenths of a millimeter
    assert said['laws'] == []
    inputs = said['provenance']['recordings']
    assert [item['role'] for item in inputs] == ['unloaded'] * 2 + ['loaded'] * 2
    for item in inputs:
        content = (lab / item['file']).read_bytes()
        assert item['sha256'] == hashlib.sha256(content).hexdigest()


def test_recordings_of_which_nothing_is_left_were_not_used(tmp_path):
    names = [tmp_path / name for name in ('used', 'swings')]
    for name in names:
        name.write_bytes(name.name.encode())
    found = SimpleNamespace(
        motion=SimpleNamespace(lost=(str(names[1]),)),
        joint=SimpleNamespace(chi_squared=1.0, dof=1),
        explained_variance=1.0,
    )
    runs = [SimpleNamespace(name=str(name)) for name in names]
    said = provenance_of(Namespace(arm=None, earlier=None), found, {'loaded': runs})
    assert [item['role'] for item in said['recordings']] == ['loaded', 'left out']


def test_the_model_is_complete(model):
    path, said = model
    arm = load_model(path)
    assert arm.name == 'lab'
    assert arm.covariance is not None
    assert list(arm.provenance['recordings']) == said['provenance']['recordings']
    values = {item['name']: item['value'] for item in said['quantities']}
    assert arm.moment_law.rigidity[0, 1] == pytest.approx(values['moment_law.rigidity.0.1'])
    truth = recorded('strings').truth
    for frame in (10, 30):
        shape = solve(arm, float(truth.pressure[frame]), tuple(truth.force[frame].tolist()))
        tip = np.hypot(shape.x[-1] - truth.x[frame, -1], shape.y[-1] - truth.y[frame, -1])
        assert tip < 4e-4


def test_the_model_replays_and_predicts(model, lab, run):
    path, _ = model
    code, _, err = run(
        lab / 'strings.mcap', '--model', path, '--output', 'out.mcap', verb='replay'
    )
    assert (code, err) == (0, '')
    assert any(topic.name.endswith('/tip') for topic in open_recording(Path('out.mcap')).topics)
    code, out, _ = run('--pressure', '31000', '--model', path, '--json', verb='predict')
    assert code == 0
    assert json.loads(out)['tip_std']


def test_people_are_shown_a_summary(run, lab, monkeypatch):
    reported = []
    written = 'pneunet_ros.reports.calibration.report.write_report'
    monkeypatch.setattr(written, lambda *args, **_: reported.append(args[1]))
    code, out, err = run(
        '--unloaded', *files(lab, FREE), '--output', 'free.yaml',
        '--report', 'report',
    )  # fmt: skip
    assert code == 0, err
    assert 'unloaded_ramp.mcap' in out
    assert all(name in out for name in ('free.yaml', 'free.knowledge.npz', 'report/index.html'))
    assert reported == [Path('report')]
    arm = load_model('free.yaml')
    assert arm.name == 'free'


@pytest.mark.slow
def test_laws_are_compared_and_the_report_written(run, lab):
    code, out, err = run(*all_of(lab), '--output', 'arm.yaml', '--report', 'report')
    assert code == 0, err
    assert all(kind in out for kind in ('piecewise_linear', 'linear', 'majidi'))
    assert Path('report/index.html').stat().st_size > 10_000


def test_a_calibration_goes_on(run, lab, model):
    path, said = model
    code, out, err = run(
        '--loaded', lab / f'{LATER}.mcap', '--continue', path, '--output', 'on.yaml',
        '--no-compare', '--json',
    )  # fmt: skip
    assert code == 0, err
    more = json.loads(out)
    assert more['provenance']['continued'] == 'lab.yaml'
    before, after = (
        np.array([item['std'] for item in some['quantities']]) for some in (said, more)
    )
    assert np.all(after < 1.001 * before)
    assert load_knowledge(Path('on.yaml')).kind == 'piecewise_linear'


def test_a_calibration_of_another_arm_does_not_go_on(run, lab, model, tmp_path):
    arm = load_model(model[0])
    save_model(dataclasses.replace(arm, weight=1.05 * arm.weight), tmp_path / 'other.yaml')
    words = ('--loaded', lab / f'{LATER}.mcap', '--continue', model[0], '--output', 'on.yaml')
    assert refusal(run(*words, '--arm', tmp_path / 'other.yaml', '--json')) == 'other_arm'


def test_a_recording_counts_once(run, lab, model):
    path, _ = model
    free, copy = lab / 'unloaded_ramp.mcap', Path('copy.mcap')
    copy.write_bytes((lab / 'strings.mcap').read_bytes())
    for words in (
        ('--unloaded', free, '--loaded', lab / 'strings.mcap', copy),
        ('--loaded', copy, '--continue', path),
    ):
        assert refusal(run(*words, '--output', 'twice.yaml', '--json')) == 'given_twice'
    assert [*Path().iterdir()] == [copy]


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['--loaded', 'strings'], 'no_unloaded'),
        (['--unloaded', 'strings'], 'loaded'),
        (['--unloaded', 'unloaded_ramp', '--loaded', 'unloaded_staircase'], 'not_loaded'),
        (['--unloaded', 'nowhere'], 'not_found'),
        (['--unloaded', 'unloaded_ramp', '--continue', 'no.yaml'], 'not_found'),
        (['--unloaded', 'unloaded_ramp', '--topic', 'targets=/other'], 'no_topic'),
    ],
)
def test_what_is_wrong_is_one_sentence(run, lab, arguments, reason):
    known = [lab / f'{item}.mcap' if item.isidentifier() else item for item in arguments]
    assert refusal(run(*known, '--output', 'model.yaml', '--json')) == reason
    assert not list(Path().iterdir())


@pytest.mark.parametrize('taken', ['model.yaml', 'model.knowledge.npz', 'report'])
def test_nothing_is_overwritten_unasked(run, lab, taken, monkeypatch):
    read = 'pneunet_ros.recordings.dataset_reader.read_run'
    monkeypatch.setattr(read, lambda *_: pytest.fail('read before it refused'))
    Path(taken).write_text('mine')
    said = run(*all_of(lab), '--output', 'model.yaml', '--report', 'report', '--json')
    assert refusal(said) == 'exists'
    assert taken in said[2]
    assert Path(taken).read_text() == 'mine'


def test_the_output_is_a_yaml_file(run, lab):
    assert refusal(run(*all_of(lab), '--output', 'model.json', '--json')) == 'wrong_suffix'


def test_a_report_that_cannot_be_written_leaves_no_model_either(run, lab, monkeypatch):
    Path('file').write_text('')
    output = ('--output', 'model.yaml', '--report', 'file/report', '--json')
    assert refusal(run('--unloaded', *files(lab, FREE[:1]), *output)) == 'unwritable'
    assert [path.name for path in Path().iterdir()] == ['file']


def test_without_convergence_there_is_no_model(run, lab, monkeypatch):
    whole = calibration.calibrate

    def stopped(*arguments, **options):
        found = whole(*arguments, **options)
        parts = {item: getattr(found.joint, item) for item in Fit.__dataclass_fields__}
        joint = Fit(**(parts | {'converged': False, 'status': 'on-purpose'}))
        return dataclasses.replace(found, joint=joint)

    monkeypatch.setattr(calibration, 'calibrate', stopped)
    code, out, _ = run('--unloaded', *files(lab, FREE[:1]), '--output', 'model.yaml')
    assert code == 1
    assert 'on-purpose' in out
    assert not list(Path().iterdir())


def test_knowledge_comes_back_as_it_was(model, tmp_path):
    known = load_knowledge(model[0])
    save_knowledge(known, tmp_path / 'again.yaml', overwrite=False)
    again = load_knowledge(tmp_path / 'again.yaml')
    assert known.arm is not None
    for item in dataclasses.fields(known):
        assert np.array_equal(getattr(known, item.name), getattr(again, item.name))
    with refused(RecordingError, 'exists'):
        save_knowledge(known, tmp_path / 'again.yaml', overwrite=False)


@pytest.mark.parametrize('damage', ['half', 'text', 'empty', 'key', 'shape'])
def test_damaged_knowledge_is_said(model, tmp_path, damage):
    path = tmp_path / 'arm.yaml'
    file = knowledge_file(path)
    content = knowledge_file(model[0]).read_bytes()
    if damage in ('key', 'shape'):
        with np.load(knowledge_file(model[0])) as stored:
            arrays = dict(stored)
        if damage == 'key':
            del arrays['values']
        else:
            arrays['values'] = arrays['values'][:-1]
        np.savez(file, **arrays)
    else:
        file.write_bytes(
            {'half': content[: len(content) // 2], 'text': b'abc', 'empty': b''}[damage]
        )
    with refused(ModelError, 'damaged'):
        load_knowledge(path)


def test_missing_knowledge_is_said(tmp_path):
    with refused(ModelError, 'not_found'):
        load_knowledge(tmp_path / 'arm.yaml')

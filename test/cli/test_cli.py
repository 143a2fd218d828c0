"""The command `pneunet`: exit codes, what stands on stdout and stderr, and the files it leaves."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import json
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from typing import ClassVar

from matplotlib.image import imread
import numpy as np
from pneunet_ros import __version__, load_model, solve
from pneunet_ros.cli.main import main, parser, VERBS
from pneunet_ros.cli.verbs.predict import estimate_uncertainty
from pneunet_ros.core.frames import rotate
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Effect
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.model_file import save_model
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import PRESSURE_TYPE, targets_message, WRENCH_TYPE
from pneunet_ros.messages.targets import TARGET_POINT
from pneunet_ros.model.domain_position import LOAD_BEYOND
from pneunet_ros.model.equilibrium import tip_jacobian
from pneunet_ros.model.uncertainty import ModelCovariance
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.example_arms import WIDE
from support.films import encoded, film, pictures, write_folder, write_messages
from support.made_recordings import PRESSURE, pressure, WRENCH, wrench
from support.refusals import refusal

MODEL = share_path('config/paper_arm.yaml')
ARM = load_model(MODEL)
LOADED = ['predict', '--pressure', '31e3', '--force', '0.175', '0.07']
PREDICTED = {
    'units', 'scales', 'force_std', 'force_covariance',
    'status', 'converged', 'residual', 'iterations', 'stable', 'extrapolated', 'pressure',
    'force', 'moment_at_end', 'arclength', 'x', 'y', 'theta', 'curvature', 'intrinsic_curvature',
    'moment', 'tip', 'tip_std', 'std_leaves_out', 'warnings', 'jacobian',
}  # fmt: skip


@pytest.fixture
def run(capsys, monkeypatch):
    """Run the command; returns its exit code and what stands on stdout and stderr."""
    monkeypatch.setenv('COLUMNS', '200')

    def run(*arguments):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def run_json(run):
    """Run the command with --json; returns its exit code and the one object on stdout."""

    def run_json(*arguments):
        code, out, err = run(*arguments, '--json')
        assert err == ''
        assert out.count('\n') == 1

        def refuse(constant):
            raise AssertionError(f'{constant} is no JSON')

        return code, json.loads(out, parse_constant=refuse)

    return run_json


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    """Thirty readings, of which one is out of range."""
    path = tmp_path_factory.mktemp('recording') / 'in.mcap'
    with write_recording(path) as writer:
        pressures, wrenches = writer.add(PRESSURE, PRESSURE_TYPE), writer.add(WRENCH, WRENCH_TYPE)
        for index in range(1, 31):
            stamp = index * 10_000_000
            value = 500e3 if index == 20 else 31e3 + index
            writer.write(wrenches, stamp, wrench(stamp))
            writer.write(pressures, stamp, pressure(stamp, value))
    return path


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


# All verbs


def test_its_version(run):
    assert run('--version') == (0, f'pneunet_ros {__version__}\n', '')


def test_help_names_all_verbs_and_exit_codes(run):
    code, out, _ = run('--help')
    assert code == 0
    assert all(re.search(rf'^ +{verb.name}\b', out, re.MULTILINE) for verb in VERBS)


@pytest.mark.parametrize('verb', VERBS, ids=lambda verb: verb.name)
def test_help_of_every_verb_explains_every_option(run, verb):
    code, out, err = run(verb.name, '--help')
    assert (code, err) == (0, '')
    assert verb.help in ' '.join(out.split())
    assert '--json' in out
    explained = re.findall(r'^  (--[a-z-]+).*(?:\n {20,}| {2,})\S', out, re.MULTILINE)
    assert set(explained) == set(re.findall(r'^  (--[a-z-]+)', out, re.MULTILINE))


def test_help_of_predict_has_units_and_defaults(run):
    out = ' '.join(run('predict', '--help')[1].split())
    for words in (
        'pressure: Pa,',
        'frame: N, or with a unit',
        '(default: 0 0)',
        'end: N m, or with a unit, e.g. 0.2mNm (default: 0)',
        'of the tip: m,',
    ):
        assert words in out


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        ([], 'VERB is missing; a complete command: pneunet demo'),
        (['replai'], "'replai' is not a verb (replay?)"),
        (['walk'], "'walk' is not a verb; "),
        (['predict'], 'give --pressure (e.g. 31kPa) or --pressure-for (e.g. tip 95mm 40mm)'),
        (['predict', '--pressure', 'high'], "--pressure: 'high' is not a pressure"),
        (['predict', '--pressure', '1', '--force', '1'], '--force: expected 2 arguments'),
        (['predict', '--presure', '1'], '--presure is not an option (--pressure?)'),
        (['predict', '--pressure=1', '--output=x'], '--output is not an option; '),
        (['predict', '--pressure', '1', '-5'], '-5 belongs to no option; '),
        (['replay'], 'REC is missing; '),
        (['replay', 'x.mcap', '--wrench-sign', '2'], '--wrench-sign: invalid choice'),
        (['track'], 'REC_OR_IMAGES is missing; '),
        (['effects', 'all'], 'all belongs to no option; a complete command: pneunet effects'),
        (['calibrate', 'u.mcap'], 'u.mcap belongs to no option, and --output is missing; '),
        (['calibrate', 'u', 'l', '--output', 'm.yaml'], 'u l belong to no option; a complete'),
        (['calibrate'], 'calibrate --unloaded FREE.mcap --loaded PULLED.mcap --arm arm.yaml --ou'),
        (['diagnose', 'u'], 'u belongs to no option, and --model, --train and --output are mis'),
        (['explore', '--output', 'x'], 'one of --simulated, --live, --by-hand is missing; '),
    ],
    ids=lambda given: ' '.join(given) if isinstance(given, list) else '',
)
def test_misuse_is_one_sentence_that_says_what_to_type(run, arguments, words):
    code, out, err = run(*arguments)
    assert (code, out) == (2, '')
    assert err.startswith('pneunet')
    assert err.count('\n') == 1
    assert words in err


@pytest.mark.parametrize('verb', VERBS, ids=lambda verb: verb.name)
def test_the_example_of_a_verb_is_a_whole_command(verb):
    words = verb.example.split()
    assert words[:2] == ['pneunet', verb.name]
    assert parser(words[1:]).parse_args(words[1:]).verb == verb.name


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        ([*LOADED, '--tip', '0.1', '0'], 'exclusive'),
        ([*LOADED, '--tip-std', '1e-4'], 'missing'),
        (['predict', '--pressure', '1', '--tip', '0.1', '0', '--tip-std', '-1'], 'out_of_bounds'),
        ([*LOADED, '--model', 'absent.yaml'], 'not_found'),
        (['replay', 'absent.mcap'], 'not_found'),
        (['replay', 'absent.mcap', '--topic', 'pressure'], 'wrong_form'),
        (['replay', 'absent.mcap', '--topic', 'tip=/tip'], 'wrong_form'),
        (['replay', 'absent.mcap', '--wrench-timeout', '0'], 'out_of_bounds'),
        (['replay', 'absent.mcap', '--frame-id', ''], 'empty'),
    ],
)
def test_a_wrong_request_is_one_sentence_on_stderr(run, arguments, reason):
    code, out, err = run(*arguments)
    assert (code, out) == (2, '')
    assert err.startswith(f'pneunet {arguments[0]}: ')
    assert refusal(run(*arguments, '--json')) == reason


@pytest.mark.parametrize('name', ['a' * 300 + '.mcap', '/', 'link.mcap', 'loop/out.mcap'])
def test_an_output_that_cannot_be_is_one_sentence(run, recording, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path('link.mcap').symlink_to('nowhere')
    Path('loop').symlink_to('loop')
    reason = 'loop' if name.startswith('loop') else 'unwritable'
    assert refusal(run('replay', recording, '--output', name, '--json')) == reason
    assert names(tmp_path) == ['link.mcap', 'loop']


def test_a_word_that_is_none_is_shown_and_does_nothing(run):
    code, _, err = run('predict', '--pressure', '1', '\x1b[2J\x1b]0;owned\x07' + 'a' * 10_000)
    assert code == 2
    assert '\x1b' not in err
    assert len(err) < 5000


def test_what_the_system_refuses_is_one_sentence(run, monkeypatch, tmp_path):
    def full(path):
        raise OSError(28, 'No space left on device', '/tmp/x')

    monkeypatch.setattr('pneunet_ros.cli.verb.load_model', full)
    assert refusal(run(*LOADED, '--json')) == 'system'
    monkeypatch.setattr('pneunet_ros.cli.verb.load_model', lambda path: bytearray(1 << 62))
    assert refusal(run(*LOADED, '--json')) == 'memory'


# predict


def test_predict_gives_all_numbers_of_the_contract(run_json):
    code, answer = run_json(*LOADED, '--moment', '2e-4')
    shape = solve(ARM, 31e3, (0.175, 0.07), 2e-4)
    assert code == 0
    assert set(answer) == PREDICTED
    assert (answer['converged'], answer['stable']) == (True, True)
    assert answer['residual'] < 1e-6
    assert (answer['pressure'], answer['force']) == (31e3, [0.175, 0.07])
    assert answer['moment_at_end'] == 2e-4
    for name in ('arclength', 'x', 'y', 'theta', 'curvature', 'intrinsic_curvature', 'moment'):
        np.testing.assert_allclose(answer[name], getattr(shape, name), rtol=1e-12, atol=1e-14)
    assert answer['tip'] == {name: answer[name][-1] for name in ('x', 'y', 'theta')}
    assert set(answer['tip_std']) == {'x', 'y', 'theta'}
    assert all(0.0 < std < 0.1 for std in answer['tip_std'].values())
    np.testing.assert_allclose(answer['jacobian'], tip_jacobian(ARM, shape), rtol=1e-6)


def test_predict_finds_the_force_from_the_tip_of_its_own_prediction(run_json):
    _, forward = run_json(*LOADED)
    tip = forward['tip']
    code, back = run_json('predict', '--pressure', '31e3', '--tip', tip['x'], tip['y'])
    assert code == 0
    assert set(back) == PREDICTED
    np.testing.assert_allclose(back['force'], [0.175, 0.07], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(back['theta'], forward['theta'], rtol=0.0, atol=1e-8)


def test_predict_from_the_tip_says_how_sure_the_force_is(run_json, run):
    arguments = ('predict', '--pressure', '31e3', '--tip', '0.0989', '0.0475')
    _, answer = run_json(*arguments)
    assert np.sqrt(np.diag(answer['force_covariance'])) == pytest.approx(answer['force_std'])
    _, surer = run_json(*arguments, '--tip-std', '1e-5')
    assert 0.0 < surer['force_std'][0] < answer['force_std'][0]
    assert surer['tip_std']['x'] == pytest.approx(1e-5, rel=0.05)
    _, out, _ = run(*arguments)
    assert f'{answer["force_std"][0]:.5f}' in out
    assert run_json(*LOADED)[1]['force_std'] is None


def test_dimensionless_is_said_and_divided_as_in_the_paper(run_json, run):
    (_, si), (_, scaled) = run_json(*LOADED), run_json(*LOADED, '--dimensionless')
    assert (si['units'], scaled['units']) == ('SI', 'dimensionless')
    length, weight = ARM.length, ARM.weight
    assert scaled['scales'] == {'length': length, 'force': weight}
    sizes = {
        'force': weight, 'arclength': length, 'x': length, 'y': length, 'theta': 1.0,
        'curvature': 1.0 / length, 'intrinsic_curvature': 1.0 / length,
        'moment': weight * length, 'pressure': 1.0,
    }  # fmt: skip
    for name, size in sizes.items():
        assert np.multiply(size, scaled[name]) == pytest.approx(np.array(si[name]), rel=1e-12)
    rows = np.array([length, length, 1.0])[:, None]
    causes = np.array([1.0, weight, weight, weight * length])
    assert rows * scaled['jacobian'] / causes == pytest.approx(np.array(si['jacobian']))
    assert scaled['tip_std']['x'] == pytest.approx(si['tip_std']['x'] / length)
    _, out, _ = run(*LOADED, '--dimensionless')
    assert ('112 mm' in out, '0.17 N' in out) == (True, True)
    assert ' mm' not in out.split('dimensionless')[0]


def test_predict_without_a_force_is_the_unloaded_arm(run_json):
    _, answer = run_json('predict', '--pressure', '31e3')
    assert answer['force'] == [0.0, 0.0]
    np.testing.assert_allclose(answer['curvature'], answer['intrinsic_curvature'], atol=1e-9)
    of_pressure = ARM.sensors.pressure_std * np.abs(answer['jacobian'])[:, 0]
    assert list(answer['tip_std'].values()) == pytest.approx(of_pressure, rel=1e-4)
    measured = [
        run_json('predict', '--pressure', '31e3', *words)[1]['tip_std']
        for words in (('--force', '0', '0'), ('--moment', '0'))
    ]
    assert measured[0] == measured[1] != answer['tip_std']


@pytest.mark.parametrize(
    'arguments',
    [
        ['--pressure', '90e3'],
        ['--pressure', '31e3', '--tip', '0.5', '0.5'],
        ['--pressure', '31e3', '--tip', '103', '39'],
        ['--pressure', '31e3', '--force', '0', '-5'],
        ['--pressure', '31e3', '--tip', '0.06', '-0.09'],
    ],
)
def test_a_predict_without_answer_exits_1_with_nulls(run_json, run, arguments):
    code, answer = run_json('predict', *arguments)
    assert code == 1
    assert set(answer) == PREDICTED
    assert answer['converged'] is False
    assert answer['tip'] == {'x': None, 'y': None, 'theta': None}
    assert set(answer['curvature']) == {None}
    assert answer['tip_std'] is answer['jacobian'] is None
    code, out, err = run('predict', *arguments)
    assert (code, err) == (1, '')
    assert answer['status'] in ' '.join(out.split())


@pytest.mark.parametrize(('pressure', 'asked'), [('31', True), ('310', False), ('0', False)])
def test_a_pressure_that_may_be_meant_in_kilopascals_is_asked_for(run, pressure, asked):
    code, out, _ = run('predict', '--pressure', pressure)
    assert code == 0
    assert (f'--pressure {pressure}kPa' in ' '.join(out.split())) == asked


def test_a_predict_beyond_the_loads_is_flagged_and_far_less_sure(run_json, run):
    _, inside = run_json(*LOADED)
    code, beyond = run_json('predict', '--pressure', '31e3', '--force', '-0.1', '0')
    assert (code, beyond['extrapolated'], inside['extrapolated']) == (0, True, False)
    assert (beyond['warnings'], inside['warnings']) == ([LOAD_BEYOND], [])
    assert beyond['tip_std']['y'] > 5.0 * inside['tip_std']['y']
    _, out, _ = run('predict', '--pressure', '31e3', '--force', '-0.1', '0')
    assert beyond['status'] in ' '.join(out.split())


def test_a_model_that_was_not_measured_says_so_beside_its_std(run_json, run, tmp_path):
    words = 'the standard deviations do not include the model error'
    assert words in run_json(*LOADED)[1]['std_leaves_out']
    assert words in ' '.join(run(*LOADED)[1].split())
    stiffness = [f'moment_law.rigidity.{row}.1' for row in range(6)]
    measured = replace(
        ARM,
        covariance=ModelCovariance(quantities=tuple(stiffness), factor=[[0.001]] * 6),
        sources={'moment_law': 'fitted to 6 recordings'},
    )
    save_model(measured, tmp_path / 'measured.yaml')
    model = ['--model', str(tmp_path / 'measured.yaml')]
    assert run_json(*LOADED, *model)[1]['std_leaves_out'] == ''
    assert words not in ' '.join(run(*LOADED, *model)[1].split())


@pytest.mark.parametrize('written', ['-0.00001', '-1e-5', '-1.0E-05', '-.00001', '-1.e-5'])
def test_negative_numbers_may_be_written_in_any_way(run_json, written):
    loads = ('--force', '-1e-2', written, '--moment', written)
    code, answer = run_json('predict', '--pressure', '-1e1', *loads)
    assert code == 0
    assert answer['pressure'] == -10.0
    assert answer['force'] == [-0.01, -0.00001]
    assert answer['moment_at_end'] == -0.00001


@dataclass(frozen=True, slots=True, kw_only=True)
class TurnedForce(Effect):
    """A force sensor that is mounted askew."""

    name: ClassVar[str] = 'turned_force'

    def sense(self, load):
        along, across = rotate(0.3, load.force_x, load.force_y)
        return replace(load, force_x=along, force_y=across, moment=load.moment + 1e-4)


def test_predict_is_as_sure_of_a_force_wrongly_sensed_as_of_the_true_one(monkeypatch):
    monkeypatch.setattr('pneunet_ros.model.arm.EFFECTS', {'turned_force': TurnedForce})
    askew = replace(ARM, effects=(TurnedForce(),))
    shape = solve(askew, 31e3, (0.175, 0.07))
    assert shape.force[0] < 0.15
    estimate = estimate_uncertainty(Estimator(arm=askew), shape, 31e3)
    true = estimate_uncertainty(Estimator(arm=ARM), shape, 31e3)
    assert estimate.shape.force == pytest.approx(shape.force)
    np.testing.assert_allclose(estimate.jacobian, true.jacobian, rtol=1e-9)
    np.testing.assert_allclose(estimate.tip_covariance, true.tip_covariance, rtol=1e-9)


def test_predict_for_people_has_values_with_std_and_unit(run):
    code, out, err = run(*LOADED)
    assert (code, err) == (0, '')
    for words in ('mm', 'deg', '0.17500', '31.000'):
        assert words in out


# replay


def test_replay_sums_up_and_writes_inputs_and_outputs(run_json, recording, tmp_path):
    output = tmp_path / 'out.mcap'
    code, summary = run_json('replay', recording, '--output', output)
    assert code == 0
    assert summary['pressure_readings'] == 30
    assert summary['estimates'] == 29
    assert summary['rejected'] == {'out_of_range': 1}
    assert summary['topics'] == {'pressure': PRESSURE, 'end_wrench': WRENCH}
    assert (summary['recording'], summary['output']) == (str(recording), str(output))
    assert summary['model'] == 'paper-arm'
    assert summary['worst_residual'] < 1e-6
    written = {topic.name: topic.count for topic in open_recording(output).topics}
    assert written == {PRESSURE: 30, WRENCH: 30, '/diagnostics': 1} | {
        f'/pneunet/{item.name}': 29 for item in OUTPUTS
    }
    assert names(tmp_path) == ['out.mcap']


def test_replay_without_output_writes_nothing(run, recording, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run('replay', recording)
    assert (code, err) == (0, '')
    assert '1 out_of_range' in out
    assert names(tmp_path) == []


@pytest.mark.parametrize('fuse', [[], ['--fuse']])
def test_a_recording_in_kilopascals_is_asked_for(run, run_json, recording, tmp_path, fuse):
    path = tmp_path / 'kilopascals.mcap'
    with write_recording(path) as writer:
        pressures, wrenches, targets = (
            writer.add(name, kind)
            for name, kind in (
                (PRESSURE, PRESSURE_TYPE),
                (WRENCH, WRENCH_TYPE),
                ('/pneunet/targets', POINTS_TYPE),
            )
        )
        for index in range(2, 31, 2):
            stamp = index * 10_000_000
            writer.write(wrenches, stamp, wrench(stamp))
            arm = load_model(share_path('config/paper_arm.yaml'))
            shape = solve(arm, 2000.0 * index, (0.175, 0.0))
            seen = [
                np.interp(arm.target_arclength, shape.arclength, part)
                for part in (shape.x, shape.y)
            ]
            shown = targets_message(stamp, *seen, 'pneunet_base', ROSBAGS_TYPES)
            writer.write(targets, stamp, shown)
            writer.write(pressures, stamp, pressure(stamp, 2.0 * index))
    code, summary = run_json('replay', path, *fuse)
    assert (code, summary['estimates']) == (1, 0)
    assert summary['verdicts']['pressure']['settings'] == {'pressure_unit': 'kPa'}
    assert '--pressure-unit' in run('replay', path, *fuse)[1]
    assert run_json('replay', path, *fuse, '--pressure-unit', 'kPa')[0] == 0
    assert run_json('replay', path, *fuse, '--no-judge-readings')[0] == 0
    assert not run_json('replay', recording)[1]['verdicts']['pressure']['doubted']


def test_replay_has_every_setting_as_an_option_with_its_default(run):
    out = run('replay', '--help')[1]
    text = ' '.join(out.split())
    for item in fields(EstimatorSettings):
        assert re.search(rf'^  --{item.name.replace("_", "-")}\b', out, re.MULTILINE), item.name
        unit = f' {item.metadata["unit"]}' if item.metadata.get('unit', '-') != '-' else ''
        assert f'{item.metadata["meaning"]} (default: {item.default}{unit})' in text, item.name


def test_options_of_replay_reach_the_estimator(run_json, recording, tmp_path):
    output, model = tmp_path / 'out.mcap', tmp_path / 'wide.yaml'
    save_model(replace(ARM, domain=WIDE), model)
    options = ['--model', model, '--stations', '9', '--frame-id', 'base', '--wrench-frame',
               'pneunet_base', '--wrench-sign', '-1', '--pressure-offset', '-5e3']  # fmt: skip
    code, _ = run_json('replay', recording, '--output', output, *options)
    assert code == 0
    message = next(iter(open_recording(output).messages(['/pneunet/centerline']))).message
    assert message.header.frame_id == 'base'
    expected = solve(ARM, 26_001.0, (-0.175, 0.0), stations=9)
    xs = [stamped.pose.position.x for stamped in message.poses]
    np.testing.assert_allclose(xs, expected.x, rtol=0.0, atol=1e-12)


def test_replay_of_an_unloaded_arm(run_json, recording):
    code, summary = run_json('replay', recording, '--no-wrench-required')
    assert (code, summary['topics']) == (0, {'pressure': PRESSURE})


def test_existing_outputs_are_refused_or_replaced(run, recording, tmp_path):
    output = tmp_path / 'table1.mcap'
    output.write_text('precious')
    arguments = ['replay', recording, '--output', output]
    assert refusal(run(*arguments, '--json')) == 'exists'
    assert output.read_text() == 'precious'
    assert names(tmp_path) == ['table1.mcap']
    assert run(*arguments, '--overwrite')[0] == 0
    assert open_recording(output).topics


# track


@pytest.fixture(scope='module')
def camera(tmp_path_factory):
    """Twelve frames, of which the first four rest, and one target that is hidden in the last."""
    path = tmp_path_factory.mktemp('camera') / 'in.mcap'
    return write_messages(path, film(pictures(hidden=11)))


def test_track_sums_up_what_stands_in_its_output(run_json, camera, tmp_path):
    output, table = tmp_path / 'out.mcap', tmp_path / 'areas.csv'
    code, summary = run_json('track', camera, '--output', output, '--table', table)
    assert code == 0
    assert (summary['source'], summary['kind']) == (str(camera), 'recording')
    assert (summary['output'], summary['table']) == (str(output), str(table))
    assert summary['topics'] == {
        'image_raw': '/pneunet/image_raw', 'camera_info': '/pneunet/camera_info'
    }  # fmt: skip
    assert (summary['frames'], summary['explained']) == (12, 8)
    assert (summary['reasons'], summary['resting']) == ({'resting': 4}, 4)
    assert (summary['seen'], summary['missing']) == (8 * 23 - 1, 1)
    assert summary['missing_per_target'] == [int(target == 11) for target in range(23)]
    assert summary['scale'] == pytest.approx(0.00026, rel=2e-3)
    assert 0.0 < summary['rest_bow'] < 1e-3
    written = open_recording(output)
    clouds = [
        np.frombuffer(item.message.data.tobytes(), TARGET_POINT)
        for item in written.messages(['/pneunet/targets'])
    ]
    seen = np.isfinite([cloud['x'] for cloud in clouds]).sum(axis=0)
    assert seen.tolist() == summary['seen_per_target']
    assert written.topic('/pneunet/measured_centerline').count == summary['curves'] == 8
    assert written.topic(PRESSURE).count == 12
    assert len(table.read_text().splitlines()) == 1 + summary['seen']
    assert names(tmp_path) == ['areas.csv', 'out.mcap']


def test_track_for_people(run, camera, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run('track', camera)
    assert (code, err) == (0, '')
    for words in ('8 of 12 (66.7 %)', '4 resting', '183 of 184', ' 11: 1 ', 'mm/px', 'frames/s',
                  'off the arm at the clamp'):  # fmt: skip
        assert words in out
    assert names(tmp_path) == []


def test_track_draws_a_picture(run, camera, tmp_path):
    assert run('track', camera, '--preview', tmp_path / 'preview.png')[0] == 0
    assert imread(tmp_path / 'preview.png').shape[1] > 1500
    assert names(tmp_path) == ['preview.png']


def test_track_without_one_explained_frame_exits_1(run_json, run, tmp_path):
    folder = write_folder(tmp_path / 'dark', 3 * [np.zeros((48, 64), np.uint8)])
    options = ['--camera-info', 'none', '--output', tmp_path / 'out.mcap',
               '--preview', tmp_path / 'p.png']  # fmt: skip
    code, summary = run_json('track', folder, *options)
    assert (code, summary['explained'], summary['reasons']) == (1, 0, {'no_areas': 3})
    assert summary['smoothing_rms'] is summary['scale'] is None
    assert open_recording(tmp_path / 'out.mcap').topic('/pneunet/targets').count == 3
    code, out, err = run('track', folder, '--camera-info', 'none')
    assert (code, err) == (1, '')
    assert '3 no_areas' in out


def test_track_goes_on_after_an_image_that_is_cut_off(run_json, tmp_path):
    shown = [*map(encoded, pictures())]
    shown[6] = shown[6][:2000]
    path = write_messages(tmp_path / 'in.mcap', film(shown))
    code, summary = run_json('track', path)
    assert (code, summary['frames'], summary['explained']) == (0, 12, 7)
    assert summary['reasons'] == {'resting': 4, 'unreadable': 1}


def test_track_reads_a_recording_that_is_cut_off_as_far_as_it_goes(run_json, tmp_path):
    path = write_messages(tmp_path / 'in.mcap', film(pictures()))
    path.write_bytes(path.read_bytes()[: 3 * path.stat().st_size // 4])
    code, summary = run_json('track', path)
    assert code == 0
    assert 5 <= summary['frames'] < 12
    assert any('ends' in sentence for sentence in summary['sentences'])


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['absent.mcap'], 'not_found'),
        (['empty'], 'no_images'),
        (['text.mcap'], 'wrong_kind'),
        (['text.mp4'], 'damaged'),
        (['folder'], 'no_camera_info'),
        (['folder', '--camera-info', 'text.mcap'], 'not_a_mapping'),
        (['folder', '--camera', 'absent.yaml'], 'not_found'),
        (['folder', '--camera', 'wrong.yaml'], 'unknown_key'),
        (['folder', '--camera', 'pose.yaml', '--camera-info', 'none'], 'no_camera_info'),
        (['folder', '--preview', 'p.gif'], 'wrong_suffix'),
        (['folder', '--with-images'], 'missing'),
        (
            ['folder', '--with-images', '--camera-info', 'none', '--output', 'x.mcap'],
            'other_source',
        ),
        (['folder', '--output', 'w5.txt'], 'wrong_suffix'),
        (['folder', '--estimates', 'e.mcap'], 'missing'),
        (['folder', '--estimates', 'e.mcap', '--preview', 'p.png'], 'missing'),
        (['folder', '--table', 'p.png', '--preview', 'p.png'], 'given_twice'),
        (['folder', '--camera-info', 'none', '--output', 'folder/out.mcap'], 'overwrites_input'),
        (['folder', '--camera-info', 'none', '--rate', '0'], 'out_of_bounds'),
        (['folder', '--topic', 'pressure=/p'], 'wrong_form'),
        (['in.mcap', '--overwrite', '--table', 'in.mcap'], 'overwrites_input'),
        (['in.mcap', '--rate', '30'], 'other_source'),
        (['in.mcap', '--topic', 'image_raw=/pneunet/pressure'], 'wrong_type'),
    ],
)
def test_what_track_cannot_do_is_one_sentence(
    run, camera, tmp_path, monkeypatch, arguments, reason
):
    monkeypatch.chdir(tmp_path)
    Path('empty').mkdir()
    Path('text.mcap').write_text('hello')
    Path('text.mp4').write_text('hello')
    Path('wrong.yaml').write_text('schema_version: 1\ngates: 0.4\n')
    Path('pose.yaml').write_text(
        'schema_version: 1\nplane: {method: pose, position: [0.0, 0.0, 0.5], '
        'quaternion: [1.0, 0.0, 0.0, 0.0]}\n'
    )
    write_folder(Path('folder'), [np.zeros((48, 64), np.uint8)])
    Path('in.mcap').symlink_to(camera)
    before, content = names(tmp_path), camera.read_bytes()
    said = run('track', *arguments, '--json')
    assert said[2].startswith('pneunet track: ')
    assert refusal(said) == reason
    assert names(tmp_path) == before
    assert names(tmp_path / 'folder') == ['frame0.png']
    assert camera.read_bytes() == content


@pytest.mark.parametrize('option', ['--output', '--table', '--preview'])
def test_existing_outputs_of_track_are_refused_or_replaced(run, camera, tmp_path, option):
    place = tmp_path / ('p.png' if option == '--preview' else 'x.mcap')
    place.write_text('precious')
    assert refusal(run('track', camera, option, place, '--json')) == 'exists'
    assert place.read_text() == 'precious'
    assert run('track', camera, option, place, '--overwrite')[0] == 0
    assert names(tmp_path) == [place.name]
    assert place.read_bytes() != b'precious'


DAY = share_path('bags/lab_day')
TWO = ('--unloaded', DAY / 'unloaded.mcap', '--loaded', DAY / 'loaded.mcap')
TRAIN = ('--train', DAY / 'unloaded.mcap', DAY / 'loaded.mcap', '--heldout', DAY / 'heldout.mcap')


@pytest.mark.parametrize(
    ('words', 'outputs', 'begun'),
    [
        (('replay', share_path('bags/table1')), {'--output': 'out.mcap'}, '.*/*/*.mcap'),
        (
            ('track', share_path('bags/camera_demo')),
            {'--output': 'out.mcap', '--table': 't.csv', '--preview': 'p.png'},
            '.*/*/*.mcap',
        ),
        (('calibrate', *TWO), {'--output': 'm.yaml', '--report': 'report'}, ''),
        (
            ('diagnose', '--model', share_path('config/paper_arm.yaml'), *TRAIN),
            {'--output': 'diagnosis'},
            '.pneunet-*',
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else '',
)
def test_an_interrupted_verb_leaves_nothing(
    words, outputs, begun, tmp_path, checkout, foreign_environment
):
    for attempt in range(5):  # it may be done before it hears of the signal
        folder = tmp_path / str(attempt)
        folder.mkdir()
        code, out, err = interrupted(words, outputs, begun, folder, checkout, foreign_environment)
        if code:
            break
    said = 'pneunet: interrupted; nothing was written\n'
    assert (code, out, err) == (130, '', said)
    assert names(folder) == []


def interrupted(words, outputs, begun, folder, checkout, environment):
    """Interrupt a verb once it has begun to write; return its exit code, stdout and stderr."""
    options = [word for name, file in outputs.items() for word in (name, folder / file)]
    process = subprocess.Popen(
        [sys.executable, '-m', 'pneunet_ros.cli', *map(str, [*words, *options])],
        env={**environment, 'PYTHONPATH': str(checkout)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 300.0
    if begun:
        while not list(folder.glob(begun)) and time.monotonic() < deadline:
            time.sleep(0.001)
        time.sleep(0.02)  # in the instant it is made, nobody yet owns the scratch folder
    else:
        time.sleep(4.0)  # it writes at its end alone
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


# effects


def test_effects_lists_the_table_of_the_code(run):
    code, out, err = run('effects')
    assert (code, err) == (0, '')
    for effect in EFFECTS.values():
        assert f'\n  {effect.name} ' in out
        assert all(f'\n      {item.name}' in out for item in quantities(effect))


def test_effects_fits_a_terminal_of_80_columns(run):
    _, out, _ = run('effects')
    assert max(map(len, out.splitlines())) <= 80
    assert '…' not in out  # no word cut off


def test_effects_as_json_has_units_and_bounds(run_json):
    code, answer = run_json('effects')
    assert code == 0
    assert [entry['name'] for entry in answer['effects']] == list(EFFECTS)
    for entry in answer['effects']:
        effect = EFFECTS[entry['name']]
        assert (entry['place'], entry['meaning']) == (effect.place, effect.meaning)
        assert [item['name'] for item in entry['parameters']] == [
            item.name for item in quantities(effect)
        ]
        for item in entry['parameters']:
            assert {'neutral', 'unit', 'bounds', 'prior', 'meaning', 'source'} <= set(item)
    gain = next(entry for entry in answer['effects'] if entry['name'] == 'pressure_gain')
    assert gain['parameters'][0]['neutral'] == 1.0


# demo


def test_the_demo_shows_the_15_holds_and_leaves_recording_and_picture(run, tmp_path):
    code, out, err = run('demo', '--output', tmp_path / 'here')
    assert (code, err) == (0, '')
    rows = re.findall(r'^│ +(\d+\.\d) │ +(\d\.\d{3}) │ +(\d\.\d{3}) │', out, re.MULTILINE)
    assert len(rows) == 15
    assert rows[5] == ('31.0', '0.175', '0.070')
    assert names(tmp_path / 'here') == ['shapes.png', 'table1.mcap']
    picture = imread(tmp_path / 'here' / 'shapes.png')
    assert picture.shape[0] > 600
    assert picture.shape[1] > 1500
    written = open_recording(tmp_path / 'here' / 'table1.mcap')
    assert written.topic('/pneunet/tip').count == written.topic(PRESSURE).count > 1000


def test_the_demo_as_json_replaces_what_is_there_where_it_is_asked_to(run, run_json, tmp_path):
    (tmp_path / 'table1.mcap').write_text('precious')
    assert refusal(run('demo', '--output', tmp_path, '--json')) == 'exists'
    assert (tmp_path / 'table1.mcap').read_text() == 'precious'
    assert names(tmp_path) == ['table1.mcap']
    code, answer = run_json('demo', '--output', tmp_path, '--overwrite')
    assert code == 0
    assert open_recording(tmp_path / 'table1.mcap').topics
    assert len(answer['holds']) == 15
    hold = answer['holds'][5]
    assert (hold['pressure'], hold['force_x'], hold['force_y']) == (31e3, 0.175, 0.07)
    expected = solve(ARM, 31e3, (0.175, 0.07))
    assert (hold['tip_x'], hold['tip_y'], hold['tip_theta']) == pytest.approx(expected.tip)
    assert answer['files'] == [str(tmp_path / 'table1.mcap'), str(tmp_path / 'shapes.png')]


def test_the_demo_with_a_bad_model_leaves_nothing(run, tmp_path):
    model = tmp_path / 'bad.yaml'
    model.write_text(MODEL.read_text().replace('length: 0.112', 'length: -0.112'))
    code, out, err = run('demo', '--model', model, '--output', tmp_path / 'here')
    assert (code, out) == (2, '')
    assert 'arm.length = -0.112' in err
    assert names(tmp_path) == ['bad.yaml']


def test_the_demo_without_one_estimate_says_so_and_its_picture_is_one(run_json, tmp_path):
    model = tmp_path / 'high.yaml'
    text = re.sub(r'\ndomain:\n( .*\n)+', '\n', MODEL.read_text())
    for row in re.findall(r'pressure: \[(.*?)\]', text):
        moved = ', '.join(str(float(value) + 5e5) for value in row.split(','))
        text = text.replace(f'pressure: [{row}]', f'pressure: [{moved}]')
    model.write_text(text)
    code, answer = run_json('demo', '--model', model, '--output', tmp_path / 'here')
    assert (code, answer['holds'], answer['estimates']) == (1, [], 0)
    assert imread(tmp_path / 'here' / 'shapes.png').shape[1] > 1500


@pytest.mark.parametrize(
    'arguments',
    [
        ('predict', '--pressure', '31 mm'),
        ('predict', '--pressure', 'nan'),
        ('predict', '--pressure', '1', '--moment', 'inf'),
        ('predict', '--pressure', '31e3', '--model', 'nowhere.yaml'),
        ('check', 'nowhere.mcap'),
        ('predict',),
        ('nonsense',),
    ],
)
def test_a_wrong_request_is_one_object_for_programs(run, arguments):
    """With --json exit code 2 prints the sentence of stderr as one JSON object on stdout."""
    code, out, err = run(*arguments, '--json')
    assert code == 2
    assert out.count('\n') == 1
    content = json.loads(out)
    assert list(content) == ['error', 'reason']
    assert content['reason']
    assert content['error'] in ' '.join(err.split())
    assert run(*arguments)[1] == ''

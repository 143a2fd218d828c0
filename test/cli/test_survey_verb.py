"""The verb `survey`: three arms, one of them damaged, and again."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
import hashlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from pneunet_ros import load_model, save_model
from pneunet_ros.cli import survey_arm
from pneunet_ros.cli.main import main
from pneunet_ros.cli.verb import SENSOR_SETTINGS
from pneunet_ros.cli.verbs import survey
from pneunet_ros.core.errors import ModelError
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.messages.readings import PRESSURE, TARGETS
from pneunet_ros.model.intrinsic_curvature import IntrinsicCurvature
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.offline.survey import read_fleet
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.reports import figure as report_figure
import pytest
from support.html_pages import Page
from support.refusals import refused
from support.small_diagnosis import without_figures

LENGTH, TOP = 0.1, 4e4  # m, Pa
SHARES = np.linspace(0.0, 1.0, 8)
NOISE = 3e-4  # m


def write_arm(folder: Path, turning: float, strain: float, seed: int) -> None:
    """Write an arm that bends along a circle and lengthens, seen by clamp and tip."""
    folder.mkdir(parents=True)
    frame = load_model(share_path('config/paper_arm.yaml'))
    arm = replace(
        frame,
        name=folder.name,
        length=LENGTH,
        target_arclength=np.array([0.0, LENGTH]),
        intrinsic_curvature=IntrinsicCurvature(
            pressure=[0.0, TOP], arclength=[0.0, 1.0], curvature=np.zeros((2, 2))
        ),
        sensors=SensorNoise(pressure_std=0.0, force_std=0.0, moment_std=0.0, target_std=NOISE),
        covariance=None,
        domain=None,
    )
    save_model(arm, folder / 'arm.yaml')
    bend = turning * SHARES + 1e-9
    chord = LENGTH * (1.0 + strain * SHARES) * np.sinc(bend / (2.0 * np.pi))
    tip = chord[:, None] * np.column_stack([np.cos(bend / 2.0), np.sin(bend / 2.0)])
    tip += np.random.default_rng(seed).normal(0.0, NOISE, tip.shape)
    for name, rows in (('unloaded', [0, 1, 3, 4, 6, 7]), ('heldout', [2, 5])):
        with write_recording(folder / f'{name}.mcap') as writer:
            topics = [writer.add(f'/{sensor.name}', sensor.type) for sensor in (PRESSURE, TARGETS)]
            for row in rows:
                stamp = (1 + row) * 10**10
                values = ([TOP * SHARES[row]], np.array([[0.0, tip[row, 0]], [0.0, tip[row, 1]]]))
                for topic, sensor, value in zip(topics, (PRESSURE, TARGETS), values, strict=True):
                    message = sensor.message(stamp, value, 'pneunet_base', ROSBAGS_TYPES)
                    writer.write(topic, stamp, message)


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run the verb in a folder of its own, in this process; returns exit code and JSON."""
    opened = []

    @contextmanager
    def here(workers, scheduler):
        opened.append((workers, scheduler))
        with ThreadPoolExecutor(1) as executor:
            yield executor

    monkeypatch.setattr(survey, 'open_executor', here)
    monkeypatch.setattr(report_figure, 'DOTS_PER_INCH', 20)
    without_figures(monkeypatch)
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        code = main(['survey', 'fleet', '--output', 'out', '--static', *arguments])
        out, err = capsys.readouterr()
        return code, json.loads(out) if '--json' in arguments else out, err, opened

    return run


def test_a_fleet_is_done_once_and_what_failed_says_why(run, tmp_path):
    write_arm(tmp_path / 'fleet/long', 1.0, 0.2, 1)
    write_arm(tmp_path / 'fleet/torn', 1.0, 0.0, 2)
    torn = tmp_path / 'fleet/torn/unloaded.mcap'
    whole = torn.read_bytes()
    torn.write_bytes(b'no mcap')
    code, content, _, opened = run('--json', '--workers', '2')
    assert code == 1  # one failed
    assert opened == [(2, None)]
    first, second = content['arms']
    assert first['answer'] == 'named'
    assert [item['name'] for item in first['effects']] == ['pressure_elongation']
    after, before = (first['gap']['heldout'][when]['rms_m'] for when in ('after', 'before'))
    assert after < 0.2 * before
    assert 'unloaded.mcap' in second['failed']
    assert content['kept'] == 0
    page = Path('out/survey.html').read_text()
    leading = [item for item in Page(page).references if not item.startswith(('#', 'data:'))]
    assert leading == ['arms/long/report.html']
    assert Path('out/arms/long/report.html').is_file()
    assert f'--model {tmp_path / "fleet/torn/arm.yaml"}</code>' in page
    assert load_model('out/arms/long/model.yaml').effects[0].name == 'pressure_elongation'
    diagnosis = json.loads(Path('out/arms/long/diagnosis.json').read_text())
    assert diagnosis['inputs'] == [  # as `diagnose` writes them
        {
            'file': f'{name}.mcap',
            'sha256': hashlib.sha256(Path(f'fleet/long/{name}.mcap').read_bytes()).hexdigest(),
            'role': role,
        }
        for name, role in (('unloaded', 'training'), ('heldout', 'heldout'))
    ]

    # The same command again does the arm that was mended meanwhile, and nothing else.
    torn.write_bytes(whole)
    code, content, _, _ = run('--json')
    assert (code, content['kept']) == (0, 1)
    content = json.loads(Path('out/survey.json').read_text())
    numbers = content['arms'][1]['numbers']
    assert numbers['turning']['value'] == pytest.approx(1.0, abs=0.05)
    assert content['effects'] == {'pressure_elongation': 1}
    assert '--model out/arms/long/model.yaml' in Path('out/survey.html').read_text()

    # What was done from other recordings is not replaced unasked.
    torn.write_bytes((tmp_path / 'fleet/long/unloaded.mcap').read_bytes())
    code, content, _, _ = run('--json')
    assert (code, content['reason']) == (2, 'other_inputs')


@pytest.mark.parametrize('judged', [True, False])
def test_the_readings_of_an_arm_are_judged_unless_declined(monkeypatch, tmp_path, judged):
    given = {}

    def stop(*_, **options):
        given['calibrate' if 'compare' in options else 'investigate'] = options
        if 'compare' not in options:
            raise ModelError('no more', reason='not_settled')
        return SimpleNamespace(joint=SimpleNamespace(converged=True))

    for name in ('calibrate', 'investigate', 'provenance_of', 'described_arm'):
        told = stop if name in ('calibrate', 'investigate') else lambda *_: None
        monkeypatch.setattr(survey_arm, name, told)
    sensors = {name: getattr(EstimatorSettings(), name) for name in SENSOR_SETTINGS}
    request = survey_arm.SurveyRequest(
        static=True, topic=(), sensors=sensors | {'judge_readings': judged}, seed=0
    )
    write_arm(tmp_path / 'one', 1.0, 0.0, 1)
    (arm,) = read_fleet(tmp_path, tmp_path)
    with refused(ModelError, 'not_settled'):
        survey_arm.SurveyWork(request=request)(arm)
    declared = None if not judged else EstimatorSettings().pressure
    assert given['calibrate']['declared'] == declared
    assert given['investigate']['settings'].declared == declared


def test_an_arm_is_not_tested_with_what_it_was_fitted_to(run, tmp_path):
    write_arm(tmp_path / 'fleet/one', 1.0, 0.0, 1)
    (tmp_path / 'fleet/one/heldout.mcap').write_bytes(
        (tmp_path / 'fleet/one/unloaded.mcap').read_bytes()
    )
    code, content, _, _ = run('--json')
    assert code == 1
    assert 'are the same recording' in content['arms'][0]['failed']


def test_where_the_work_goes_is_asked_once(run, tmp_path, capsys):
    write_arm(tmp_path / 'fleet/one', 1.0, 0.0, 1)
    with pytest.raises(SystemExit):
        run('--workers', '2', '--scheduler', 'tcp://127.0.0.1:1')
    assert 'not allowed with argument' in capsys.readouterr().err

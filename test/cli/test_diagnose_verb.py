"""The verb `diagnose`: what it hands on, what it writes and says, what it refuses."""

from __future__ import annotations

from dataclasses import replace
import hashlib
import html
import json
from pathlib import Path

from pneunet_ros import load_model
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.investigation import UnsettledInvestigation
from pneunet_ros.diagnosis.result import UnsettledDiagnosis
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.recordings.lab_files import write_lab
from pneunet_ros.reports.diagnosis.files import NUMBERS, PAGE
import pytest
from support.refusals import refusal
from support.small_diagnosis import diagnosis, discovery, without_figures

NAMES = ('unloaded_ramp', 'strings', 'random_mix')
ARM = share_path('config/paper_arm.yaml')


@pytest.fixture(scope='module')
def lab(tmp_path_factory) -> Path:
    """Return a folder with recordings of the lab, a frame a second."""
    folder = tmp_path_factory.mktemp('lab')
    for name in NAMES:
        scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
        scenario = replace(scenario, rates=replace(scenario.rates, frames=1.0))
        write_lab(
            simulate(scenario), folder / f'{name}.mcap', overwrite=False, on_progress=lambda: None
        )
    return folder


@pytest.fixture
def run(capsys, monkeypatch, lab, tmp_path):
    """Run the verb in a folder of its own; returns its exit code, stdout and stderr."""
    monkeypatch.setenv('COLUMNS', '200')
    monkeypatch.chdir(tmp_path)
    without_figures(monkeypatch)

    def run(*arguments):
        try:
            code = main(['diagnose', *(str(item) for item in arguments)])
        except SystemExit as stop:
            code = stop.code
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def found(monkeypatch):
    """Let the answer be one made by hand; returns what the verb hands on."""
    handed = {}

    def answered(frame, training, held_out, **options):
        handed.update(frame=frame, training=[*training], held_out=held_out, **options)
        options['on_progress']('looking', 1, 1)
        answer, known, _ = diagnosis()
        before, after = (
            replace(side, held_out=None, held_out_scores=())
            for side in (answer.before, answer.after)
        )
        answer = replace(answer, before=before, after=after, closed=None)
        answer = replace(answer, answer=handed.get('answer', 'named'), seed=options['seed'])
        # without fits there is no search for a law
        return UnsettledInvestigation(diagnosis=answer, recordings=(known, ()))

    monkeypatch.setattr('pneunet_ros.diagnosis.diagnosis.investigate', answered)
    return handed


def given(lab, *more) -> list:
    train = ['--train', lab / 'unloaded_ramp.mcap', lab / 'strings.mcap']
    return ['--model', ARM, *train, '--output', 'out', *more]


def test_what_is_handed_on_and_written(run, found, lab):
    held_out = ['--heldout', lab / 'random_mix.mcap', lab / 'random_mix.mcap']
    assert refusal(run(*given(lab, *held_out), '--json')) == 'given_twice'

    code, out, err = run(*given(lab, '--seed', '5', '--json'))
    assert (code, err) == (0, '')
    assert [run.loaded for run in found['training']] == [False, True]
    assert found['frame'].name == load_model(ARM).name
    assert found['seed'] == 5
    said = json.loads(out)
    written = json.loads(Path('out/diagnosis.json').read_text())
    assert written.items() <= said.items()
    assert (said['answer'], said['seed'], said['gap']['heldout']) == ('named', 5, None)
    for item in said['inputs']:
        content = (lab / item['file']).read_bytes()
        assert item['sha256'] == hashlib.sha256(content).hexdigest()
        assert item['role'] == 'training'
    assert set(said['versions']) >= {'pneunet_ros', 'numpy', 'scipy', 'python'}
    arm = load_model('out/model.yaml')
    assert [effect.name for effect in arm.effects] == ['extensibility']
    page = html.unescape(Path('out/report.html').read_text())
    assert all(sentence in page for sentence in (*said['left_out'], said['unloaded']))


@pytest.fixture
def without_report(monkeypatch):
    """Leave the files out, which take longest."""

    def written(found, folder, **_):
        folder.mkdir()
        (folder / 'report.html').write_text('page')
        return {'answer': found.answer}

    monkeypatch.setattr('pneunet_ros.reports.diagnosis.files.write_diagnosis', written)


def test_people_are_shown_the_answer_first(run, found, lab, without_report):
    code, out, err = run(*given(lab))
    assert (code, err) == (0, '')
    for text in (
        'no recording was held out', '15.00 ± 0.30 N', 'gravity', 'grows with force',
        'below 410 N', 'next recording: Record force sweeps', 'note: a note that says <what>',
        'wrote out/report.html', 'wrote out/model.yaml',
    ):  # fmt: skip
        assert text in out, text


@pytest.mark.parametrize(
    ('answer', 'code'),
    [('none', 0), ('named', 0), ('inseparable', 1), ('unknown', 1), ('unobservable', 1)],
)
def test_an_answer_that_is_not_clear_is_code_1(run, found, lab, without_report, answer, code):
    found['answer'] = answer
    assert run(*given(lab, '--json'))[0] == code


def test_a_recording_is_trained_on_or_held_out(run, found, lab):
    assert refusal(run(*given(lab, '--heldout', lab / 'strings.mcap'), '--json')) == 'given_twice'
    assert not found
    assert not list(Path().iterdir())


def test_nothing_is_overwritten_unasked(run, found, lab, without_report):
    assert run(*given(lab))[0] == 0
    found.clear()
    code, _, err = run(*given(lab))
    assert code == 2
    assert '--overwrite' in err
    assert not found
    assert run(*given(lab, '--overwrite'))[0] == 0
    Path('out/mine.txt').write_text('mine')
    code, _, err = run(*given(lab, '--overwrite'))
    assert code == 2
    assert 'mine.txt' in err


def test_the_output_may_not_hold_an_input(run, found, lab):
    words = ('--model', ARM, '--train', lab / 'strings.mcap', '--output', lab, '--json')
    assert refusal(run(*words)) == 'overwrites_input'


def test_nothing_is_left_of_a_diagnosis_that_fails(run, found, lab, monkeypatch):
    def refused(*_, **__):
        raise RequestError('no recording under load', reason='no_load')

    monkeypatch.setattr('pneunet_ros.diagnosis.diagnosis.investigate', refused)
    assert refusal(run(*given(lab), '--json')) == 'no_load'
    assert not list(Path().iterdir())


def test_help_says_what_the_codes_mean(run):
    code, out, _ = run('--help')
    assert code == 0
    assert 'unobservable' in out
    assert '--heldout' in out


def test_a_model_that_cannot_be_fitted_is_said_first_and_has_no_numbers(run, lab, monkeypatch):
    sentence = 'The model could not be fitted: nothing can be said.'
    unsettled = UnsettledDiagnosis(sentence=sentence, notes=('check the units',), seed=0)
    found = UnsettledInvestigation(diagnosis=unsettled)
    monkeypatch.setattr('pneunet_ros.diagnosis.diagnosis.investigate', lambda *_, **__: found)
    code, out, err = run(*given(lab))
    assert (code, err) == (1, '')
    assert out.startswith(sentence)
    assert unsettled.notes[0] in out
    assert 'chi2' not in out
    assert sorted(path.name for path in Path('out').iterdir()) == [NUMBERS, PAGE]
    page = Path('out', PAGE).read_text()
    assert sentence in page
    assert f' --model {ARM}</code>' in page
    code, out, _ = run(*given(lab, '--overwrite', '--json'))
    said = json.loads(out)
    assert code == 1
    assert (said['answer'], said['effects'], said['detectable']) == ('unknown', [], {})
    assert set(said['gap'].values()) == {None}
    assert [item['role'] for item in said['inputs']] == ['training', 'training']


@pytest.mark.slow
def test_a_discovered_law_is_said_and_its_effect_written(run, found, lab, monkeypatch):
    found['answer'] = 'unknown'
    law = replace(discovery(diagnosis()[0]), evaluation=diagnosis()[0].after)
    monkeypatch.setattr('pneunet_ros.discovery.discovery.discover', lambda *_, **__: law)
    code, out, _ = run(*given(lab, '--without', 'gravity'))
    assert code == 1  # a law is a proposal: the answer stays
    assert '<pushes>' in out
    assert Path('out/effects/proposed_push.py').exists()
    assert found['settings'].withheld == ('gravity',)
    # The folder of an earlier diagnosis is replaced with all that it holds, and nothing else.
    assert run(*given(lab, '--overwrite'))[0] == 1
    Path('out/effects/mine.py').write_text('')
    assert run(*given(lab, '--overwrite'))[0] == 2


def test_an_effect_that_there_is_not_cannot_be_withheld(run, lab):
    assert refusal(run(*given(lab, '--without', 'magic'), '--json')) == 'unknown_key'


def test_what_is_no_recording_is_said_before_any_is_read(run, lab, tmp_path, monkeypatch):
    """A file of many GB that is none took as long to read as one that is."""
    monkeypatch.setattr(
        'pneunet_ros.offline.calibration_files.file_hash', lambda path: pytest.fail('read')
    )
    large = tmp_path / 'large.mcap'
    with large.open('wb') as stream:
        stream.truncate(8_000_000_000)
    train = lab / 'strings.mcap'
    for other, reason in ((large, 'wrong_kind'), (tmp_path / 'missing.mcap', 'not_found')):
        said = run('--model', ARM, '--train', train, other, '--output', 'out', '--json')
        assert refusal(said) == reason

"""A diagnosis from recordings to answer: what is hidden is named, and nothing where it is not."""

from __future__ import annotations

from dataclasses import replace
import functools
from types import SimpleNamespace

import numpy as np
from pneunet_ros import load_model, save_model, solve
from pneunet_ros.calibration.noise_estimate import estimate_noise
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.share import share_path
from pneunet_ros.diagnosis.decision import effect_probabilities, is_equivalent_rival, notes_on_rest
from pneunet_ros.diagnosis.diagnosis import considered_hypotheses, is_settled
from pneunet_ros.diagnosis.fit import base_fit as base
from pneunet_ros.diagnosis.fit.hypothesis import hypotheses
from pneunet_ros.diagnosis.fit.refit import refit
from pneunet_ros.diagnosis.result import Diagnosis, UnsettledDiagnosis
from pneunet_ros.diagnosis.selection import Record, Selection
from pneunet_ros.diagnosis.settings import CONFIRMATION, LINEARIZATION
from pneunet_ros.diagnosis.verdict import describe_verdict, Verdict
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.load_offset import LoadOffset
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.measurement.dataset import RecordingData
import pytest
from support.lab_designs import design, fitted, frame, HELD_OUT, HIDDEN, recorded, TRAINING
from support.lab_run import run_of, true_model
from support.refusals import refused
from support.scaled import Size

STRUCTURE = ('placement_std', 'registration_std', 'drift_std')
SURE = 1.0 - CONFIRMATION.wrong
WHITE_SIZE = 1.6e-4  # m: rms that the true model has on these recordings


def found(hidden: str = '', day: int = 0, **options) -> Diagnosis:
    """Diagnose the recordings of a day."""
    runs, count = recorded(hidden, day), len(TRAINING)
    return diagnose(frame(), runs[:count], runs[count:], **{'seed': 3, **options})


def beside(name: str, offset: float) -> RecordingData:
    """Return a recording of a shipped scenario with its dots beside the neutral line (m)."""
    scenario = load_scenario(share_path(f'scenarios/{name}.yaml'))
    noise = replace(scenario.noise, row_offset=offset)
    return run_of(simulate(replace(scenario, noise=noise)))


@functools.cache
def clean() -> Diagnosis:
    """Return the diagnosis of recordings from which nothing is missing."""
    return found()


@functools.cache
def named() -> Diagnosis:
    """Return the diagnosis of recordings in which the load acts beside the centerline."""
    return found('load_offset')


def test_an_arm_eight_times_as_long_lacks_the_same_effect():
    """With the priors of the paper's arm its load was far outside of what is expected."""
    size = Size(length=8.0, force=64.0, pressure=0.25)
    ramp, _, _, sweeps, mix = (size.run(run) for run in recorded('load_offset'))
    answer = diagnose(size.arm(frame()), [sweeps, ramp], [mix], seed=3)
    assert answer.answer == 'named'
    (effect,) = answer.effects
    offset = effect.parameters['offset']
    assert offset.value / 8.0 == pytest.approx(HIDDEN['load_offset']['offset'], abs=3e-4)
    assert answer.detectable['load_offset'].expected == (-8.0 * 0.012, 8.0 * 0.012)


def test_few_recordings_of_dots_beside_the_neutral_line_show_that_nothing_is_missing():
    """The dots are on the side wall; what the model error is then, agrees with the answer."""
    strings, ramp, mix = (beside(name, 0.004) for name in ('strings', TRAINING[0], HELD_OUT))
    answer = diagnose(frame(), [strings, ramp], [mix], seed=3)
    assert answer.answer == 'none'
    assert abs(answer.before.rms - answer.noise_floor) < answer.noise_floor_std
    assert answer.before.training.rms < answer.noise_floor + answer.noise_floor_std
    assert (answer.effects, answer.alternatives, answer.closed) == ((), (), None)
    assert answer.adequacy_before.p_value > 0.01
    # Unloaded recordings come first, as the base is fitted.
    assert [item.name for item in answer.before.training_scores] == [ramp.name, strings.name]
    assert [item.name for item in answer.before.held_out_scores] == [mix.name]
    assert set(answer.detectable) == set(EFFECTS)


def test_a_camera_that_no_dot_at_the_clamp_shows_is_no_finding():
    dots = slice(2, None, 2)
    ramp, _, strings, _, mix = (
        replace(run, x=run.x[:, dots], y=run.y[:, dots]) for run in recorded()
    )
    given = frame()
    nothing = dict.fromkeys(STRUCTURE, 0.0)
    arm = replace(
        given,
        target_arclength=given.target_arclength[dots],
        sensors=replace(given.sensors, **nothing),
        covariance=None,
    )
    assert diagnose(arm, [strings, ramp], [mix], seed=3).answer == 'none'


@pytest.mark.slow
def test_a_picture_that_is_a_little_tilted_is_no_finding(monkeypatch):
    def askew(run):
        scale = 1.0 + 0.008 * (run.x / frame().length - 0.5)
        return replace(run, x=run.x * scale, y=run.y * scale)

    ramp, _, strings, _, mix = (askew(run) for run in recorded())
    answer = diagnose(frame(), [strings, ramp], [mix], seed=3)
    assert answer.answer == 'none'
    parallel = replace(LINEARIZATION, tilt=1e-9)
    monkeypatch.setattr('pneunet_ros.diagnosis.fit.linearization.LINEARIZATION', parallel)
    other = diagnose(frame(), [strings, ramp], [mix], seed=3)
    assert other.adequacy_before.p_value < 1e-3 * answer.adequacy_before.p_value


@pytest.mark.slow
def test_where_nothing_is_missing_nothing_is_named():
    answer = clean()
    assert answer.answer == 'none'
    assert (answer.effects, answer.alternatives, answer.closed) == ((), (), None)
    assert answer.adequacy_before == answer.adequacy_after
    assert answer.adequacy_before.p_value > 0.01
    assert answer.adequacy_before.statistic < answer.adequacy_before.threshold
    assert answer.after.arm.effects == ()
    assert answer.before.held_out is not None
    assert answer.before.held_out.chi_squared == pytest.approx(1.0, abs=0.15)
    assert answer.before.held_out.rms < 2.5e-4
    assert set(answer.detectable) == set(EFFECTS)
    for name, shown in answer.detectable.items():
        assert shown.observable == (name not in ('inertia', 'pressure_gain', 'pressure_offset'))


def test_a_diagnosis_needs_a_recording_without_a_load():
    loaded = [run for run in recorded() if run.loaded]
    with refused(RequestError, 'no_unloaded'):
        diagnose(frame(), loaded, [])


@pytest.mark.slow
def test_without_the_structure_of_noise_clean_data_raise_a_false_alarm(monkeypatch):
    assert clean().answer == 'none'  # made before the noise is changed, as it is kept

    # All errors white and independent, of the size they have together: METHODS says it is wrong.
    def white(runs, *rest):
        estimate = estimate_noise(runs, *rest)
        changes = dict.fromkeys(STRUCTURE, 0.0)
        changes |= {'pressure_std': 0.01, 'force_std': 1e-7, 'moment_std': 1e-9}
        noise = replace(estimate.noise, target_std=WHITE_SIZE, **changes)
        return replace(estimate, noise=noise)

    monkeypatch.setattr(base, 'estimate_noise', white)
    wrong = found()
    assert wrong.answer != 'none'
    assert wrong.adequacy_before.p_value < 1e-9


@pytest.mark.slow
def test_a_hidden_effect_is_named_with_its_size():
    answer = named()
    assert answer.answer == 'named'
    (effect,) = answer.effects
    assert effect.name == 'load_offset'
    assert effect.probability == pytest.approx(SURE)
    size = effect.parameters['offset']
    assert abs(size.value - HIDDEN['load_offset']['offset']) < 3.0 * size.std
    assert size.std < 0.1 * size.value
    assert size.unit == 'm'
    assert answer.alternatives == ()
    assert answer.adequacy_before.p_value < 1e-12
    assert answer.adequacy_after.p_value > 0.002
    first = answer.evidence[0]
    assert (first.effects, first.adequate) == (('load_offset',), True)
    assert first.chi_squared > 1000.0


@pytest.mark.slow
def test_the_gap_shrinks_to_that_of_clean_recordings():
    answer = named()
    assert answer.before.held_out is not None
    assert answer.after.held_out is not None
    assert clean().after.held_out is not None
    assert answer.before.held_out.rms > 3.0 * answer.after.held_out.rms
    assert answer.after.held_out.rms < 1.1 * clean().after.held_out.rms
    assert answer.closed is not None
    assert answer.closed > 0.95
    assert len(answer.before.training_scores) == len(TRAINING)


@pytest.mark.slow
def test_where_it_is_said_to_be():
    answer = named()
    last = [share for share in answer.where if share.axis == 'force'][-1]
    assert last.share > 0.4
    assert last.p_value < 1e-6
    shown = next(item for item in answer.heat_maps if item.axis == 'force')
    assert np.nanmax(shown.before) > 1.5 * np.nanmax(shown.after)


@pytest.mark.slow
def test_the_model_with_the_effect_is_saved_and_solved(tmp_path):
    save_model(named().after.arm, tmp_path / 'model.yaml')
    model = load_model(tmp_path / 'model.yaml')
    (effect,) = model.effects
    assert isinstance(effect, LoadOffset)
    assert effect.offset == pytest.approx(named().effects[0].parameters['offset'].value, rel=1e-5)
    assert model.covariance is not None
    assert 'effects.load_offset.offset' in model.covariance.quantities
    row = model.covariance.quantities.index('effects.load_offset.offset')
    std = float(np.linalg.norm(model.covariance.factor[row]))
    assert std == pytest.approx(named().effects[0].parameters['offset'].std, rel=0.8)
    scenario = load_scenario(share_path('scenarios/strings.yaml')).with_effects(
        {'load_offset': HIDDEN['load_offset']}
    )
    truth = true_model(scenario)
    apart = {'with': [], 'without': []}
    for pressure, force in ((20e3, (0.15, 0.05)), (45e3, (0.15, 0.1)), (55e3, (0.15, 0.2))):
        wanted = solve(truth, pressure, force)
        for key, arm in (('with', model), ('without', named().before.arm)):
            shape = solve(arm, pressure, force)
            apart[key].append(np.hypot(shape.x - wanted.x, shape.y - wanted.y).max())
    assert max(apart['with']) < 5e-4
    assert max(apart['without']) > 2.0 * max(apart['with'])


@pytest.mark.slow
def test_a_model_that_has_the_effect_lacks_nothing():
    runs = recorded('load_offset')
    count = len(TRAINING)
    known = replace(frame(), effects=(LoadOffset(**HIDDEN['load_offset']),))
    answer = diagnose(known, runs[:count], runs[count:], seed=3)
    assert answer.answer == 'none'
    assert answer.after.arm.effects == known.effects
    assert 'load_offset' not in answer.detectable


@pytest.mark.slow
def test_the_same_seed_says_the_same():
    again = found()
    assert again.seed == clean().seed == 3
    assert again.answer == clean().answer
    assert again.adequacy_before == clean().adequacy_before
    assert again.before.held_out == clean().before.held_out
    assert again.where == clean().where
    other = found(seed=4)
    assert other.answer == 'none'
    assert other.adequacy_before.threshold != clean().adequacy_before.threshold
    assert other.adequacy_before.threshold == pytest.approx(
        clean().adequacy_before.threshold, rel=0.1
    )


@pytest.mark.slow
def test_without_held_out_recordings():
    stages = []
    count = len(TRAINING)
    answer = diagnose(
        frame(), recorded()[:count], [], on_progress=lambda what, done, total: stages.append(what)
    )
    assert answer.answer == 'none'
    assert answer.before.held_out is None
    assert answer.before.held_out_scores == ()
    assert answer.noise_floor > 0.0
    assert {
        'the base model',
        'score tests on top of the base model',
        'evaluation before and after',
    } <= {stage.split(' ', 1)[1] for stage in stages}  # after the part, such as 2/5


def record(names: tuple[str, ...], evidence: float) -> Record:
    """Return a set of effects of this evidence."""
    return Record(
        names=names, dof=len(names), evidence=evidence, gain=2.0 * evidence, tests=(),
        adequate=True, plausible=True,
    )  # fmt: skip


def test_probabilities_are_those_of_what_evidence_tells_apart():
    lag = record(('pressure_lag',), 5364.0)
    # Nothing is surer than names were right in blind trials.
    assert effect_probabilities([lag]) == {'pressure_lag': SURE}
    assert effect_probabilities([lag], confirmed=False)['pressure_lag'] == 0.9
    # One per cent of the evidence does not tell two laws apart, half of it does.
    near = effect_probabilities([record(('pressure_lag',), 5364.0), record(('creep',), 5415.0)])
    assert 0.1 < near['pressure_lag'] < near['creep'] < 0.9
    far = effect_probabilities([record(('pressure_lag',), 5364.0), record(('creep',), 2700.0)])
    assert far['pressure_lag'] > 0.999 * SURE
    both = effect_probabilities([record(('gravity', 'creep'), 50.0), record(('creep',), 20.0)])
    assert both['creep'] == pytest.approx(SURE)
    assert both['gravity'] > 0.99 * SURE


def test_static_frames_and_too_few_of_them_show_no_effect_with_a_time_in_it():
    ramp = recorded()[0]
    memory = {'pressure_lag', 'hysteresis', 'creep', 'softening', 'camera_delay'}
    # Frames at rest show nothing of inertia: diagnosis.inertia.
    swallowed = {'pressure_gain', 'pressure_offset', 'inertia'}
    few, static = ramp.thin(19), replace(ramp, static=True)
    for runs, without in (
        ([ramp], swallowed),
        ([few, ramp.thin(20)], swallowed),
        ([few], swallowed | memory),
        ([static], swallowed | memory),
        ([static, ramp], swallowed),
    ):
        names = {item.name for item in considered_hypotheses(hypotheses(frame()), runs)}
        assert names == set(EFFECTS) - without


def test_sets_that_explain_as_much_are_said_as_sets():
    def verdict(*sets):
        record = SimpleNamespace(names=sets[0], evidence=34.0)
        trial = SimpleNamespace(names=sets[0], record=record)
        return Verdict(answer='inseparable', trial=trial, alike=sets[1:])

    before, after = (SimpleNamespace(rms=rms, held_out=rms) for rms in (3e-4, 1e-4))
    pair = verdict(('creep', 'force_misalignment'), ('creep', 'camera_rotation'))
    assert pair.alternatives == ('camera_rotation',)
    noise = (1e-4, 1e-5)
    assert describe_verdict(pair, before, after, noise).startswith(
        'The model lacks creep and force_misalignment, or creep and camera_rotation, which cannot '
    )
    single = verdict(('creep',), ('gravity',))
    said = describe_verdict(single, before, after, noise)
    assert said.startswith(
        'The model lacks creep or gravity, which cannot be distinguished with these data: '
    )
    assert said.endswith('from 0.300 to 0.100 mm rms.')
    # Where rms cannot show it, evidence says it.
    assert '34 nats' in describe_verdict(single, before, before, noise)


def test_a_name_that_is_not_confirmed_is_said_to_explain():
    same = SimpleNamespace(rms=1e-3, held_out=())
    trial = SimpleNamespace(names=())
    found = Verdict(answer='unknown', trial=trial, unconfirmed=('creep',), notes=('why',))
    assert describe_verdict(found, same, same, (1e-3, 1e-5)) == (
        'The model lacks an effect. creep would explain it, but is not confirmed; '
        'the notes say why.'
    )


def test_what_no_effect_explains_may_be_noise():
    same = SimpleNamespace(rms=1e-3, held_out=())
    found = Verdict(answer='unknown', trial=SimpleNamespace(names=()))
    said = describe_verdict(found, same, same, (1e-3, 1e-5))
    assert said.endswith(', or the noise is correlated from frame to frame (smoothed tracks).')


def test_what_is_too_faint_beside_a_strong_effect_is_said_without_a_name():
    best = SimpleNamespace(names=('hysteresis',), record=SimpleNamespace(gain=20000.0))
    faint = SimpleNamespace(name='camera_scale', gain=200.0)
    (note,) = notes_on_rest(SimpleNamespace(significant_candidate=lambda _: faint), best)
    assert (note.reason, note.split()[0], ' 200' in note) == ('too_faint', 'camera_scale', True)
    assert notes_on_rest(SimpleNamespace(significant_candidate=lambda _: None), best) == ()


def test_what_passes_alike():
    best = record(('creep',), 100.0)
    assert is_equivalent_rival(record(('gravity',), 98.0), best)
    assert not is_equivalent_rival(record(('gravity',), 90.0), best)
    # The same chi squared: the prior alone tells them apart.
    assert is_equivalent_rival(replace(record(('gravity',), 90.0), gain=best.gain - 5.0), best)
    assert not is_equivalent_rival(replace(record(('gravity', 'creep'), 99.0), gain=1e6), best)


def test_a_fit_that_stopped_before_its_end_has_not_settled(monkeypatch):
    assert is_settled(fitted())
    # No step lowers the cost, from round to round it stays what it is, and yet much is to gain.
    monkeypatch.setattr('pneunet_ros.diagnosis.fit.refit.MOST_HALVINGS', 0)
    stuck = refit(design('load_offset'), (), np.zeros(0), 2)
    assert stuck is not None
    assert stuck.settled
    assert not is_settled(stuck)


def test_a_base_that_does_not_settle_is_said_and_has_no_numbers(monkeypatch):
    monkeypatch.setattr('pneunet_ros.diagnosis.diagnosis.is_settled', lambda *_: False)
    monkeypatch.setattr(Selection, 'select_forward', lambda *_: pytest.fail('went on'))
    ramp, _, strings, *_ = recorded()
    answer = diagnose(frame(), [ramp.thin(24), strings.thin(24)], [], seed=3)
    assert isinstance(answer, UnsettledDiagnosis)
    assert answer.answer == 'unknown'
    assert not any(letter.isdigit() for letter in answer.sentence)


def test_a_pose_of_the_tip_that_was_measured_is_said_to_be_unused(monkeypatch):
    monkeypatch.setattr('pneunet_ros.diagnosis.diagnosis.is_settled', lambda *_: False)
    ramp, _, strings, *_ = recorded()
    runs = [ramp.thin(24), strings.thin(24)]
    posed = replace(runs[1], tip_pose=np.zeros((len(runs[1].stamp_ns), 3)))
    without, answer = (
        diagnose(frame(), training, [], seed=3) for training in (runs, [runs[0], posed])
    )
    assert answer.notes[:-1] == without.notes
    assert 'tip_pose' in answer.notes[-1]

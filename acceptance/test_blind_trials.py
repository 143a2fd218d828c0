"""The bench of blind trials: seals hold, rates are right, and a bench that was stopped goes on."""

from __future__ import annotations

import argparse
from concurrent.futures import Future
from contextlib import contextmanager
import dataclasses
import json
import pickle
from types import SimpleNamespace

from blind.baselines import pysindy, staged, stepwise
from blind.designs import DESIGNS, DURATION, RATED
from blind.hidden import HIDEABLE, NEWER, SIZES
from blind.record import Record
from blind.reference import driven
from blind.responses import Candidate, small_effects, Table
from blind.running import answered, truth_of
from blind.scoring import apart, confusion, detectable, rate, size_of, wilson
from blind.summary import baseline_rates, summary_of
from blind.trials import BLOCKS, DEVELOPMENT, labelled, made, SCORING
from blind.visibility import signals
import blind_trials
import numpy as np
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.effects import EFFECTS
from pneunet_ros.lab.sensors import regular_times
from pneunet_ros.lab.simulation import FRAME_OFFSET, simulate
import pytest


def truth(block, effects=None, outside=None, seed=1, rms=1e-4):
    return {
        'key': f'{block}/{seed}',
        'block': block,
        'effects': effects or {},
        'outside': (outside or {}) | {'harmless_mismatch': {'size': 0.003}},
        'rms': rms,
    }


def answer(said, names=(), alternatives=(), chi_squared=100.0, of=None, **more):
    sizes = more.pop('sizes', {})
    return {
        'answer': said,
        'effects': [{'name': name, 'parameters': sizes.get(name, {})} for name in names],
        'alternatives': list(alternatives),
        'evidence': [{'effects': [of], 'chi_squared': chi_squared}] if of else [],
        'detectable': {},
        'held_out_before': 3e-4,
        'held_out_after': 1.02e-4,
        'seconds': 1.0,
        'failed': '',
    } | more


ROTATED = {'camera_rotation': {'angle': 0.02}}


@pytest.mark.parametrize(
    ('count', 'of', 'low', 'high'),
    # Wilson's formula, worked out by hand for z = 1.96; R: binom.wilson.
    [(0, 10, 0.0, 0.27754), (1, 10, 0.01788, 0.40415), (95, 100, 0.88825, 0.97846), (0, 0, 0, 1)],
)
def test_wilson(count, of, low, high):
    assert wilson(count, of) == pytest.approx((low, high), abs=2e-5)
    assert wilson(of - count, of) == pytest.approx((1.0 - high, 1.0 - low), abs=2e-5)


def test_a_rate_counts():
    found = rate(value > 1 for value in (1, 2, 3, 4))
    assert (found['count'], found['of'], found['share']) == (3, 4, 0.75)
    assert rate([])['share'] is None


def test_who_was_taken_for_whom():
    pairs = [
        (truth('single', ROTATED), answer('named', ['camera_rotation'])),
        (truth('single', ROTATED), answer('named', ['gravity'])),
        (truth('single', ROTATED), answer('inseparable', ['gravity'], ['camera_rotation'])),
        (truth('single', ROTATED), answer('inseparable', ['gravity'], ['creep'])),
        (truth('nothing'), answer('none')),
        (truth('outside', {}, {'touching_peg': {}}), answer('unknown')),
    ]
    assert confusion(pairs) == {
        'camera_rotation': {
            'camera_rotation': 1,
            'gravity': 1,
            'inseparable, with it': 1,
            'inseparable, without it': 1,
        },
        'nothing': {'none': 1},
        'touching_peg': {'unknown': 1},
    }


def test_one_effect_is_scored_by_its_first_name_by_the_set_and_by_its_size():
    right = {'camera_rotation': {'angle': {'value': 0.021, 'std': 0.001, 'unit': 'rad'}}}
    known = {'of': 'camera_rotation'}
    pairs = [
        (truth('single', ROTATED), answer('named', ['camera_rotation'], sizes=right, **known)),
        (
            truth('single', ROTATED),
            answer('inseparable', ['gravity'], ['camera_rotation'], **known),
        ),
        (truth('single', ROTATED), answer('named', ['camera_rotation', 'creep'], **known)),
        (truth('single', ROTATED), answer('none', **known)),
        (truth('single', ROTATED), answer('none', of='camera_rotation', chi_squared=24.9)),
    ]
    found = summary_of(pairs)['single']
    counts = {
        key: (found[key]['count'], found[key]['of'])
        for key in ('first_right', 'first_or_alike', 'wrong', 'within', 'size_covered')
    }
    assert counts == {
        'first_right': (2, 4),
        'first_or_alike': (2, 4),
        'wrong': (1, 5),
        'within': (3, 4),
        'size_covered': (1, 1),
    }
    assert found['size_error'] == pytest.approx(0.05)
    assert found['faint_none']['count'] == 1
    assert found['by_effect']['camera_rotation']['first_right']['of'] == 4


def test_inertia_is_no_false_name_where_the_arm_has_mass():
    both = answer('named', ['camera_rotation', 'inertia'], of='camera_rotation')
    found = summary_of([(truth('moving_single', ROTATED), both)])['moving_single']
    assert (found['alone']['count'], found['wrong']['count']) == (1, 0)
    said = {'inertia': {'observable': True}}
    pairs = [(truth('moving_nothing', {}), answer('named', ['inertia'], detectable=said))]
    name = summary_of(pairs)['moving_nothing']['any_name']
    assert (name['count'], name['of']) == (0, 1)


def test_the_other_blocks():
    both = {'gravity': {'weight_y': 1.0}, 'hysteresis': {'width': 900.0}}
    names = ['gravity', 'hysteresis']
    seen = [{'effects': [name], 'chi_squared': 99.0} for name in names]
    little = {'parameter': 'axial_stiffness', 'observable': False, 'smallest': 9.0, 'unit': 'N'}
    small = {'extensibility': {'axial_stiffness': 40.0}}
    settled = {'detectable': {'extensibility': little}}
    found = summary_of(
        [
            (truth('nothing'), answer('none', **settled)),
            (truth('nothing'), answer('named', ['creep'], **settled)),
            (truth('nothing'), answer('failed', failed='refused')),
            (truth('pairs', both), answer('named', names[::-1], evidence=seen)),
            (truth('pairs', both), answer('named', ['gravity'], evidence=seen)),
            (truth('confusable', both), answer('named', names)),
            (truth('outside', {}, {'touching_peg': {}}), answer('unknown', **settled)),
            (truth('outside', {}, {'touching_peg': {}}), answer('named', ['gravity'], **settled)),
            (
                truth('unobservable', small),
                answer('none', detectable={'extensibility': little | {'observable': True}}),
            ),
            (truth('unobservable', small), answer('unobservable')),
            (
                truth('unobservable', small),
                answer(
                    'none',
                    detectable={'extensibility': little | {'smallest': 400.0, 'observable': True}},
                ),
            ),
        ]
    )
    assert found['nothing']['any_name']['share'] == 0.5  # of those that came to an end
    assert (found['nothing']['none']['count'], found['nothing']['none']['of']) == (1, 3)
    assert found['pairs']['both_right']['share'] == 0.5
    assert found['confusable']['right']['share'] == 1.0
    assert found['outside']['unknown']['share'] == found['outside']['false_name']['share'] == 0.5
    assert found['unobservable']['says_so']['count'] == 2  # the third says 400 N would show
    assert found['gap']['trials'] == 2
    assert found['gap']['ratio'] == pytest.approx(1.02)
    assert found['gap']['closed'] == pytest.approx((9.0 - 1.0404) / 8.0)


def test_an_effect_without_evidence_is_detectable_where_it_is_large_enough():
    hidden = truth('single', {'camera_scale': {'factor': 0.99}})
    said = {'observable': True, 'smallest': 0.02}
    assert not detectable(
        hidden, answer('none', detectable={'camera_scale': said}), 'camera_scale'
    )
    said['smallest'] = 0.005
    assert detectable(hidden, answer('none', detectable={'camera_scale': said}), 'camera_scale')


def test_a_diagnosis_that_does_not_settle_misses_an_effect_that_counts():
    pairs = [
        (truth('single', ROTATED), answer('named', ['camera_rotation'], of='camera_rotation')),
        (truth('single', ROTATED), answer('failed', failed='refused')),
        (truth('single', ROTATED), answer('unknown')),
    ]
    found = summary_of(pairs)
    assert (found['single']['alone']['count'], found['single']['alone']['of']) == (1, 3)
    assert found['single']['faint_wrong']['of'] == 0


def test_what_shows_is_not_for_the_diagnosis_to_say():
    creep = {'creep': {'amplitude': 0.1}}
    blind = answer('none', detectable={'creep': {'observable': False, 'smallest': None}})
    stuck = answer('none', of='creep', chi_squared=3.0)
    lost = answer('named', ['gravity'], of='creep', chi_squared=3.0)
    for signal, count in ((5000.0, 3), (24.0, 0)):
        hidden = truth('rated_single', creep) | {'shown_apart': {'signal': signal}}
        found = summary_of([(hidden, said) for said in (blind, stuck, lost)])['rated_single']
        assert (found['alone']['count'], found['alone']['of']) == (0, count)
        assert (found['wrong']['count'], found['wrong']['of']) == (1, 3)


def test_of_several_effects_each_must_show_beside_the_others():
    both = {'gravity': {'weight_y': 0.1}, 'camera_rotation': {'angle': 0.002}}
    hidden = truth('pairs', both) | {'shown_beside': {'gravity': 900.0, 'camera_rotation': 4.0}}
    # Alone it would take up much of what gravity does.
    said = answer('named', ['gravity'], of='camera_rotation', chi_squared=400.0)
    assert detectable(hidden, said, 'gravity')
    assert not detectable(hidden, said, 'camera_rotation')


def test_what_another_effect_explains_is_not_visible_apart_from_it():
    said = answer('inseparable', ['contact'], ['gravity'], of='gravity', chi_squared=60.0)
    hidden = truth('rated_single', {'gravity': {'weight_y': 0.1}})
    for left, visible in ((26.0, True), (24.0, False)):
        shown = {'signal': 60.0, 'contact': left, 'creep': 59.0}
        assert apart(hidden | {'shown_apart': shown}, said, 'gravity') is visible
    assert apart(hidden, said, 'gravity')
    # What the diagnosis does not see at all is counted by neither.
    faint = answer('none', of='gravity', chi_squared=4.0)
    assert not apart(hidden | {'shown_apart': {'contact': 26.0}}, faint, 'gravity')
    found = summary_of(
        [
            (hidden | {'shown_apart': {'contact': 24.0}}, said),
            (hidden | {'shown_apart': {'contact': 26.0}}, said),
            (hidden, answer('named', ['gravity'], of='gravity')),
        ]
    )['rated_single']
    keys = 'alone', 'alone_apart', 'honest'
    counts = [(found[key]['count'], found[key]['of']) for key in keys]
    assert counts == [(1, 3), (1, 2), (3, 3)]


def test_the_error_of_a_size_counts_from_what_is_neutral():
    sizes = {'camera_scale': {'factor': {'value': 1.011, 'std': 0.0002}}}
    found = size_of(
        truth('single', {'camera_scale': {'factor': 1.01}}),
        answer('named', ['camera_scale'], sizes=sizes),
        'camera_scale',
    )
    assert found == (False, pytest.approx(0.1))


def test_labels_go_through_all_effects_and_sizes():
    random = np.random.default_rng(0)
    labels = [labelled('single', SCORING + k, random) for k in range(SIZES * len(HIDEABLE))]
    names = [next(iter(label.effects)) for label in labels]
    left_out = {'pressure_gain', 'pressure_offset', *NEWER, 'inertia'}  # that MuJoCo moves
    assert sorted(set(names)) == sorted(set(EFFECTS) - left_out)
    kind = HIDEABLE[names[0]]
    sizes = [kind.strength(label.effects[names[0]][kind.parameter]) for label in labels[:SIZES]]
    assert sizes == pytest.approx(np.geomspace(kind.weakest, kind.strongest, SIZES))
    assert all('harmless_mismatch' in label.outside for label in labels)
    with pytest.raises(RequestError, match='no block is called some'):
        labelled('some', 1, random)


def test_an_arm_with_mass_hides_what_mujoco_can_do():
    random = np.random.default_rng(0)
    places = range(4 * len(HIDEABLE))
    labels = [labelled('moving_single', SCORING + place, random) for place in places]
    names = {next(iter(label.effects)) for label in labels}
    assert names == set(HIDEABLE) - {'extensibility', 'pressure_elongation'}
    for label in labels:
        for name in {'clamp_compliance', 'stiffening'} & set(label.effects):
            assert label.effects[name]['richness'] == 0.0
    others = [labelled('moving_outside', SCORING + place, random) for place in range(8)]
    assert not any('touching_peg' in label.outside for label in others)


@pytest.fixture(scope='module')
def hidden_trial():
    return made('single', DEVELOPMENT + SIZES * 8 + 5)


def test_a_trial_tells_nothing_of_its_label(hidden_trial):
    sealed, trial = hidden_trial
    (name,) = sealed.label.effects
    assert name == 'gravity'
    assert {item.name for item in dataclasses.fields(trial)} == {
        'key', 'frame', 'training', 'held_out',
    }  # fmt: skip
    # Every arm has a field of that name; it says nothing of the effect.
    assert trial.frame.gravity == type(trial.frame.gravity)()
    frame = repr(dataclasses.replace(trial.frame, effects=())).replace('gravity=', '')
    shown = pickle.dumps((trial.key, trial.training, trial.held_out)) + frame.encode()
    assert name.encode() in pickle.dumps(sealed.label)
    assert name.encode() not in shown
    assert str(sealed.label.arm_seed).encode() not in shown
    assert trial.frame.effects == ()
    runs = (*trial.training, *trial.held_out)
    assert [run.name for run in runs] == [f'recording_{place}' for place in range(1, 9)]
    assert [run.loaded for run in runs] == [True, False, False, True, True, True, True, True]
    ends = [int(run.reading_stamp_ns[-1]) for run in runs]
    assert all(run.reading_stamp_ns[0] > end for run, end in zip(runs[1:], ends, strict=False))


def test_the_diagnosis_is_given_recordings_alone(hidden_trial):
    sealed, trial = hidden_trial
    given = []

    def diagnose(*arguments, **options):
        given.append((arguments, options))
        raise RecordingError('cannot say')

    row, found = answered(trial, diagnose)
    assert found is None
    assert given == [((trial.frame, trial.training, trial.held_out), {})]
    assert (row['answer'], row['failed']) == ('failed', 'cannot say')
    assert 'gravity' not in json.dumps(row)
    told = truth_of(sealed, trial)
    assert list(told['effects']) == ['gravity']
    # Sensors' noise, placement and drift; what the plain law does not say comes on top.
    assert 8e-5 < told['rms'] < 3e-4
    assert 1.2 * told['rms'] < told['plain_rms'] < 1e-3


def test_the_truth_driven_by_readings_is_the_truth_but_for_their_noise(hidden_trial):
    recording, before = hidden_trial[0].recordings[6], hidden_trial[0].recordings[5].memory
    points, placement = driven(recording, before), recording.truth.placement
    truth = np.stack([recording.truth.target_x, recording.truth.target_y], axis=1)
    off = np.sqrt(np.mean((points - truth) ** 2))
    assert off < 2e-4  # placement, and noise of 60 Pa and 1 mN
    assert off > 0.5 * np.sqrt(np.mean(placement**2))


def test_the_signal_of_an_effect_is_what_the_lab_shows_less_what_it_shows_without(hidden_trial):
    recording = hidden_trial[0].recordings[0]
    ((same, signal),) = signals([recording], 'gravity')
    assert same is recording
    effects = tuple(item for item in recording.scenario.effects if item.name != 'gravity')
    with_it = recording.truth
    without = simulate(dataclasses.replace(recording.scenario, effects=effects)).truth
    moved = [with_it.target_x - without.target_x, with_it.target_y - without.target_y]
    assert np.allclose(signal, np.stack(moved, axis=-1), atol=1e-12)
    assert np.abs(signal).max() > 1e-4


def test_an_effect_on_readings_or_stamps_moves_what_a_model_expects():
    names = list(HIDEABLE)
    recordings = {
        name: made('rated_single', SCORING + names.index(name))[0].recordings[:2]
        for name in ('force_misalignment', 'camera_delay')
    }
    loaded, free = signals(recordings['force_misalignment'], 'force_misalignment')
    assert np.abs(loaded[1]).max() > 1e-4
    assert np.abs(free[1]).max() < 1e-12  # nothing pulls
    recording, late = signals(recordings['camera_delay'], 'camera_delay')[0]
    (delay,) = (e for e in recording.scenario.effects if e.name == 'camera_delay')
    # A model expects the arm where it is at the stamp, which is later.
    truth, scenario = recording.truth, recording.scenario
    rates = dataclasses.replace(scenario.rates, frames=200.0)
    dense = simulate(dataclasses.replace(scenario, rates=rates)).truth
    stamped = truth.time + delay.frame_delay(truth.time / scenario.protocol.duration)
    expected = np.interp(stamped, dense.time, dense.target_x[:, -1])
    moved = truth.target_x[:, -1] - expected
    assert np.abs(moved).max() > 3e-4
    assert np.allclose(late[:, -1, 0], moved, atol=0.05 * np.abs(moved).max())


def test_the_same_seed_is_the_same_trial_and_blocks_differ(hidden_trial):
    label = hidden_trial[0].label
    again, _ = made('single', label.seed)
    assert again.label == label
    assert np.array_equal(again.recordings[7].x, hidden_trial[0].recordings[7].x, equal_nan=True)
    assert made('nothing', label.seed)[0].label.arm_seed != label.arm_seed


def test_a_trial_of_few_dots_is_that_trial_without_the_others(hidden_trial):
    (whole, every), dots = hidden_trial, [4, 13, 22]
    sealed, trial = made('single', whole.label.seed, dots)
    assert trial.key == f'{whole.label.key}/4-13-22'
    assert dataclasses.replace(sealed.label, dots=()) == whole.label
    assert np.array_equal(trial.frame.target_arclength, every.frame.target_arclength[dots])
    assert np.array_equal(trial.frame.target_arclength, sealed.arm.target_arclength)
    seen = np.isin(every.training[0].stamp_ns, trial.training[0].stamp_ns)
    left = every.training[0].x[seen][:, dots]
    assert np.array_equal(trial.training[0].x, left, equal_nan=True)
    # What the lab says of the truth is of those dots, too.
    assert 8e-5 < truth_of(sealed, trial)['rms'] < 3e-4
    assert signals(sealed.recordings[:1], 'gravity')[0][1].shape[1] == len(dots)


def test_free_recordings_have_no_load():
    protocols = (*DESIGNS['free'].training, *DESIGNS['free'].held_out)
    assert not any(protocol.timeline().loaded for protocol in protocols)


@pytest.mark.parametrize('name', sorted(RATED))
def test_rated_designs_last_as_long_as_others_and_frames_are_triggered_by_readings(name):
    design = RATED[name]
    timelines = [item.timeline() for item in (*design.training, *design.held_out)]
    assert [item.duration for item in timelines] == pytest.approx([DURATION] * 8)
    loaded = [item.loaded for item in timelines]
    assert loaded[0]  # the first ramp of all is under a load
    assert not all(loaded)
    assert all(item.pressure.max() < 66e3 and item.pressure.min() >= 0.0 for item in timelines)
    assert name.endswith(f'_{design.rates.pressure:g}')
    frames = regular_times(design.rates.frames, DURATION, FRAME_OFFSET)
    assert len(frames) >= 40
    readings = regular_times(design.rates.pressure, DURATION)
    assert np.abs(frames[:, None] - readings).min(axis=1) == pytest.approx(0.0, abs=1e-9)


def test_every_effect_meets_every_rated_design():
    random = np.random.default_rng(0)
    labels = [labelled('rated_single', SCORING + k, random) for k in range(12 * len(HIDEABLE))]
    met = {(label.design, *label.effects) for label in labels}
    assert met == {(design, name) for design in RATED for name in HIDEABLE}
    assert labels[0].key == f'rated_single/{SCORING}'
    assert labelled('rated_nothing', 2, random).effects == {}
    assert len(labelled('rated_pairs', 2, random).effects) == 2


def test_a_false_companion_is_no_right_name_alone():
    hidden = truth('rated_single', ROTATED)
    known = {'of': 'camera_rotation'}
    found = summary_of(
        [
            (hidden, answer('named', ['camera_rotation'], **known)),
            (hidden, answer('named', ['camera_rotation', 'creep'], **known)),
            (hidden, answer('named', ['gravity'], **known)),
            (truth('rated_nothing'), answer('none')),
        ]
    )
    single = found['rated_single']
    counts = [single[name]['count'] for name in ('alone', 'companion', 'wrong')]
    assert counts == [1, 1, 2]
    assert found['rated_nothing']['any_name']['count'] == 0


def test_a_record_goes_on_where_it_was(tmp_path):
    record = Record(tmp_path / 'trials.jsonl')
    record.add({'key': 'nothing/1', 'answer': 'none'}, {'key': 'nothing/1', 'effects': {}})
    assert 'effects' not in record.answers.read_text()
    with record.sealed.open('a') as file:
        file.write('{"key": "nothing/2", "effects": {}}\n')
    with record.answers.open('a') as file:
        file.write('{"key": "nothing/2", "ans')
    again = Record(record.answers)
    assert again.done() == {'nothing/1'}
    again.add({'key': 'nothing/2', 'answer': 'unknown'}, {'key': 'nothing/2', 'effects': {}})
    assert [row['answer'] for _, row in again.opened()] == ['none', 'unknown']
    record.answers.write_text('nonsense\n')
    with pytest.raises(RecordingError, match=r'trials\.jsonl is no file of this bench'):
        again.done()


def asked(**changes):
    given = {
        'block': ['nothing', 'pairs'],
        'trials': 2,
        'first': 0,
        'development': True,
        'workers': 1,
        'scheduler': None,
        'baselines': False,
        'dots': [],
        'json': True,
    }
    return argparse.Namespace(**(given | changes))


def test_only_what_is_not_done_is_done(tmp_path, monkeypatch):
    done = []

    def one_trial(block, seed, baselines, dots):
        done.append((block, seed))
        if seed == 2 and len(done) < 5:
            raise ValueError('lost')
        return {'key': f'{block}/{seed}'}, {'key': f'{block}/{seed}'}

    @contextmanager
    def here(workers, scheduler):
        def submit(function, *arguments):
            future = Future()
            try:
                future.set_result(function(*arguments))
            except ValueError as error:
                future.set_exception(error)
            return future

        yield SimpleNamespace(submit=submit)

    monkeypatch.setattr(blind_trials, 'one_trial', one_trial)
    monkeypatch.setattr(blind_trials, 'open_executor', here)
    blind_trials.run(asked(trials=1), Record(tmp_path / 'a.jsonl'))
    broken = blind_trials.run(asked(), Record(tmp_path / 'a.jsonl'))
    assert done == [('nothing', 1), ('pairs', 1), ('nothing', 2), ('pairs', 2)]
    assert sorted(broken) == [f"{name}/2 broke off: ValueError('lost')" for name in asked().block]
    assert blind_trials.run(asked(), Record(tmp_path / 'a.jsonl')) == []
    assert done[4:] == [('nothing', 2), ('pairs', 2)]
    assert blind_trials.run(asked(), Record(tmp_path / 'a.jsonl')) == []
    assert len(done) == 6


def test_seeds_of_development_and_of_scoring_never_meet():
    scored = blind_trials.wanted(asked(block=['all'], trials=None, development=False))
    assert len(scored) == sum(BLOCKS.values())
    assert min(seed for _, seed in scored) == SCORING
    developed = blind_trials.wanted(asked(block=['all'], trials=None))
    assert not set(developed) & set(scored)
    with pytest.raises(SystemExit, match='seeds of development end'):
        blind_trials.wanted(asked(first=SCORING))


def made_table(field, noise=1e-5):
    random = np.random.default_rng(4)
    mask = np.ones((40, 2, 5), dtype=bool)
    frame = np.nonzero(mask)[0]
    causes = np.column_stack([frame / 40.0, *random.normal(size=(3, 400)), np.zeros(400)])
    return Table(
        residual=field + noise * random.normal(size=400),
        causes=causes,
        run=np.zeros(400, dtype=int),
        coordinate=np.nonzero(mask)[1],
        mask=(mask,),
    )


@pytest.fixture(scope='module')
def two_candidates():
    random = np.random.default_rng(5)
    frame, axis, target = np.nonzero(np.ones((40, 2, 5)))
    shapes = random.normal(size=(2, 10))
    fields = [1e-4 * (frame / 40.0) * shape[axis * 5 + target] for shape in shapes]
    return [
        Candidate(name=name, training=field[:, None], held_out=field[:, None])
        for name, field in zip(('one', 'other'), fields, strict=True)
    ]


@pytest.mark.parametrize('method', [staged, stepwise])
def test_a_regression_finds_what_is_alone(two_candidates, method):
    table, clean = made_table(two_candidates[1].training[:, 0]), made_table(np.zeros(400))
    names, correction = method(table, table, two_candidates)
    assert names == ['other']
    assert table.rms(correction) < 0.5 * table.rms(np.zeros(400))
    assert method(clean, clean, two_candidates)[0] == []


def test_pysindy_finds_what_is_alone(two_candidates):
    pytest.importorskip('pysindy')
    table = made_table(two_candidates[1].training[:, 0])
    names, correction = pysindy(table, table, two_candidates)
    assert names == ['other']
    assert table.rms(correction) < 0.5 * table.rms(np.zeros(400))


def test_the_other_methods_know_every_effect():
    assert {name for name, _ in small_effects()} == set(EFFECTS) - {*NEWER, 'inertia'}
    for name, columns in small_effects():
        for values in columns:
            EFFECTS[name](**values)


def test_methods_are_scored_on_the_same_trials():
    others = {
        'staged': {'names': ['gravity'], 'held_out': 2e-4},
        'pysindy': {'names': None, 'absent': 'not here'},
    }
    named = answer('named', ['camera_rotation'], of='camera_rotation', baselines=others)
    found = baseline_rates([(truth('single', ROTATED), named)])
    assert found['diagnosis']['first_right']['share'] == 1.0
    assert found['staged']['first_right']['share'] == 0.0
    assert found['staged']['false_names']['share'] == 1.0
    assert found['staged']['held_out_over_true'] == pytest.approx(2.0)
    assert found['pysindy']['first_right']['of'] == 0

"""What `check` finds in recordings, whole and bent."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.cli.verbs.check import range_lines, sync_lines
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.measurement.steady_states import hold_intervals
from pneunet_ros.offline.check import check_recording
from pneunet_ros.offline.uses import UseRequest
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.example_arms import paper_arm
from support.recorded_datasets import MS, pressure, readings, record, START, targets, TYPES, wrench
from support.refusals import reasons

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope='module')
def arm():
    """Return an arm with the three targets of recorded_runs, over 40 mm."""
    return dataclasses.replace(
        paper_arm(), length=0.05, target_arclength=np.array([0.0, 0.02, 0.04])
    )


@pytest.fixture
def said():
    return readings(60)


def found(tmp_path, said, arm, **request):
    """Check a recording of these messages."""
    return check_recording(record(tmp_path / 'r.mcap', said), UseRequest(arm=arm, **request))


def test_a_recording_without_topics_is_a_sentence(tmp_path, capsys):
    with write_recording(tmp_path / 'empty.mcap'):
        pass
    assert main(['check', str(tmp_path / 'empty.mcap'), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['recordings'][0]['topics'] == []


def test_a_loaded_recording(tmp_path, said, arm):
    check = found(tmp_path, said, arm)
    assert check['sentences'] == []
    topics = {topic['name']: topic for topic in check['topics']}
    assert topics['/pneunet/pressure']['count'] == 60
    assert topics['/pneunet/pressure']['rate'] == pytest.approx(100.0)
    assert topics['/pneunet/targets']['rate'] == pytest.approx(50.0)
    assert all(topic['gaps'] == 0 and topic['jitter'] < 1e-9 for topic in topics.values())
    assert check['sync']['targets'] == pytest.approx(
        {'share': 1.0, 'offset': 0.002, 'starts': 0.002}
    )
    ranges = check['ranges']
    assert ranges['pressure'] == [0.0, 5900.0]
    assert ranges['force_y'] == pytest.approx([-0.59, 0.0])
    assert ranges['y'] == pytest.approx([0.0, 0.029])
    assert ranges['seen_per_target'].tolist() == [30, 30, 30]
    usable = {name: use['usable'] for name, use in check['uses'].items()}
    assert usable == {
        'replay': True,
        'replay --fuse': True,
        'track': False,
        'calibrate unloaded': False,
        'calibrate loaded': True,
        'diagnose': True,
    }
    assert check['uses']['calibrate unloaded']['reason'].reason == 'loaded'


def test_an_unloaded_recording(tmp_path, arm):
    uses = found(tmp_path, readings(60, loaded=False), arm)['uses']
    assert uses['calibrate unloaded'] == {'usable': True, 'reason': ''}
    assert uses['replay']['usable']
    assert '--no-wrench-required' in uses['replay']['reason']
    assert not uses['calibrate loaded']['usable']


def test_gaps_and_what_lies_beside_one_another(tmp_path, said, arm):
    said = [
        entry
        for entry in said
        if entry[0] != 'pressure' or not START + 195 * MS < entry[1] < START + 305 * MS
    ]
    check = found(tmp_path, said, arm)
    timing = next(topic for topic in check['topics'] if topic['name'] == '/pneunet/pressure')
    assert timing['gaps'] == 1
    assert timing['longest_gap'] == pytest.approx(0.12)
    assert check['sync']['targets']['share'] == pytest.approx(24 / 30)


def test_clocks_that_do_not_agree_are_shown(tmp_path, said, arm):
    late = [
        (name, at, targets(at + 3_600_000 * MS, 0.001) if name == 'targets' else message)
        for name, at, message in said
    ]
    check = found(tmp_path, late, arm)
    assert check['sync']['targets']['share'] == 0.0
    assert check['sync']['targets']['starts'] == pytest.approx(3600.005)
    assert check['uses']['calibrate loaded']['reason'].reason == 'no_frames'


@pytest.mark.parametrize(
    ('message', 'reason'),
    [
        (targets(START + 1000 * MS, 0.0, 4), ' 4 '),
        (targets(START + 1000 * MS, 0.0, 3, 'camera'), "'camera'"),
    ],
)
def test_targets_that_are_none_are_said_and_the_rest_is_told(tmp_path, said, arm, message, reason):
    check = found(tmp_path, [*said, ('targets', START + 1000 * MS, message)], arm)
    assert reason in check['sentences'][0]
    assert check['uses']['replay']['usable']
    assert reason in check['uses']['calibrate loaded']['reason']


def test_a_wrench_of_a_wrong_frame(tmp_path, said, arm):
    check = found(tmp_path, [*said, ('end_wrench', START, wrench(START, (0, 0), 'cell'))], arm)
    assert "'cell'" in check['sentences'][0]
    assert check['ranges']['pressure'] == [0.0, 5900.0]


def test_a_doubted_force_sensor_is_left_out_by_the_fusion_alone(tmp_path, arm):
    said = [
        (name, at, wrench(at, (0.0, -1e-5 * (at - START) / MS), 'cell'))
        if name == 'end_wrench'
        else (name, at, message)
        for name, at, message in readings(60)
    ]
    uses = found(tmp_path, said, arm)['uses']
    assert "'cell'" in uses['replay']['reason']
    assert not uses['replay']['usable']
    assert uses['replay --fuse']['usable']


def test_readings_left_out_are_counted(tmp_path, said, arm):
    late = START + 700 * MS
    check = found(tmp_path, [*said, ('pressure', late, pressure(late, math.nan))], arm)
    assert reasons(check['sentences']) == ['not_finite']


@pytest.mark.parametrize(
    ('change', 'doubt'),
    [
        (lambda value: value / 100.0, 'most likely gauge kPa'),
        (lambda value: -10.0 * value, 'most likely gauge Pa with the sign reversed'),
        (lambda value: 10.0 * value + 101_325.0, '--pressure-reference absolute'),
        (lambda value: value + 101_325.0, 'of the readings are outside the calibrated range of'),
        (lambda value: 20.0 * value, '% of the readings are outside the calibrated range of'),
    ],
)
def test_pressures_of_another_kind_are_doubted(tmp_path, arm, change, doubt):
    said = [
        (
            'pressure',
            START + 10 * MS * index,
            pressure(START + 10 * MS * index, change(100.0 * index)),
        )
        for index in range(60)
    ]
    (sentence,) = found(tmp_path, said, arm)['sentences']
    assert doubt in sentence


def test_targets_in_another_unit_are_no_use(tmp_path, said, arm):
    small = dataclasses.replace(arm, length=0.02, target_arclength=np.array([0.0, 0.01, 0.02]))
    use = found(tmp_path, said, small)['uses']['calibrate loaded']
    assert use['reason'].reason == 'other_length'


def test_settings_and_topics_are_those_of_the_request(tmp_path, said, arm):
    check = found(
        tmp_path,
        said,
        arm,
        settings=EstimatorSettings(pressure_offset=100.0, wrench_required=False),
        overrides={'pressure': '/pneunet/pressure'},
    )
    assert check['ranges']['pressure'] == [100.0, 6000.0]
    assert check['uses']['calibrate unloaded']['usable']


def test_a_truncated_recording_is_told_as_far_as_it_goes(tmp_path, arm):
    path = record(tmp_path / 'r.mcap', readings(2000))
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    check = check_recording(path, UseRequest(arm=arm))
    assert 'cut_off' in reasons(check['sentences'])
    assert 0 < check['topics'][0]['count'] < 2000


def test_holds_are_found_in_noise():
    stamps = np.arange(1000, dtype=np.int64) * 10_000_000
    dice = np.random.default_rng(3)
    stairs = np.interp(np.arange(1000), [0, 300, 400, 700, 800, 999], [0, 0, 5e3, 5e3, 9e3, 9e3])
    values = np.column_stack([stairs + 30.0 * dice.normal(size=1000)])
    spans = hold_intervals(stamps, values, np.array([300.0]))
    assert len(spans) == 3
    np.testing.assert_allclose(spans, [[0, 300], [400, 700], [800, 999]], atol=8)
    # A second quantity that moves ends a hold.
    pushed = np.column_stack([stairs, np.where(np.arange(1000) < 500, 0.0, 0.1)])
    assert len(hold_intervals(stamps, pushed, np.array([300.0, 0.02]), 0.9)) == 4
    assert hold_intervals(stamps[:0], values[:0], np.array([300.0])) == []
    assert hold_intervals(stamps[:1], values[:1], np.array([300.0])) == []


def test_shipped_recordings(capsys):
    places = [str(ROOT / 'bags' / name) for name in ('table1', 'camera_demo')]
    assert main(['check', *places, '--json']) == 0
    table1, camera = json.loads(capsys.readouterr().out)['recordings']
    assert table1['uses']['replay'] == {'usable': True, 'reason': ''}
    assert len(table1['holds']) == 29
    assert not table1['uses']['track']['usable']
    assert camera['uses']['track'] == {'usable': True, 'reason': ''}
    assert 'pneunet track' in camera['uses']['calibrate unloaded']['reason']
    assert 'pneunet track' not in table1['uses']['calibrate unloaded']['reason']
    assert camera['sentences'] == []


@pytest.mark.parametrize(
    'bend',
    [
        lambda at: pressure(0, 1000.0),
        lambda at: pressure(at, math.nan),
        lambda at: pressure(at, 3e5),
    ],
)
def test_a_recording_that_gives_no_estimate_is_no_use_for_replay(tmp_path, arm, bend):
    said = [
        (name, at, bend(at) if name == 'pressure' else message)
        for name, at, message in readings(31)[1:]  # begins with a wrench
    ]
    use = found(tmp_path, said, arm)['uses']['replay']
    assert not use['usable']
    assert (use['reason'].reason, ' 30 ' in use['reason']) == ('no_estimate', True)


def test_wrenches_that_are_too_old_are_no_use_for_replay(tmp_path, arm):
    said = [
        (name, at, wrench(at - 900_000 * MS, (0.0, 0.0)) if name == 'end_wrench' else message)
        for name, at, message in readings(30)
    ]
    use = found(tmp_path, said, arm)['uses']['replay']
    assert not use['usable']
    assert use['reason'].reason == 'no_estimate'


def test_a_message_that_replay_cannot_read_is_no_use_for_it(tmp_path, said, arm):
    with write_recording(tmp_path / 'r.mcap') as writer:
        topics = {name: writer.add(f'/pneunet/{name}', TYPES[name]) for name in TYPES}
        for name, at, message in said:
            writer.write(topics[name], at, message)
        writer.write_raw(topics['pressure'], said[-1][1] + MS, b'\0\1\0\0half')
    check = check_recording(tmp_path / 'r.mcap', UseRequest(arm=arm))
    assert not check['uses']['replay']['usable']
    assert check['uses']['replay']['reason'].reason == 'damaged'


def test_images_that_cannot_be_read_are_no_use_for_track(tmp_path, arm):
    source = open_recording(ROOT / 'bags' / 'camera_demo')
    with write_recording(tmp_path / 'r.mcap') as writer:
        topics = {topic.name: writer.add_copy(topic) for topic in source.topics}
        for name, at, raw in source.raw_messages(list(topics)):
            cut = raw[: len(raw) // 2] if 'image' in name else raw
            writer.write_raw(topics[name], at, cut)
            if at > source.start_ns + 300 * MS:
                break
    use = check_recording(tmp_path / 'r.mcap', UseRequest(arm=arm))['uses']['track']
    assert not use['usable']
    assert use['reason'].reason == 'nothing_usable'


def test_it_is_told_to_people(tmp_path, capsys):
    path = record(tmp_path / 'r.mcap', readings(60))
    assert main(['check', str(path)]) == 0
    told = ' '.join(capsys.readouterr().out.split())
    assert '100 Hz' in told
    assert 'pressure: 0 to 5.9 kPa' in told
    assert 'targets: 3 in 30 ' in told
    assert 'calibrate loaded: ' in told


def test_what_is_never_known_of_a_tip_has_no_range(tmp_path, capsys, recwarn):
    """A camera that sees where the tip is, and not where it points."""
    table, recording = tmp_path / 'tip.csv', tmp_path / 'tip.mcap'
    table.write_text('time_s,tip_x_mm,tip_y_mm,pressure_kpa\n0,112,0,0\n0.1,111,5,3\n')
    assert main(['import', str(table), '--output', str(recording)]) == 0
    assert main(['check', str(recording)]) == 0
    said = capsys.readouterr().out
    assert 'tip_y: 0 to 5 mm' in said
    assert 'nan' not in said
    assert not [str(warning.message) for warning in recwarn]


def test_a_range_has_no_negative_zero():
    assert range_lines({'force_x': [-0.0, 0.5]}) == ['force_x: 0 to 0.5 N']


def test_what_begins_before_the_pressure_is_earlier():
    (line,) = sync_lines({'targets': {'share': 1.0, 'offset': 1e-3, 'starts': -1.35}})
    assert (' 1 ms ' in line, line.endswith('1.35 s earlier')) == (True, True)


def test_a_file_that_cannot_be_read_is_an_error(tmp_path, capsys):
    (tmp_path / 'r.mcap').write_text('no recording')
    assert main(['check', str(tmp_path / 'r.mcap')]) == 2
    assert 'r.mcap' in capsys.readouterr().err

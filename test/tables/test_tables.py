"""The verbs `export` and `import`: recording -> table -> the same recording."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.messages.builders import POSE_TYPE
from pneunet_ros.messages.readings import PRESSURE_TYPE, tip_pose_message
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.made_recordings import header
from support.recorded_datasets import MS, pressure, readings, record, START, targets, wrench
from support.refusals import refusal, refused

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def recording(tmp_path):
    said = readings()
    hidden = targets(START + 22 * MS, 0.001)
    hidden.data[72:76] = np.float32([np.nan]).view(np.uint8)
    said = [
        (name, at, hidden) if name == 'targets' and at == START + 25 * MS else (name, at, message)
        for name, at, message in said
    ]
    return record(tmp_path / 'r.mcap', said)


def same_run(left, right):
    """Whether two runs hold the same readings to the last bit."""
    names = ('reading_stamp_ns', 'pressure', 'stamp_ns', 'reading', 'force', 'moment', 'x', 'y')
    return left.loaded == right.loaded and all(
        np.array_equal(getattr(left, name), getattr(right, name), equal_nan=True) for name in names
    )


def test_a_recording_comes_back_from_its_table_to_the_last_bit(tmp_path, recording, capsys):
    table, again = tmp_path / 't.csv', tmp_path / 'again.mcap'
    assert main(['export', str(recording), '--output', str(table)]) == 0
    assert main(['import', str(table), '--output', str(again)]) == 0
    assert '50 ' in capsys.readouterr().out
    left, right = read_run(recording, 3)[0], read_run(again, 3)[0]
    assert math.isnan(left.x[1, 1])
    assert same_run(left, right)


def test_what_a_table_cannot_hold_is_named(tmp_path, capsys):
    sideways = wrench(START, (0.1, 0.0))
    sideways.wrench.force.z = 0.2
    unsure = pressure(START, 1e3)
    unsure.variance = 1e4
    tip = tip_pose_message(START, np.full(3, 0.05), 'world', ROSBAGS_TYPES)
    first = [('pressure', START - MS, pressure(START - MS, 1e3))]  # as a driver may begin
    first += [('end_wrench', START - MS, wrench(START - MS, (0.0, 0.0)))]
    messages = [*first, ('pressure', START, unsure), ('end_wrench', START, sideways)]
    path = record(tmp_path / 'r.mcap', [*messages, ('tip_pose', START, tip)])
    words = ['export', str(path), '--output', str(tmp_path / 't.csv'), '--json']
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out)
    notes = ' '.join(answer['sentences'])
    assert all(name in notes for name in ('variance', 'force_z', 'frame world'))
    assert not any(name.startswith('tip_') for name in answer['columns'])
    assert main([*words, '--overwrite', '--frame-id', 'world', '--wrench-frame', BASE_FRAME]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert 'tip_x_m' in answer['columns']
    assert 'world' not in ' '.join(answer['sentences'])


def test_poses_of_another_frame_alone_are_no_empty_table(tmp_path, capsys):
    tip = tip_pose_message(START, np.full(3, 0.05), 'world', ROSBAGS_TYPES)
    path, table = record(tmp_path / 'r.mcap', [('tip_pose', START, tip)]), tmp_path / 't.csv'
    words = ['export', str(path), '--output', str(table), '--json']
    code = main(words)
    assert refusal((code, *capsys.readouterr())) == 'wrong_frame'
    assert not table.exists()
    assert main([*words, '--frame-id', 'world']) == 0


def test_the_table_has_a_row_per_stamp_and_empty_cells(tmp_path, recording):
    table = tmp_path / 't.csv'
    assert main(['export', str(recording), '--output', str(table)]) == 0
    lines = table.read_text().splitlines()
    assert lines[0] == (
        'stamp_ns,time_s,pressure_pa,force_x_n,force_y_n,moment_n_m,x0_m,y0_m,x1_m,y1_m,x2_m,y2_m'
    )
    assert lines[1] == '1000000000000,0.0,0.0,,,,,,,,,'
    assert lines[2] == '1000001000000,0.001,,0.0,0.0,0.001,,,,,,'
    assert lines[3].startswith('1000002000000,0.002,,,,,0.0,0.0,')
    assert len(lines) == 51


def test_a_dimensionless_table_has_other_names_and_is_not_imported(tmp_path, recording, capsys):
    table, si = tmp_path / 't.npz', tmp_path / 'si.npz'
    assert main(['export', str(recording), '--output', str(si)]) == 0
    assert main(['export', str(recording), '--output', str(table), '--dimensionless']) == 0
    assert '0.17 N' in capsys.readouterr().out
    with np.load(table) as scaled, np.load(si) as arrays:
        sizes = {'x1': ('l', 'm', 0.112), 'force_x': ('mg', 'n', 0.17)} | {
            'moment': ('mg_l', 'n_m', 0.112 * 0.17), 'pressure': ('pa', 'pa', 1.0)
        }  # fmt: skip
        for name, (unit, si_unit, size) in sizes.items():
            assert size * scaled[f'{name}_{unit}'] == pytest.approx(
                arrays[f'{name}_{si_unit}'], nan_ok=True
            )
        assert not any(name.endswith(('_m', '_n')) for name in scaled)
    assert (
        main(['export', str(recording), '--output', str(tmp_path / 't.csv'), '--dimensionless'])
        == 0
    )
    again = ['import', str(tmp_path / 't.csv'), '--output', str(tmp_path / 'again.mcap')]
    assert main(again) == 2
    said = capsys.readouterr().err
    assert all(name in said for name in ('force_x_mg', 'moment_mg_l', 'x0_l'))


def test_arrays_by_the_same_names(tmp_path, recording):
    table = tmp_path / 't.npz'
    assert main(['export', str(recording), '--output', str(table)]) == 0
    with np.load(table) as arrays:
        assert arrays['stamp_ns'].dtype == np.int64
        assert arrays['stamp_ns'][2] == START + 2 * MS
        assert np.count_nonzero(np.isfinite(arrays['pressure_pa'])) == 20
        assert np.count_nonzero(np.isfinite(arrays['x1_m'])) == 9


def test_what_sensors_report_becomes_what_it_means(tmp_path, recording):
    table = tmp_path / 't.npz'
    options = ['--pressure-offset', '5', '--wrench-sign', '-1', '--topic']
    options += ['pressure=/pneunet/pressure', '--output', str(table)]
    assert main(['export', str(recording), *options]) == 0
    with np.load(table) as arrays:
        assert np.nanmin(arrays['pressure_pa']) == 5.0
        assert np.nanmin(arrays['force_x_n']) == pytest.approx(-0.19)


def write_tip(path, heading):
    """Write a pressure reading and the tip that an estimator made of it."""
    make = ROSBAGS_TYPES
    half = heading / 2
    pose = make('geometry_msgs/msg/Pose')(
        position=make('geometry_msgs/msg/Point')(x=0.1, y=0.04, z=0.0),
        orientation=make('geometry_msgs/msg/Quaternion')(
            x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)
        ),
    )
    tip = make(POSE_TYPE)(
        header=header(START),
        pose=make('geometry_msgs/msg/PoseWithCovariance')(pose=pose, covariance=np.zeros(36)),
    )
    with write_recording(path) as writer:
        writer.write(writer.add('/p/pressure', PRESSURE_TYPE), START, pressure(START, 31e3))
        writer.write(writer.add('/p/tip', POSE_TYPE), START, tip)


@pytest.mark.parametrize(
    'fields', ['int32 seconds\nuint32 nanoseconds', 'int32 sec\nstring nanosec']
)
def test_a_tip_whose_time_is_none_is_one_sentence(tmp_path, capsys, fields):
    line = '=' * 80
    definition = (
        'std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n'
        f'{line}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n'
        f'{line}\nMSG: builtin_interfaces/Time\n{fields}\n'
        f'{line}\nMSG: geometry_msgs/PoseWithCovariance\nPose pose\nfloat64[36] covariance\n'
        f'{line}\nMSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n'
        f'{line}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n'
        f'{line}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n'
    )
    path = tmp_path / 'r.mcap'
    with write_recording(path) as writer:
        tip = writer.add('/pneunet/tip', POSE_TYPE, definition)
        writer.write_raw(tip, 5, b'\0\1\0\0' + bytes(4) + b'\1\0\0\0\0' + bytes(600))
    words = ['export', str(path), '--output', str(tmp_path / 't.csv'), '--json']
    assert refusal((main(words), *capsys.readouterr())) == 'damaged'
    assert not (tmp_path / 't.csv').exists()


def test_estimated_tips_are_exported_and_left_out_again(tmp_path, capsys):
    estimated, table = tmp_path / 'estimated.mcap', tmp_path / 't.csv'
    write_tip(estimated, -2.5)
    assert main(['export', str(estimated), '--output', str(table)]) == 0
    names, first = table.read_text().splitlines()
    assert 'estimate_tip_x_m,estimate_tip_y_m,estimate_tip_theta_rad' in names
    assert first.startswith('1000000000000,0.0,31000.0,0.1,0.04,-2.5')
    capsys.readouterr()
    again = tmp_path / 'again.mcap'
    assert main(['import', str(table), '--output', str(again), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['topics'] == {'/pneunet/pressure': 1}
    assert len(summary['sentences']) == 1


def test_what_is_left_out_is_said(tmp_path, capsys):
    said = readings()
    said.append(('pressure', START + 300 * MS, pressure(START + 300 * MS, math.nan)))
    path = record(tmp_path / 'r.mcap', said)
    assert main(['export', str(path), '--output', str(tmp_path / 't.csv'), '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary['rows'] == 50
    (sentence,) = summary['sentences']
    assert sentence.startswith('/pneunet/pressure: 1 ')


@pytest.mark.parametrize(
    ('words', 'reason'),
    [
        (['export', 'REC', '--output', 't.txt'], 'wrong_suffix'),
        (['export', 'missing.mcap', '--output', 't.csv'], 'not_found'),
        (['export', 'REC', '--output', 'REC'], 'wrong_suffix'),
        (['export', 'REC', '--output', 'there.csv'], 'exists'),
        (['export', 'REC', '--output', 't.csv', '--topic', 'image_raw=/x'], 'wrong_form'),
        (['export', 'REC', '--output', 't.csv', '--frame-id', 'x'], 'unreadable'),
        (['import', 'there.csv', '--output', 'new.mcap'], 'empty'),
        (['import', 'REC', '--output', 'new.mcap'], 'wrong_kind'),
        (['import', 'good.csv', '--output', 'REC'], 'exists'),
        (['import', 'good.csv', '--output', 'new.mcap', '--offset', 'x'], 'wrong_form'),
        (['import', 'good.csv', '--output', 'new.mcap', '--offset', 'x=y'], 'not_a_number'),
    ],
)
def test_requests_that_cannot_be_met(tmp_path, recording, monkeypatch, capsys, words, reason):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'there.csv').write_text('')
    (tmp_path / 'good.csv').write_text('time_s,pressure_pa\n1,2\n')
    before = sorted(tmp_path.iterdir())
    given = [str(recording) if word == 'REC' else word for word in words]
    assert refusal((main([*given, '--json']), *capsys.readouterr())) == reason
    assert sorted(tmp_path.iterdir()) == before


def test_an_export_has_no_option_for_what_it_does_not_do(tmp_path, recording):
    words = ['export', str(recording), '--output', str(tmp_path / 't.csv'), '--no-judge-readings']
    with pytest.raises(SystemExit):
        main(words)


def test_images_alone_are_nothing_to_export(tmp_path, recording, capsys):
    with write_recording(tmp_path / 'empty.mcap') as writer:
        writer.add('/pneunet/image_raw', 'sensor_msgs/msg/Image')
    words = ['export', str(tmp_path / 'empty.mcap'), '--output', str(tmp_path / 't.csv')]
    assert refusal((main([*words, '--json']), *capsys.readouterr())) == 'nothing_usable'


def test_the_shipped_recording_is_exported_and_imported(tmp_path):
    table, again = tmp_path / 't.csv', tmp_path / 'again'
    assert main(['export', str(ROOT / 'bags/table1'), '--output', str(table)]) == 0
    assert main(['import', str(table), '--output', str(again)]) == 0
    with refused(RecordingError, 'no_topic'):
        read_run(again, 23)
    second = tmp_path / 'u.csv'
    assert main(['export', str(again), '--output', str(second)]) == 0
    assert second.read_text() == table.read_text()

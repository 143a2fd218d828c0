"""Recordings as calibration sees them: what belongs together, is left out, or is refused."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.messages.readings import PRESSURE, tip_pose_message
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recorded_series import nearest, ReadingSeries
import pytest
from support.recorded_datasets import BASE, MS, pressure, readings, record, START, targets, wrench
from support.refusals import reasons, refused


@pytest.fixture
def said():
    return readings()


def place(said, name, index):
    """Where the message of this topic and index stands in the list."""
    return [number for number, entry in enumerate(said) if entry[0] == name][index]


def test_a_loaded_recording(tmp_path, said):
    run, sentences = read_run(record(tmp_path / 'r.mcap', said), 3)
    assert run.name == str(tmp_path / 'r.mcap')
    assert sentences == ()
    assert run.loaded
    np.testing.assert_array_equal(run.reading_stamp_ns, START + 10 * MS * np.arange(20))
    np.testing.assert_array_equal(run.pressure, 100.0 * np.arange(20))
    np.testing.assert_array_equal(run.stamp_ns, START + 2 * MS + 20 * MS * np.arange(10))
    np.testing.assert_array_equal(run.reading, np.arange(0, 20, 2))
    np.testing.assert_allclose(run.force[:, 0], 0.02 * np.arange(10))
    np.testing.assert_allclose(run.force[:, 1], -0.02 * np.arange(10))
    np.testing.assert_array_equal(run.moment, 1e-3)
    np.testing.assert_array_equal(run.x, np.tile(np.float32([0.0, 0.02, 0.04]), (10, 1)))
    np.testing.assert_allclose(run.y[:, 2], 0.001 * np.arange(10), atol=1e-9)


def test_without_a_wrench_the_arm_is_unloaded(tmp_path, said):
    bare = read_run(record(tmp_path / 'r.mcap', readings(loaded=False)), 3)[0]
    ignored = read_run(
        record(tmp_path / 's.mcap', said), 3, settings=EstimatorSettings(wrench_required=False)
    )[0]
    for run in (bare, ignored):
        assert not run.loaded
        assert not run.force.any()
        assert not run.moment.any()
        assert len(run.stamp_ns) == 10


def test_frames_taken_while_the_pressure_jumps_are_left_out_and_counted(tmp_path):
    def stepped(far):
        """Let the pressure jump between its readings at 60 and 70 ms; frames are 2 ms late."""
        random = np.random.default_rng(2)
        return [
            (name, at, pressure(at, far * (at > START + 65 * MS) + random.normal(0.0, 20.0)))
            if name == 'pressure'
            else (name, at, message)
            for name, at, message in readings(loaded=False)
        ]

    still, said = read_run(record(tmp_path / 'still.mcap', stepped(0.0)), 3)
    assert (len(still.stamp_ns), said) == (10, ())
    run, said = read_run(record(tmp_path / 'r.mcap', stepped(20e3)), 3)
    assert reasons(said) == ['between_readings']
    assert set(still.stamp_ns) - set(run.stamp_ns) == {START + 62 * MS}


def test_a_wrench_that_never_changes_is_a_known_load_and_no_reading(tmp_path, said):
    def with_forces(forces):
        count = iter(forces)
        return [
            (name, at, wrench(at, next(count))) if name == 'end_wrench' else (name, at, message)
            for name, at, message in said
        ]

    weights = sum(name == 'end_wrench' for name, _, _ in said)
    run, sentences = read_run(
        record(tmp_path / 'r.mcap', with_forces([(0.0, -0.05)] * weights)), 3
    )
    assert run.loaded
    assert run.load_known
    assert 'known_load' in reasons(sentences)
    assert any('0.05 N' in sentence for sentence in sentences)
    moment_alone = with_forces([(0.0, 0.0)] * weights)
    run, sentences = read_run(record(tmp_path / 'm.mcap', moment_alone), 3)
    assert run.load_known
    assert not any('0 N' in sentence for sentence in sentences)
    sensor = [(0.0, -0.05)] * (weights - 1) + [(0.0, -0.0500001)]
    run, sentences = read_run(record(tmp_path / 's.mcap', with_forces(sensor)), 3)
    assert run.loaded
    assert not run.load_known
    assert sentences == ()


def test_settings_mean_what_they_mean_for_the_estimator(tmp_path, said):
    settings = EstimatorSettings(
        pressure_reference='absolute',
        ambient_pressure=1e5,
        pressure_offset=50.0,
        wrench_sign=-1,
        wrench_yaw=math.pi / 2,
    )
    run, _ = read_run(record(tmp_path / 'r.mcap', said), 3, settings=settings)
    np.testing.assert_allclose(run.pressure, 100.0 * np.arange(20) + 50.0 - 1e5)
    # The reaction (-f, f) turned by a quarter is (-f, -f).
    np.testing.assert_allclose(run.force[:, 0], -0.02 * np.arange(10), atol=1e-15)
    np.testing.assert_allclose(run.force[:, 1], -0.02 * np.arange(10), atol=1e-15)
    np.testing.assert_array_equal(run.moment, -1e-3)


def test_topics_may_have_other_names(tmp_path, said):
    path = record(tmp_path / 'r.mcap', said, '/lab')
    run, _ = read_run(path, 3, {'pressure': '/lab/pressure', 'targets': '/lab/targets'})
    assert len(run.stamp_ns) == 10
    with refused(RecordingError, 'no_topic'):
        read_run(path, 3, {'end_wrench': '/other'})


def test_readings_that_cannot_be_used_are_left_out_and_counted(tmp_path, said):
    said[place(said, 'pressure', 3)] = ('pressure', START, pressure(START + 30 * MS, math.nan))
    said[place(said, 'pressure', 5)] = ('pressure', START + 51 * MS, pressure(0, 1.0))
    at = START + 70 * MS
    said.insert(place(said, 'pressure', 8), ('pressure', at + 1, pressure(at, 9e9)))
    said.insert(place(said, 'pressure', 8), ('pressure', at + 2, pressure(at - 15 * MS, 9e9)))
    said.append(('end_wrench', at + MS, wrench(at + MS, (math.inf, 0.0))))
    run, sentences = read_run(record(tmp_path / 'r.mcap', said), 3)
    assert reasons(sentences) == ['not_finite', 'no_stamp', 'duplicate', 'older', 'not_finite']
    assert all(': 1 ' in sentence for sentence in sentences)
    assert run.pressure.tolist() == [100.0 * index for index in range(20) if index not in (3, 5)]


def test_frames_without_a_reading_or_a_target_are_left_out_and_counted(tmp_path, said):
    said[place(said, 'targets', 1)] = (
        'targets',
        START + 25 * MS,
        targets(START + 22 * MS, math.nan),
    )
    for name, index in (('pressure', 8), ('end_wrench', 12), ('end_wrench', 14)):
        del said[place(said, name, index)]
    run, sentences = read_run(record(tmp_path / 'r.mcap', said), 3)
    assert reasons(sentences) == ['no_target', 'unmatched', 'unmatched']
    assert all(': 1 ' in sentence for sentence in sentences)
    heights = np.delete(np.arange(10), [1, 4, 6])
    np.testing.assert_allclose(run.y[:, 2], 0.001 * heights, atol=1e-9)
    np.testing.assert_allclose(run.frame_pressure, 200.0 * heights)
    np.testing.assert_allclose(run.force[:, 0], 0.02 * heights)


def test_a_target_that_was_not_seen_is_nan(tmp_path, said):
    cloud = targets(START + 22 * MS, 0.001)
    cloud.data[72:76] = np.float32([np.nan]).view(np.uint8)
    said[place(said, 'targets', 1)] = ('targets', START + 22 * MS, cloud)
    run, _ = read_run(record(tmp_path / 'r.mcap', said), 3)
    assert run.seen.sum() == 29
    assert math.isnan(run.x[1, 1])
    assert math.isnan(run.y[1, 1])


def test_of_a_bag_that_loops_the_longest_stretch_is_kept(tmp_path):
    once = readings(110)
    loop = [(name, log_time + 2000 * MS, message) for name, log_time, message in once[:100]]
    run, sentences = read_run(record(tmp_path / 'r.mcap', once + loop), 3)
    assert len(run.pressure) == 110
    assert len(run.stamp_ns) == 55
    assert reasons(sentences)[0] == 'starts_anew'
    assert ': 40 ' in sentences[0]


def test_of_one_stamp_ahead_only_that_reading_is_left_out(tmp_path):
    said = readings(110)
    messages = [message for name, _, message in said if name == 'pressure']
    messages[40].header.stamp.sec += 5
    run, sentences = read_run(record(tmp_path / 'r.mcap', said), 3)
    assert len(run.pressure) == 109
    assert 'ahead' in reasons(sentences)


def test_clocks_that_do_not_agree_leave_nothing(tmp_path, said):
    late = [
        (name, log_time, targets(START + 3_600_000 * MS + index, 0.01))
        if name == 'targets'
        else (name, log_time, message)
        for index, (name, log_time, message) in enumerate(said)
    ]
    with refused(RecordingError, 'no_frames'):
        read_run(record(tmp_path / 'r.mcap', late), 3)


@pytest.mark.parametrize(
    ('name', 'message', 'what'),
    [
        ('targets', targets(START, 0.0, 4), 'there are 4 points in targets, but the arm has 3'),
        ('targets', targets(START, 0.0, 3, 'camera'), "targets are in frame 'camera'"),
        ('end_wrench', wrench(START, (0.1, 0.0), 'cell'), "end wrench in frame 'cell', which"),
    ],
)
def test_what_is_not_of_this_arm_is_refused(tmp_path, said, name, message, what):
    said.append((name, START + 500 * MS, message))
    with refused(RecordingError, 'unreadable'):
        read_run(record(tmp_path / 'r.mcap', said), 3)


def test_missing_targets_are_named(tmp_path, said):
    rest = [entry for entry in said if entry[0] != 'targets']
    with refused(RecordingError, 'no_topic'):
        read_run(record(tmp_path / 'r.mcap', rest), 3)


def test_without_a_pressure_topic_there_is_no_pressure(tmp_path, said):
    rest = [entry for entry in said if entry[0] != 'pressure']
    run, sentences = read_run(record(tmp_path / 'r.mcap', rest), 3)
    whole, _ = read_run(record(tmp_path / 'whole.mcap', said), 3)
    assert whole.pressurized
    assert not run.pressurized
    assert not run.frame_pressure.any()
    assert np.array_equal(run.stamp_ns, whole.stamp_ns)
    assert 'no_pressure' in reasons(sentences)


def test_a_tip_that_was_never_measured_is_left_out(tmp_path, said):
    unseen = ('tip_pose', START, tip_pose_message(START, [0.0, 0.0, 0.0], 'cell', ROSBAGS_TYPES))
    run, sentences = read_run(record(tmp_path / 'r.mcap', [*said, unseen]), 3)
    assert run.tip_pose is None
    assert run.tip_frame == BASE
    assert len(run.stamp_ns) == 10
    assert reasons(sentences) == ['nothing_usable']
    rest = [entry for entry in said if entry[0] != 'targets']
    with refused(RecordingError, 'nothing_usable'):
        read_run(record(tmp_path / 's.mcap', [*rest, unseen]), 3)


def test_a_truncated_recording_is_read_as_far_as_it_goes(tmp_path):
    path = record(tmp_path / 'r.mcap', readings(2000))
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) * 3 // 4])
    run, sentences = read_run(path, 3)
    assert reasons(sentences)[0] == 'cut_off'
    assert 100 < len(run.stamp_ns) < 1000


def test_nearest_is_within_half_a_period():
    series = ReadingSeries(
        sensor=PRESSURE,
        topic='/p',
        stamp_ns=np.array([100, 200, 300, 1000]),
        values=np.zeros((4, 1)),
        left_out={},
    )
    assert series.period == pytest.approx(100e-9)
    found, close = nearest(np.array([40, 50, 149, 151, 350, 351, 1050, 1051]), series)
    assert found.tolist() == [0, 0, 0, 1, 2, 2, 3, 3]
    assert close.tolist() == [False, True, True, True, True, False, True, False]


def test_one_reading_alone_belongs_to_its_stamp(tmp_path):
    said = [('pressure', START, pressure(START, 1e3)), ('targets', START, targets(START, 0.01))]
    run, _ = read_run(record(tmp_path / 'r.mcap', said), 3)
    assert run.frame_pressure.tolist() == [1e3]

"""`pneunet compare`: known shapes a known distance apart, and what cannot be compared."""

from __future__ import annotations

from dataclasses import replace
import json
import math
from pathlib import Path
import re

from matplotlib.figure import Figure
import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.frames import BASE_FRAME
from pneunet_ros.estimation.shape_error import (
    Centerlines,
    compare_shapes,
    error_statistics,
    match_series,
    other_pressures,
    Pressures,
    ShapeSeries,
    share_inside,
    Tips,
)
from pneunet_ros.lab.lab_recording import LabTruth
from pneunet_ros.messages.builders import header, path, PATH_TYPE, pose_rows
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import TARGETS, targets_message, TIP_POSE, tip_pose_message
from pneunet_ros.offline.compare import comparison_content
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recorded_shapes import read_measured
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
from pneunet_ros.reports.compare_plot import draw_comparison, draw_shapes, labels_of
import pytest
from support.refusals import reasons, refusal, refused

RADIUS = 0.2  # m, of the arcs
LENGTH = 0.112
SECOND = 1_000_000_000
PERIOD = SECOND // 10
FRAMES = 12
S = np.linspace(0.0, LENGTH, 29)
TARGETS_AT = 0.005 * np.arange(23)


def arcs(arclength, frames=FRAMES, shift=(0.0, 0.0)):
    """Return points (frames, 2, places) of arcs that bend more from frame to frame."""
    curvature = (1.0 + np.arange(frames))[:, None] / (RADIUS * frames)
    angle = curvature * arclength
    x, y = np.sin(angle) / curvature, (1.0 - np.cos(angle)) / curvature
    return np.stack([x + shift[0], y + shift[1]], axis=1)


def series(arclength=S, shift=(0.0, 0.0), start=0, tips=True, **changes):
    stamps = SECOND + start + PERIOD * np.arange(FRAMES)
    points = arcs(arclength, shift=shift)
    line = Centerlines(topic='/shape', stamp_ns=stamps, arclength=arclength, points=points)
    place, heading = points[:, :, -1], np.zeros(FRAMES)
    tip = Tips(topic='/tip', stamp_ns=stamps, place=place, heading=heading)
    about = {'name': 'x', 'centerlines': line, 'tips': tip if tips else None}
    return ShapeSeries(**(about | changes))


# The numbers, by hand.


def test_a_shift_is_found_to_rounding_at_the_tip_and_along_the_arm():
    found = compare_shapes(series(shift=(3e-4, -4e-4)), series())
    assert error_statistics(found.tip.distance).rms == pytest.approx(5e-4, rel=1e-12)
    assert error_statistics(found.shape.distance).max == pytest.approx(5e-4, rel=1e-12)
    content = comparison_content(found)
    assert content['tip']['mean'] == pytest.approx([3e-4, -4e-4])
    assert content['tip']['percent_of_length']['rms'] == pytest.approx(100.0 * 5e-4 / LENGTH)
    assert content['shape']['points'] == FRAMES * S.size


@pytest.mark.parametrize(
    ('names', 'labels'),
    [(('day/a.mcap', 'b.mcap'), ['a', 'b']), (('a.mcap', 'a.mcap'), ['/shape', '/fused/shape'])],
)
def test_a_plot_tells_the_sides_apart(names, labels):
    of, to = (series(name=name) for name in names)
    to = replace(to, centerlines=replace(to.centerlines, topic='/fused/shape'))
    found = compare_shapes(of, to)
    axes = Figure().add_subplot()
    draw_shapes(axes, found.shape, labels_of(found, found.shape))
    assert [text.get_text() for text in axes.get_legend().get_texts()] == labels


def test_a_plot_names_the_place_that_is_compared_and_what_is_not():
    at_end = compare_shapes(series(), series())
    before = compare_shapes(series(TARGETS_AT, tips=False), series())
    for found, title, empty in (
        (at_end, 'Error of the tip', 0),
        (before, 'Error at s = 110 mm', 0),
        (replace(at_end, shape=None), 'Error of the tip', 2),
        (replace(at_end, tip=None), 'Error of the tip', 1),
    ):
        axes = Figure().subplots(1, 3)
        draw_comparison(axes, found)
        assert axes[2].get_title() == title
        words = [text.get_text() for panel in axes for text in panel.texts]
        assert words.count('nothing to compare') == empty


def test_other_stations_are_interpolated_and_not_compared_by_their_number():
    found = compare_shapes(series(TARGETS_AT, tips=False), series())
    assert found.shape.arclength == pytest.approx(TARGETS_AT)
    assert np.max(found.shape.distance) < 1e-9  # of a cubic spline through 29 stations
    assert not found.tip.at_end
    assert found.tip.at == pytest.approx(0.110)
    turned = compare_shapes(series(), series(TARGETS_AT, tips=False))
    assert turned.shape.arclength == pytest.approx(TARGETS_AT)


def test_targets_that_were_not_seen_do_not_count():
    points = arcs(TARGETS_AT)
    points[3, :, 7] = np.nan
    points[5] = np.nan
    line = replace(series(TARGETS_AT).centerlines, points=points)
    found = compare_shapes(series(tips=False, centerlines=line), series())
    assert np.count_nonzero(np.isfinite(found.shape.distance)) == (FRAMES - 1) * 23 - 1
    assert len(found.shape.stamp_ns) == FRAMES - 1


def test_a_side_that_never_knows_where_the_arm_is_matches_nothing():
    points = arcs(S)
    points[:, 1] = np.nan
    line = replace(series().centerlines, points=points)
    assert compare_shapes(series(tips=False, centerlines=line), series()).shape is None


def test_a_side_without_a_frame_is_said():
    tips = series().tips
    empty = replace(
        tips, stamp_ns=tips.stamp_ns[:0], place=tips.place[:0], heading=tips.heading[:0]
    )
    nothing = series(name='nothing', centerlines=None, tips=True)
    nothing = replace(nothing, tips=empty)
    (note,) = comparison_content(compare_shapes(nothing, series(), LENGTH))['sentences']
    assert note.reason == 'nothing_in_common'


def test_statistics_are_those_of_the_definition():
    found = error_statistics(np.array([0.0, 3.0, np.nan, 4.0]))
    assert (found.count, found.median, found.max) == (3, 3.0, 4.0)
    assert found.rms == pytest.approx(math.sqrt(25.0 / 3.0))


def test_the_ellipse_holds_as_many_as_it_says():
    rng = np.random.default_rng(3)
    factor = np.array([[2e-4, 0.0], [1e-4, 5e-5]])
    difference = rng.normal(size=(20_000, 2)) @ factor.T
    covariance = np.broadcast_to(factor @ factor.T, (20_000, 2, 2))
    assert share_inside(difference, covariance) == pytest.approx(0.95, abs=0.005)
    assert share_inside(difference, covariance / 4.0) < 0.6


def test_the_share_in_the_ellipse_is_the_same_from_both_sides():
    truth, found = series(exact=True), series(shift=(1e-4, 0.0))
    covariance = np.tile(np.diag([1e-8, 1e-8]), (FRAMES, 1, 1))
    found = replace(found, tips=replace(found.tips, covariance=covariance))
    for of, to in ((found, truth), (truth, found)):
        assert compare_shapes(of, to).tip.inside_95 == 1.0


@pytest.mark.parametrize('sides', [slice(None), slice(None, None, -1)])
def test_the_last_station_of_a_truth_may_be_before_the_tip(sides):
    estimate = series(whole=True)
    short = compare_shapes(*(estimate, series(S[:-1], exact=True))[sides])
    assert (short.tip.at_end, short.tip.at) == (False, S[-2])
    assert error_statistics(short.tip.distance).max < 1e-9
    of_the_lab = compare_shapes(*(estimate, series(S[:-1], exact=True, whole=True))[sides])
    assert (of_the_lab.tip.at_end, of_the_lab.tip.at) == (True, S[-1])


# Which frames belong together.


def test_frames_of_the_slower_meet_the_nearest_of_the_faster():
    slow, fast = 100 * np.arange(5) + 7, 10 * np.arange(50)
    of, to = match_series(slow, fast)
    assert (of.tolist(), to.tolist()) == (list(range(5)), [1, 11, 21, 31, 41])
    to, of = match_series(fast, slow)
    assert (of.tolist(), to.tolist()) == (list(range(5)), [1, 11, 21, 31, 41])


def test_stamps_more_than_half_a_period_apart_do_not_match():
    found = compare_shapes(series(start=FRAMES * PERIOD + PERIOD // 2 + 1), series())
    assert (found.tip, found.shape) == (None, None)
    (note,) = comparison_content(found)['sentences']
    assert note.reason == 'nothing_in_common'
    assert '1.000 to 2.100 s' in note


def test_how_far_the_tip_moves_between_stamps_is_said():
    content = comparison_content(compare_shapes(series(start=PERIOD // 10), series()))
    ends = arcs(S)[:, :, -1]
    typical = np.median(np.hypot(*np.diff(ends, axis=0).T))
    assert content['tip']['moved_between_stamps'] == pytest.approx(0.1 * typical, rel=0.2)
    assert content['tip']['stamps_apart']['max'] == pytest.approx(0.01)


# What has nothing in common.


def test_shapes_in_two_frames_are_refused():
    with refused(RecordingError, 'wrong_frame'):
        compare_shapes(series(frame='map'), series(frame=BASE_FRAME))


def test_a_tip_and_points_along_the_arm_have_nothing_in_common():
    with refused(RecordingError, 'nothing_in_common'):
        compare_shapes(series(centerlines=None), series(tips=False))


# The verb, on files.


def write_targets(file: Path, points, stamps, also=(), frame_id=BASE_FRAME) -> Path:
    with write_recording(file) as writer:
        topic = writer.add('/pneunet/targets', TARGETS.type)
        for stamp, (x, y) in zip(stamps, points, strict=True):
            message = targets_message(stamp, x, y, frame_id, ROSBAGS_TYPES, 1e-4)
            writer.write(topic, stamp, message)
        for name, kind, build in also:
            topic = writer.add(name, kind)
            for frame, stamp in enumerate(stamps):
                writer.write(topic, stamp, build(frame, stamp))
    return file


@pytest.fixture
def run(capsys, monkeypatch):
    """Run the command; returns its exit code and what stands on stdout and stderr."""
    monkeypatch.setenv('COLUMNS', '200')

    def run(*arguments):
        code = main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def run_json(run):
    """Run the command with --json; returns its exit code and the object on stdout."""

    def run_json(*arguments):
        code, out, err = run(*arguments, '--json')
        assert err == ''
        return code, json.loads(out)

    return run_json


@pytest.fixture
def stamps():
    return (SECOND + PERIOD * np.arange(FRAMES)).tolist()


@pytest.fixture
def truth(tmp_path, stamps):
    points = arcs(S)
    file = tmp_path / 'x.truth.npz'
    arrays = {'stamp_ns': np.array(stamps), 'arclength': S, 'theta': np.zeros(points[:, 0].shape)}
    np.savez(file, x=points[:, 0], y=points[:, 1], **arrays)
    return file


def test_targets_against_a_truth(tmp_path, stamps, truth, run_json):
    file = write_targets(tmp_path / 'a.mcap', arcs(TARGETS_AT, shift=(0.0, 2e-4)), stamps)
    plot = tmp_path / 'plot.png'
    code, answer = run_json('compare', file, truth, '--plot', plot)
    (found,) = answer['comparisons']
    assert code == 0
    assert found['tip']['frames'] == found['shape']['frames'] == FRAMES
    assert found['tip']['rms'] == pytest.approx(2e-4, rel=1e-3)  # float32
    assert found['shape']['topics'] == {'of': '/pneunet/targets', 'to': 'truth'}
    assert found['length'] == pytest.approx(LENGTH)
    assert plot.read_bytes().startswith(b'\x89PNG')


def test_both_against_a_truth_and_one_another(tmp_path, stamps, truth, run_json, run):
    a = write_targets(tmp_path / 'a.mcap', arcs(TARGETS_AT, shift=(0.0, 2e-4)), stamps)
    b = write_targets(tmp_path / 'b.mcap', arcs(TARGETS_AT, shift=(0.0, -1e-4)), stamps)
    _, answer = run_json('compare', a, b, '--truth', truth)
    errors = [item['tip']['rms'] for item in answer['comparisons']]
    assert errors == pytest.approx([3e-4, 2e-4, 1e-4], rel=1e-3)
    code, out, _ = run('compare', a, '--truth', truth)
    assert code == 0
    assert [item['tip']['frames'] for item in answer['comparisons']] == 3 * [FRAMES]
    assert '/pneunet/targets' in out


def test_targets_may_be_in_the_frame_of_a_mounted_arm(tmp_path, stamps, run_json, run):
    a, b = (
        write_targets(tmp_path / name, arcs(TARGETS_AT), stamps, frame_id='left_base')
        for name in ('a.mcap', 'b.mcap')
    )
    code, answer = run_json('compare', a, b)
    assert (code, answer['comparisons'][0]['tip']['frames']) == (0, FRAMES)
    c = write_targets(tmp_path / 'c.mcap', arcs(TARGETS_AT), stamps)
    assert refusal(run('compare', a, c, '--json')) == 'wrong_frame'


def test_a_measured_pose_of_the_tip_against_a_truth(tmp_path, stamps, truth, run_json):
    ends = arcs(S)[:, :, -1] + np.array([1e-3, 0.0])

    def pose(frame, stamp):
        return tip_pose_message(stamp, np.array([*ends[frame], 0.0]), BASE_FRAME, ROSBAGS_TYPES)

    file = write_targets(
        tmp_path / 'a.mcap', arcs(TARGETS_AT), stamps, [('/mocap/tip_pose', TIP_POSE.type, pose)]
    )
    _, answer = run_json('compare', file, truth)
    assert answer['comparisons'][0]['tip']['topics']['of'] == '/mocap/tip_pose'
    assert answer['comparisons'][0]['tip']['rms'] == pytest.approx(1e-3)
    assert answer['comparisons'][0]['tip']['heading']['max'] == pytest.approx(0.0, abs=1e-9)


def test_a_pose_of_the_tip_in_another_frame_is_not_compared(
    tmp_path, stamps, truth, run_json, run
):
    def pose(frame, stamp):
        return tip_pose_message(stamp, np.zeros(3), 'world', ROSBAGS_TYPES)

    poses = [('/mocap/tip_pose', TIP_POSE.type, pose)]
    both = write_targets(tmp_path / 'a.mcap', arcs(TARGETS_AT), stamps, poses)
    _, answer = run_json('compare', both, truth)
    assert answer['comparisons'][0]['tip']['topics']['of'] == '/pneunet/targets'
    assert 'in the frame world' in ' '.join(answer['comparisons'][0]['sentences'])
    with write_recording(tmp_path / 'b.mcap') as writer:
        topic = writer.add(*poses[0][:2])
        for frame, stamp in enumerate(stamps):
            writer.write(topic, stamp, pose(frame, stamp))
    assert refusal(run('compare', tmp_path / 'b.mcap', truth, '--json')) == 'wrong_frame'


def test_a_pose_of_the_tip_without_a_frame_is_in_that_of_the_targets(tmp_path, stamps):
    def pose(frame, stamp):
        return tip_pose_message(stamp, np.zeros(3), '', ROSBAGS_TYPES)

    poses = [('/mocap/tip_pose', TIP_POSE.type, pose)]
    file = write_targets(tmp_path / 'a.mcap', arcs(TARGETS_AT), stamps, poses, frame_id='camera')
    found = read_measured(open_recording(file), {}, TARGETS_AT)
    assert (found.frame, found.tips.topic) == ('camera', '/mocap/tip_pose')


def test_recordings_without_a_common_stamp_are_a_negative_answer(tmp_path, stamps, truth, run):
    late = [stamp + 100 * SECOND for stamp in stamps]
    a = write_targets(tmp_path / 'a.mcap', arcs(TARGETS_AT), late)
    assert run('compare', a, truth)[0] == 1


@pytest.mark.parametrize(
    ('arguments', 'reason'),
    [
        (['a.mcap'], 'missing'),
        (['a.mcap', 'a.mcap'], 'given_twice'),
        (['a.mcap', 'x.truth.npz', '--plot', 'p.doc'], 'wrong_suffix'),
        (['a.mcap', 'x.truth.npz', '--topic', 'c.targets=/t'], 'wrong_form'),
        (['a.mcap', 'x.truth.npz', '--topic', 'targets=/t'], 'no_topic'),
        (['a.mcap', 'absent.npz'], 'no_truth'),
        (['a.mcap', 'empty.npz'], 'no_truth'),
        (['a.mcap', 'back.npz'], 'no_truth'),
        (['five.mcap', 'x.truth.npz'], 'unreadable'),
        (['wrench.mcap', 'x.truth.npz'], 'no_topic'),
    ],
)
def test_what_cannot_be_compared_is_said(
    arguments, reason, tmp_path, stamps, truth, run, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    write_targets(Path('a.mcap'), arcs(TARGETS_AT), stamps)
    write_targets(Path('five.mcap'), arcs(TARGETS_AT[:5]), stamps)
    flat = np.zeros((1, 3))
    np.savez('empty.npz', stamp_ns=[], arclength=[0, 1], **dict.fromkeys('xy', flat), theta=flat)
    np.savez('back.npz', stamp_ns=[1], arclength=[0, 2, 1], x=flat, y=flat, theta=flat)
    with write_recording(Path('wrench.mcap')) as writer:
        topic = writer.add('/other', PATH_TYPE)
        heading = header(SECOND, BASE_FRAME, ROSBAGS_TYPES)
        message = path(pose_rows(np.zeros(1), np.zeros(1), np.zeros(1)), heading, ROSBAGS_TYPES)
        writer.write(topic, SECOND, message)
    assert refusal(run('compare', *arguments, '--json')) == reason


def test_the_truth_has_what_is_read_of_it():
    assert {'arclength', 'x', 'y', 'theta'} <= set(LabTruth.__dataclass_fields__)
    assert {'tip', 'shape'} <= {output.name for output in OUTPUTS}


# What does not belong together.


def pressures(first, last, start=0):
    stamps = SECOND + start + PERIOD * np.arange(FRAMES)
    return Pressures(stamp_ns=stamps, values=np.linspace(first, last, FRAMES))


def test_what_is_not_of_one_arm_is_said_and_has_no_error():
    """No number in mm is given where it would mean nothing."""
    other = compare_shapes(series(whole=True), series(name='other', arclength=1.4 * S, whole=True))
    assert other.tip is None and other.shape is None
    (sentence,) = comparison_content(other)['sentences'][-1:]
    assert 'different arms: 156.8 mm long in other' in sentence


@pytest.mark.parametrize('other', [pressures(5e4, 0.0), pressures(0.0, 50.0)])
def test_other_pressures_are_a_note_beside_the_errors(other):
    """Another run, or a sensor that reports kPa."""
    of = series(pressures=pressures(0.0, 5e4), whole=True)
    found = compare_shapes(of, series(name='other', pressures=other, whole=True))
    assert found.tip is not None and found.shape is not None
    (sentence,) = comparison_content(found)['sentences'][-1:]
    assert re.search('differ by .* kPa rms: .* different runs, or .* unit', sentence)


def test_targets_of_another_arm_are_said():
    """Targets 1.5 times as far apart as --model has them are those of another arm."""
    line = Centerlines(
        topic='/targets',
        stamp_ns=series().centerlines.stamp_ns,
        arclength=TARGETS_AT,
        points=1.5 * arcs(TARGETS_AT),
    )
    of = series(centerlines=line, tips=False, name='mine')
    found = compare_shapes(of, series())
    assert found.tip is None
    assert reasons(found.unlike) == ['other_length']


@pytest.mark.parametrize(('apart', 'said'), [(400.0, ['other_run']), (30.0, [])])
def test_another_run_of_an_arm_of_3_kpa_is_another_run(apart, said):
    """What is small depends on the range of the arm and the noise of its sensor."""
    noise = 20.0 * np.random.default_rng(2).standard_normal((2, FRAMES))
    low, high = pressures(0.0, 3e3), pressures(apart, 3e3 + apart)
    one, other = (
        replace(both, values=both.values + row)
        for both, row in zip((low, high), noise, strict=True)
    )
    of = series(pressures=one, whole=True)
    assert reasons(other_pressures(of, series(pressures=other, whole=True))) == said


def test_small_differences_of_the_pressure_are_those_of_sensors():
    """An offset of 300 Pa, or other stamps, are no other run."""
    of = series(pressures=pressures(0.0, 5e4), whole=True)
    for other in (pressures(300.0, 50300.0), pressures(5e4, 0.0, start=100 * SECOND), None):
        assert not other_pressures(of, series(pressures=other, whole=True))

"""`replay --fuse`: a recording of readings and targets becomes one with all fused topics."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.files.model_file import load_model
from pneunet_ros.fusion.causes import ForceSensorCause
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.messages.builders import POSE_TYPE
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.point_cloud import cloud_points
from pneunet_ros.messages.readings import WRENCH_TYPE
from pneunet_ros.offline.fuse import fusion_steps, fusion_topics
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.refusals import refusal

RECORDING = share_path('bags/lab_day/heldout.mcap')
FRAMES = 160
KEPT = 40  # frames of a table


@pytest.fixture(scope='module')
def replayed(tmp_path_factory):
    """Return the path of the fused recording and the summary."""
    output = tmp_path_factory.mktemp('fused') / 'fused.mcap'
    words = ['replay', str(RECORDING), '--fuse', '--no-wrench', '--output', str(output), '--json']
    with pytest.MonkeyPatch.context() as patch:
        said = []
        patch.setattr('sys.stdout.write', said.append)
        assert main(words) == 0
    return output, json.loads(''.join(said))


def test_all_fused_topics_are_written_beside_the_inputs(replayed):
    output, summary = replayed
    recording = open_recording(output)
    names = {f'/pneunet/{item.name}' for item in FUSION_OUTPUTS}
    assert names == {f'/pneunet/fused/{name}' for name in (
        'state', 'shape', 'tip', 'tip_jacobian', 'curvature', 'centerline',
        'end_wrench', 'end_force', 'contact', 'pressure_bias',
    )}  # fmt: skip
    assert all(recording.count([name]) == summary['estimates'] > 0 for name in names)
    assert summary['topics'].keys() == {'pressure', 'targets'}
    assert summary['std_leaves_out']
    assert summary['of_the_bench'] == {}
    assert summary['force_sensor'] is None
    assert recording.count(['/pneunet/targets']) == FRAMES


def test_diagnostics_are_those_of_the_node_once_a_second_and_at_the_end(replayed):
    output, summary = replayed
    reports = list(open_recording(output).messages(['/diagnostics']))
    times = [report.log_time_ns for report in reports]
    begin, end = open_recording(RECORDING).start_ns, open_recording(RECORDING).end_ns
    assert len(times) in ((end - begin) // 10**9, 1 + (end - begin) // 10**9)
    assert times[-1] > times[0]
    assert min(np.diff(times[:-1])) >= 10**9
    (status,) = reports[-1].message.status
    assert status.name.startswith('pneunet/fusion')
    values = {pair.key: pair.value for pair in status.values}
    assert values['mode'] == 'fused'
    assert values['estimates'] == str(summary['estimates'])
    assert float(values['nis_mean']) == pytest.approx(summary['nis'], rel=1e-3)
    assert values['std_leaves_out'] == summary['std_leaves_out']


@pytest.fixture(scope='module')
def beginning(tmp_path_factory):
    """Write the first half of the recording."""
    path, whole = tmp_path_factory.mktemp('half') / 'half.mcap', open_recording(RECORDING)
    middle = (whole.start_ns + whole.end_ns) // 2
    with write_recording(path) as writer:
        topics = {topic.name: writer.add_copy(topic) for topic in whole.topics}
        for message in whole.raw_messages(list(topics)):
            if message.log_time_ns < middle:
                writer.write_raw(topics[message.topic], message.log_time_ns, message.raw)
    return path


def test_a_force_sensor_of_the_wrong_sign_is_said_with_numbers(beginning, capsys):
    words = ['replay', str(beginning), '--fuse', '--wrench-sign', '-1']
    assert main([*words, '--json']) == 0
    summary = json.loads(capsys.readouterr().out)
    ((sentence, count),) = summary['of_the_bench'].items()
    assert sentence == ForceSensorCause.sentence
    assert 0 < count <= summary['estimates']
    read, said = summary['force_sensor']['reading'], summary['force_sensor']['targets']
    assert all(one * other < 0.0 for one, other in zip(read, said, strict=True))
    assert main(words) == 0
    shown = ' '.join(capsys.readouterr().out.split())
    assert 'give --wrench-sign 1' in shown
    assert f'{ForceSensorCause.sentence} (in {count} estimates)' in shown


def test_the_point_and_the_wrench_say_the_same(replayed):
    output, _ = replayed
    recording = open_recording(output)
    wrenches, points = (
        [item.message for item in recording.messages([f'/pneunet/fused/{name}'])]
        for name in ('end_wrench', 'end_force')
    )
    assert len(wrenches) == len(points)
    for wrench, cloud in zip(wrenches, points, strict=True):
        (point,) = cloud_points(cloud)
        force = wrench.wrench.force
        assert (point['fx'], point['fy']) == pytest.approx((force.x, force.y), nan_ok=True)
        known = not math.isnan(point['fx'])
        assert known == (point['cov_xx'] > 0.0)
        assert wrench.header.stamp == cloud.header.stamp
        assert point['mode'] in (0, 1, 2)


def test_what_is_written_is_what_the_step_gives(replayed):
    output, _ = replayed
    recording = open_recording(RECORDING)
    fusion = Fusion(arm=load_model(share_path('config/paper_arm.yaml')))
    topics = fusion_topics(recording, {}, wrench=False)
    steps = [step.outcome for step in fusion_steps(recording, fusion, topics)]
    estimates = [outcome for outcome in steps if isinstance(outcome, FusedEstimate)]
    biases = open_recording(output).messages(['/pneunet/fused/pressure_bias'])
    written = [(item.message.fluid_pressure, item.message.variance) for item in biases]
    assert written == [(one.pressure_bias, one.pressure_bias_std**2) for one in estimates]


def test_the_wrench_is_read_unless_it_is_not_wanted():
    recording = open_recording(RECORDING)
    with_wrench = fusion_topics(recording, {}, wrench=True)
    assert {sensor.name for sensor in with_wrench.values()} == {
        'pressure', 'targets', 'end_wrench',
    }  # fmt: skip


def keep_rows_of_frames(path):
    """Write a table anew: a row for each of the first frames, with the last readings."""
    with path.open(newline='') as file:
        head, *rows = csv.reader(file)
    last, kept = [''] * len(head), []
    for row in rows:
        last = [new or old for new, old in zip(row, last, strict=True)]
        if any(row[head.index('x0_m') :]):
            kept.append(last[: head.index('x0_m')] + row[head.index('x0_m') :])
    with path.open('w', newline='') as file:
        csv.writer(file).writerows([head, *kept[:KEPT]])


def test_of_readings_of_one_stamp_the_frame_comes_before_the_pressure(tmp_path):
    """A table has all that a row says at one stamp; nothing of it is left for the next row."""
    table, again = tmp_path / 'day.csv', tmp_path / 'again.mcap'
    assert main(['export', str(RECORDING), '--output', str(table)]) == 0
    keep_rows_of_frames(table)
    assert main(['import', str(table), '--output', str(again)]) == 0
    recording = open_recording(again)
    names = ('end_wrench', 'targets', 'pressure')
    order = [message.topic for message in recording.messages([f'/pneunet/{n}' for n in names])]
    assert order[:3] == [f'/pneunet/{name}' for name in names]
    fusion = Fusion(arm=load_model(share_path('config/paper_arm.yaml')))
    topics = fusion_topics(recording, {}, wrench=True)
    assert list(topics) == [f'/pneunet/{name}' for name in names]
    steps = [step.outcome for step in fusion_steps(recording, fusion, topics)]
    estimates = [one for one in steps if isinstance(one, FusedEstimate)]
    assert len(estimates) == KEPT == recording.count(['/pneunet/targets'])
    assert all(one.target_age == 0.0 for one in estimates)


@pytest.mark.parametrize(
    'options', [['--no-wrench'], ['--fuse', '--views'], ['--fuse', '--no-wrench-required']]
)
def test_an_option_of_the_other_replay_is_refused(capsys, options):
    words = ['replay', str(RECORDING), *options, '--json']
    assert refusal((main(words), *capsys.readouterr())) == 'exclusive'


def test_an_estimated_wrench_is_never_taken_for_one_that_was_read(replayed, capsys):
    output, _ = replayed
    recording = open_recording(output)
    assert recording.candidates('end_wrench', WRENCH_TYPE) == ()
    assert len(recording.candidates('tip', POSE_TYPE)) == 1
    said = main(['replay', str(output), '--json']), *capsys.readouterr()
    assert refusal(said) == 'no_topic'
    by_name = ['--topic', 'end_wrench=/pneunet/fused/end_wrench']
    assert main(['replay', str(output), *by_name]) == 0

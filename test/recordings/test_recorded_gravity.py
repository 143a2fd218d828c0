"""`base_imu` and frames in recordings: simulate, check, export, import, replay and calibrate."""

from __future__ import annotations

from dataclasses import replace
import json

import numpy as np
from pneunet_ros import save_model
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.frames import BASE_FRAME, quaternion_of_angles, rotation_matrix
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import STANDARD_GRAVITY
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.motion import LabMotion
from pneunet_ros.lab.sensors import LabNoise, noiseless, Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.messages.base_frames import imu_message, TRANSFORM_TYPE
from pneunet_ros.messages.builders import header
from pneunet_ros.messages.readings import BASE_IMU, FIXED_FRAMES, FRAMES
from pneunet_ros.model.gravity import gravity_of
from pneunet_ros.offline.judge import judge_recording
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.lab_files import write_lab
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recorded_gravity import read_gravity
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.lab_run import true_model
from support.refusals import refused

G = STANDARD_GRAVITY
MS = 1_000_000
TURN = LabMotion(gravity_y=-1.0, turn_angle=(0.0, 1.0), shift_y=(0.0, 1.6), inertia=0.0)
AS_SHIPPED = EstimatorSettings()
AS_MODEL = gravity_of('out_of_plane')


def scenario(**changes):
    """Return four seconds of an unloaded arm on a base that turns."""
    found = load_scenario(share_path('scenarios/unloaded_ramp.yaml'))
    protocol = replace(found.protocol, duration=4.0, rest=0.5)
    given = {'motion': TURN, 'rates': Rates(imu=100.0), 'noise': noiseless(), **changes}
    return replace(found, protocol=protocol, **given)


def written(folder, **changes):
    """Return the file of such a recording, and its scenario."""
    recording = simulate(scenario(**changes))
    write_lab(recording, folder / 'turning.mcap', overwrite=True, on_progress=lambda: None)
    return folder / 'turning.mcap', recording


def with_messages(path, messages):
    """Write messages (log ms, input, message), and nothing else."""
    with write_recording(path, overwrite=True) as writer:
        topics = {}
        for at, sensor, message in messages:
            name = sensor.topic if sensor.shared else f'/pneunet/{sensor.name}'
            topics.setdefault(name, writer.add(name, sensor.type)) if name not in topics else None
            writer.write(topics[name], at * MS, message)
    return open_recording(path)


def imu(at, x, y, z, frame_id=BASE_FRAME):
    """Return a message of an accelerometer at a time (ms)."""
    return at, BASE_IMU, imu_message(at * MS, np.array([x, y, z, np.nan]), frame_id, ROSBAGS_TYPES)


def frame(at, child, parent, angles, sensor):
    """Return a message of a frame at a time (ms)."""
    types, axes = ROSBAGS_TYPES, zip('xyzw', quaternion_of_angles(*angles), strict=True)
    transform = types('geometry_msgs/msg/Transform')(
        translation=types('geometry_msgs/msg/Vector3')(x=0.0, y=0.0, z=0.0),
        rotation=types('geometry_msgs/msg/Quaternion')(**dict(axes)),
    )
    stamped = types('geometry_msgs/msg/TransformStamped')(
        header=header(at * MS, parent, types), child_frame_id=child, transform=transform
    )
    return at, sensor, types(TRANSFORM_TYPE)(transforms=[stamped])


def test_the_lab_records_what_an_accelerometer_on_its_base_reads(tmp_path):
    path, recording = written(tmp_path)
    found = read_gravity(open_recording(path), {}, AS_SHIPPED, AS_MODEL)
    time = (found.stamp_ns - found.stamp_ns[0]) * 1e-9
    felt = TURN.apparent_gravity(time, 4.0)[:, :2] / G
    assert found.direction == pytest.approx(felt, abs=1e-7)
    assert np.ptp(found.direction[:, 0]) > 0.5
    # The base is pushed upwards, and then held.
    assert np.abs(np.hypot(*found.direction.T) - 1.0).max() > 0.02
    run, _ = read_run(path, recording.x.shape[1])
    shown = (run.stamp_ns - recording.imu_stamp_ns[0]) * 1e-9
    assert run.gravity == pytest.approx(TURN.apparent_gravity(shown, 4.0)[:, :2] / G, abs=2e-4)
    later = run.at_instants(0.1)
    assert later.gravity == pytest.approx(
        TURN.apparent_gravity(shown - 0.1, 4.0)[:, :2] / G, abs=1e-2
    )
    assert len(run.thin(5).gravity) == 5


def test_replay_follows_a_base_that_turns(tmp_path, capsys):
    path, recording = written(tmp_path, noise=LabNoise())
    model = tmp_path / 'model.yaml'
    save_model(true_model(recording.scenario), model)
    command = ['replay', str(path), '--model', str(model), '--no-wrench-required', '--json']
    out = tmp_path / 'out.mcap'
    off = {}
    for name, more in (('imu', []), ('fixed', ['--gravity=0,-1'])):
        assert main([*command, '--output', str(out), '--overwrite', *more]) == 0
        capsys.readouterr()
        truth = str(tmp_path / 'turning.truth.npz')
        assert main(['compare', str(out), truth, '--json']) == 0
        off[name] = json.loads(capsys.readouterr().out)
    medians = {name: said['comparisons'][0]['tip']['median'] for name, said in off.items()}
    assert medians['imu'] < 5e-4
    assert medians['fixed'] > 5e-3


@pytest.mark.parametrize('measured', [True, False], ids=['measured', 'unknown'])
def test_a_right_force_sensor_is_not_accused_of_the_weight(tmp_path, measured):
    given = load_scenario(share_path('scenarios/random_mix.yaml'))
    lab = replace(
        given,
        protocol=replace(given.protocol, duration=20.0),
        motion=LabMotion(gravity_y=-1.0, inertia=0.0),
        rates=Rates(frames=10.0, imu=20.0 if measured else 0.0),
    )
    write_lab(simulate(lab), tmp_path / 'mix.mcap', overwrite=True, on_progress=lambda: None)
    arm = replace(true_model(lab), gravity=gravity_of('imu'))
    found = judge_recording(open_recording(tmp_path / 'mix.mcap'), arm, AS_SHIPPED, {})
    assert (found.wrench is not None) == measured
    assert not found.contradicted


def test_a_table_keeps_it(tmp_path):
    path, _ = written(tmp_path)
    table, again = tmp_path / 'table.csv', tmp_path / 'again.mcap'
    assert main(['export', str(path), '--output', str(table), '--json']) == 0
    head = table.read_text().splitlines()[0].split(',')
    assert {'imu_ax_m_s2', 'imu_ay_m_s2', 'imu_az_m_s2'} <= set(head)
    text = table.read_text().replace('imu_ax_m_s2', 'Imu-aX [m/s²]')
    table.write_text(text.replace('imu_ay_m_s2', 'imu_ay (m/s^2)'))
    assert main(['import', str(table), '--output', str(again), '--json']) == 0
    one, other = (
        read_gravity(open_recording(item), {}, AS_SHIPPED, AS_MODEL) for item in (path, again)
    )
    assert other.direction == pytest.approx(one.direction, rel=1e-9)
    assert np.array_equal(one.stamp_ns, other.stamp_ns)


def test_an_accelerometer_in_a_frame_of_its_own_is_turned(tmp_path):
    angles = (0.2, 0.1, -2.0)
    back = rotation_matrix(quaternion_of_angles(*angles)).T
    read = (back @ np.array([0.0, G, 0.0])).tolist()
    recording = with_messages(
        tmp_path / 'own.mcap',
        [
            frame(1, 'imu_link', BASE_FRAME, angles, FIXED_FRAMES),
            *(imu(at, *read, frame_id='imu_link') for at in (2, 3, 4)),
        ],
    )
    found = read_gravity(recording, {}, AS_SHIPPED, AS_MODEL)
    assert found.direction == pytest.approx(np.tile([0.0, -1.0], (3, 1)), abs=1e-12)
    table = tmp_path / 'own.csv'
    assert main(['export', str(tmp_path / 'own.mcap'), '--output', str(table), '--json']) == 0
    row = dict(zip(*(line.split(',') for line in table.read_text().splitlines()[:2]), strict=True))
    assert float(row['imu_ay_m_s2']) == pytest.approx(G)


def test_a_frame_that_is_said_once_holds_for_ever(tmp_path):
    up = frame(1, BASE_FRAME, 'world', (np.pi / 2, 0.0, 0.0), FIXED_FRAMES)
    recording = with_messages(tmp_path / 'still.mcap', [up])
    by_world = replace(AS_SHIPPED, gravity_frame='world')
    found = read_gravity(recording, {}, by_world, AS_MODEL)
    assert found.direction == pytest.approx(np.array([[0.0, -1.0]]), abs=1e-12)
    assert found.is_known(np.array([3600 * 1000 * MS])).all()
    moving = [
        frame(at, BASE_FRAME, 'world', (np.pi / 2, 0.0, 1e-3 * at), FRAMES) for at in (1, 2, 3)
    ]
    turning = with_messages(tmp_path / 'turning_frames.mcap', moving)
    found = read_gravity(turning, {}, AS_SHIPPED, gravity_of('world'))
    assert found.stamp_ns.tolist() == [1 * MS, 2 * MS, 3 * MS]
    assert not found.is_known(np.array([3600 * 1000 * MS])).any()


@pytest.mark.parametrize(
    ('messages', 'words'),
    [
        ([imu(at, 0.0, 1.0, 0.0) for at in (1, 2)], ' g'),
        ([imu(at, 0.0, 0.0, 0.0) for at in (1, 2)], 'gravity'),
        ([imu(at, 0.0, G, 0.0, frame_id='imu_link') for at in (1, 2)], "'imu_link'"),
        ([imu(1, np.nan, G, 0.0)], 'NaN'),
    ],
)
def test_what_is_no_gravity_is_said_by_all_who_ask_for_it(tmp_path, messages, words, capsys):
    path = tmp_path / 'bad.mcap'
    recording = with_messages(path, messages)
    with refused(RecordingError, 'no_gravity'):
        read_gravity(recording, {}, AS_SHIPPED, AS_MODEL)
    assert read_gravity(recording, {}, AS_SHIPPED, gravity_of([0.0, -1.0], fixed=True)) is None
    assert main(['check', str(path), '--json']) == 0
    said = json.loads(capsys.readouterr().out)
    assert any(words in sentence for sentence in said['recordings'][0]['sentences'])


def test_a_bad_reading_among_good_ones_is_counted(tmp_path):
    good = [imu(at, 0.0, G, 0.0) for at in (1, 2, 4)]
    recording = with_messages(tmp_path / 'some.mcap', [*good[:2], imu(3, 0.0, 1.0, 0.0), good[2]])
    found = read_gravity(recording, {}, AS_SHIPPED, AS_MODEL)
    assert len(found.stamp_ns) == 3
    assert len(found.sentences) == 1
    assert 'imu_unit' in found.sentences[0]


def test_a_model_that_needs_an_accelerometer_says_so(tmp_path):
    recording = with_messages(tmp_path / 'none.mcap', [imu(1, 0.0, G, 0.0)])
    without = with_messages(
        tmp_path / 'other.mcap', [frame(1, 'a', 'b', (0.0, 0.0, 0.0), FIXED_FRAMES)]
    )
    assert read_gravity(recording, {}, AS_SHIPPED, gravity_of('imu')) is not None
    with refused(RecordingError, 'no_gravity'):
        read_gravity(without, {}, AS_SHIPPED, gravity_of('imu'))
    with refused(RecordingError, 'no_gravity'):
        read_gravity(without, {}, AS_SHIPPED, gravity_of('world'))


def test_the_fusion_follows_a_base_that_turns(tmp_path, capsys):
    rates = Rates(imu=100.0, pressure=25.0, frames=5.0)
    path, recording = written(tmp_path, noise=LabNoise(), rates=rates)
    model = tmp_path / 'model.yaml'
    save_model(true_model(recording.scenario), model)
    command = ['replay', '--fuse', str(path), '--model', str(model), '--json', '--overwrite']
    medians = {}
    for name, more in (('imu', []), ('fixed', ['--gravity=out_of_plane'])):
        out = tmp_path / f'{name}.mcap'
        assert main([*command, '--output', str(out), *more]) == 0
        capsys.readouterr()
        truth = str(tmp_path / 'turning.truth.npz')
        topic = ['--topic', 'tip=/pneunet/fused/tip', '--topic', 'shape=/pneunet/fused/shape']
        assert main(['compare', str(out), truth, '--json', *topic]) == 0
        tip = json.loads(capsys.readouterr().out)['comparisons'][0]['tip']
        medians[name] = tip['median']
    assert medians['imu'] < min(6e-4, 0.5 * medians['fixed'])


def test_a_prediction_without_readings_asks_where_gravity_points(tmp_path, capsys):
    model = tmp_path / 'turning.yaml'
    save_model(replace(true_model(scenario()), gravity=gravity_of('imu')), model)
    command = ['predict', '--pressure', '20kPa', '--model', str(model), '--json']
    assert main(command) == 2
    assert '--gravity' in capsys.readouterr().err
    assert main([*command, '--gravity=0,-1']) == 0


def test_after_a_jump_back_in_time_the_longest_stretch_counts_as_of_the_readings(tmp_path):
    messages = []
    for count, force in ((25, (0.0, G, 0.0)), (40, (G, 0.0, 0.0))):
        for step in range(count):
            message = imu_message(
                (1000 + 100 * step) * MS, np.array([*force, np.nan]), BASE_FRAME, ROSBAGS_TYPES
            )
            messages.append((len(messages), BASE_IMU, message))
    with_messages(tmp_path / 'jump.mcap', messages)
    read = read_gravity(open_recording(tmp_path / 'jump.mcap'), {}, AS_SHIPPED, gravity_of('imu'))
    assert read.at(np.array([1500 * MS])) == pytest.approx(np.array([[-1.0, 0.0]]))

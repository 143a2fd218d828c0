"""Replay: a recording of readings becomes one with all topics of the estimator beside them."""

from __future__ import annotations

import numpy as np
from pneunet_ros.core.arrays import same_values
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.health import Level
from pneunet_ros.core.outcome import Refusal
from pneunet_ros.core.share import share_path
from pneunet_ros.core.stamps import LATEST_STAMP
from pneunet_ros.estimation.estimate import ShapeEstimate
from pneunet_ros.estimation.estimator import Estimator
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.estimation.state import EstimatorState
from pneunet_ros.files.model_file import load_model, model_label
from pneunet_ros.messages.builders import nanoseconds, POINTS_TYPE
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import (
    PRESSURE_TYPE,
    SENSORS,
    TARGETS,
    targets_message,
    WRENCH_TYPE,
)
from pneunet_ros.model.equilibrium import solve
from pneunet_ros.offline.replay import (
    estimate_topic,
    input_topics,
    record_steps,
    steps,
    Tally,
    targets_topic,
)
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.made_recordings import PRESSURE, pressure, STEP_NS, WRENCH, wrench
from support.random_estimates import plain
from support.refusals import refused

ESTIMATOR = Estimator(arm=load_model(share_path('config/paper_arm.yaml')))
TYPES = {'end_wrench': WRENCH_TYPE, 'pressure': PRESSURE_TYPE, 'targets': POINTS_TYPE}
LATE_NS = 3_000_000  # from a stamp to its log time
PRESSURES = [20e3, 21e3, 150e3, 22e3, float('nan'), 23e3, 24e3]  # two of them are refused
REFUSED = {2: 'out_of_range', 4: 'not_finite'}

READ = [
    sensor for sensor in SENSORS if sensor.needed(EstimatorSettings()) and sensor is not TARGETS
]


def stamp_of(index: int) -> int:
    return (index + 1) * STEP_NS


def record(path, readings) -> None:
    """Write (topic, log time, message) as they come."""
    with write_recording(path) as writer:
        connections = {}
        for topic, log_time, message in readings:
            if topic not in connections:
                connections[topic] = writer.add(topic, TYPES[topic.rsplit('/', 1)[-1]])
            writer.write(connections[topic], log_time, message)


def readings(namespace: str = '/pneunet'):
    """Pressures and, at the same log times but written after them, wrenches."""
    for index, value in enumerate(PRESSURES):
        stamp = stamp_of(index)
        yield f'{namespace}/pressure', stamp + LATE_NS, pressure(stamp, value)
        yield f'{namespace}/end_wrench', stamp + LATE_NS, wrench(stamp, 0.1 + 0.01 * index)


def replayed(source, target, estimator=ESTIMATOR) -> list:
    """Replay one file into another; returns the steps."""
    recording = open_recording(source)
    topics = input_topics(recording, estimator, {})
    seen = []
    with write_recording(target) as writer:
        record_steps(writer, recording, estimator, topics, seen.append)
    return seen


@pytest.fixture(scope='module')
def replay(tmp_path_factory):
    """Return the recording that was read, the one that was written, and the steps between."""
    folder = tmp_path_factory.mktemp('replay')
    record(folder / 'in.mcap', readings())
    seen = replayed(folder / 'in.mcap', folder / 'out.mcap')
    return open_recording(folder / 'in.mcap'), open_recording(folder / 'out.mcap'), seen


@pytest.fixture(scope='module')
def estimates(replay):
    """List the estimates with the log times of their readings."""
    return [
        (step.message.log_time_ns, step.outcome)
        for step in replay[2]
        if isinstance(step.outcome, ShapeEstimate)
    ]


def written(replay, name: str) -> list:
    """List all messages of an output topic."""
    return list(replay[1].messages([f'/pneunet/{name}']))


def test_the_outputs_stand_beside_the_inputs(replay, estimates):
    count = {topic.name: (topic.type, topic.count) for topic in replay[1].topics}
    inputs = {f'/pneunet/{item.name}': (item.type, len(PRESSURES)) for item in READ}
    outputs = {f'/pneunet/{item.name}': (item.type, len(estimates)) for item in OUTPUTS}
    reports = {'/diagnostics': ('diagnostic_msgs/msg/DiagnosticArray', 1)}  # at the end
    assert count == inputs | outputs | reports
    assert len(estimates) == len(PRESSURES) - len(REFUSED)


def test_diagnostics_say_what_was_refused_at_the_last_log_time(replay):
    (report,) = replay[1].messages(['/diagnostics'])
    (status,) = report.message.status
    assert status.name.startswith('pneunet/estimator')
    assert status.level == Level.ERROR
    values = {pair.key: pair.value for pair in status.values}
    assert {name: values[f'rejected/{name}'] for name in REFUSED.values()} == dict.fromkeys(
        REFUSED.values(), '1'
    )
    assert values['estimates'] == str(len(PRESSURES) - len(REFUSED))
    assert values['latency_p99_s'] == ''  # nobody waited
    assert report.log_time_ns == stamp_of(len(PRESSURES) - 1) + LATE_NS


def test_the_inputs_are_copied_bit_by_bit(replay):
    source, target, _ = replay
    both = [WRENCH, PRESSURE]
    assert list(target.raw_messages(both)) == list(source.raw_messages(both))
    assert target.topic(PRESSURE) == source.topic(PRESSURE)


def test_of_equal_log_times_the_wrench_comes_first(replay):
    topics = [step.message.topic for step in replay[2]]
    assert topics == len(PRESSURES) * [WRENCH, PRESSURE]
    forces = [
        step.outcome.shape.force[0]
        for step in replay[2]
        if isinstance(step.outcome, ShapeEstimate)
    ]
    assert forces == [0.1 + 0.01 * index for index in range(7) if index not in REFUSED]


def test_outputs_have_the_stamps_and_log_times_of_the_pressure_readings(replay):
    good = [index for index in range(len(PRESSURES)) if index not in REFUSED]
    for output in OUTPUTS:
        messages = written(replay, output.name)
        assert [item.log_time_ns for item in messages] == [stamp_of(i) + LATE_NS for i in good]
        if hasattr(messages[0].message, 'header'):
            headers = [item.message.header for item in messages]
            assert [head.stamp.nanosec for head in headers] == [stamp_of(i) for i in good]
            assert {head.frame_id for head in headers} == {'pneunet_base'}


def test_readings_that_are_refused_write_nothing(replay):
    refused = {step.message.log_time_ns: step.outcome for step in replay[2]
               if isinstance(step.outcome, Refusal)}  # fmt: skip
    assert {time: refusal.reason for time, refusal in refused.items()} == {
        stamp_of(index) + LATE_NS: reason for index, reason in REFUSED.items()
    }
    for output in OUTPUTS:
        assert not {item.log_time_ns for item in written(replay, output.name)} & set(refused)


def test_what_is_written_is_the_plain_message_of_the_estimators_step(replay):
    decoders = {f'/pneunet/{item.name}': item.decode for item in READ}
    state, expected = EstimatorState(), []
    for message in replay[0].messages([WRENCH, PRESSURE]):
        state, outcome = ESTIMATOR.step(state, decoders[message.topic](message.message))
        if isinstance(outcome, ShapeEstimate):
            expected.append(outcome)
    assert len(expected) == 5
    for output in OUTPUTS:
        messages = [plain(item.message) for item in written(replay, output.name)]
        made = [
            plain(output.encode(estimate, 'pneunet_base', ROSBAGS_TYPES)) for estimate in expected
        ]
        assert messages == made, output.name


def test_two_replays_are_equal_bit_for_bit(replay, tmp_path):
    source, first, seen = replay
    again = replayed(source.path, tmp_path / 'again.mcap')
    second = open_recording(tmp_path / 'again.mcap')
    names = [topic.name for topic in first.topics]
    assert list(first.raw_messages(names)) == list(second.raw_messages(names))
    for one, other in zip(seen, again, strict=True):
        assert same_values(one.outcome, other.outcome)


def test_outputs_are_in_the_namespace_of_the_pressure(tmp_path):
    record(tmp_path / 'in.mcap', readings('/left/arm'))
    replayed(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    names = {topic.name for topic in open_recording(tmp_path / 'out.mcap').topics}
    own = {f'/left/arm/{item.name}' for item in (*READ, *OUTPUTS)}
    assert names == {*own, '/diagnostics'}


@pytest.mark.parametrize(
    ('namespace', 'name', 'hardware'),
    [
        ('/left/arm', 'left/arm/estimator: shape', 'left/arm'),
        ('', 'estimator: shape', 'estimator'),
    ],
)
def test_a_status_has_name_and_hardware_of_the_node(tmp_path, namespace, name, hardware):
    record(tmp_path / 'in.mcap', readings(namespace))
    replayed(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    (report,) = open_recording(tmp_path / 'out.mcap').messages(['/diagnostics'])
    (status,) = report.message.status
    assert (status.name, status.hardware_id) == (name, hardware)
    assert {pair.key: pair.value for pair in status.values}['model'] == model_label(ESTIMATOR.arm)


def test_a_log_time_that_no_stamp_can_hold_does_not_end_a_replay(tmp_path):
    """The seconds of a stamp end in January 2038, log times in 2262."""
    later = 2 * LATEST_STAMP
    record(tmp_path / 'in.mcap', [(topic, later + time, item) for topic, time, item in readings()])
    replayed(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    (report,) = open_recording(tmp_path / 'out.mcap').messages(['/diagnostics'])
    assert nanoseconds(report.message.header.stamp) == LATEST_STAMP - 1
    assert report.log_time_ns == later + stamp_of(len(PRESSURES) - 1) + LATE_NS


def test_a_topic_without_namespace_stays_without():
    assert estimate_topic('/pressure', 'tip') == '/tip'


def test_readings_follow_their_log_time_not_their_place_in_the_file(tmp_path):
    record(tmp_path / 'in.mcap', reversed(list(readings())))
    forth = replayed(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    stamps = [step.message.log_time_ns for step in forth]
    assert stamps == sorted(stamps)
    assert sum(isinstance(step.outcome, ShapeEstimate) for step in forth) == 5


@pytest.mark.parametrize('unit_ns', [5 * STEP_NS, 10**12])
def test_messages_of_one_log_time_follow_their_stamps(tmp_path, unit_ns):
    record(tmp_path / 'fine.mcap', readings())
    coarse = [
        (topic, log_time // unit_ns * unit_ns, message) for topic, log_time, message in readings()
    ]
    record(tmp_path / 'coarse.mcap', coarse)
    outcomes = [
        [step.outcome for step in replayed(path, path.with_suffix('.out.mcap'))]
        for path in (tmp_path / 'fine.mcap', tmp_path / 'coarse.mcap')
    ]
    tips = [
        [(one.stamp_ns, *one.shape.tip) for one in some if isinstance(one, ShapeEstimate)]
        for some in outcomes
    ]
    assert tips[0] == tips[1]
    assert len(tips[0]) == len(PRESSURES) - len(REFUSED)


def test_a_message_that_is_no_reading_is_counted_and_the_replay_goes_on(tmp_path):
    spoiled = list(readings())
    spoiled[2][2].header.stamp.nanosec = 2_000_000_000
    record(tmp_path / 'in.mcap', spoiled)
    seen = replayed(tmp_path / 'in.mcap', tmp_path / 'out.mcap')
    refusal = seen[2].outcome
    assert (refusal.reason, refusal.error) == ('unreadable', False)
    assert 'nanosec = 2000000000' in refusal.sentence
    assert seen[-1].state.rejected['unreadable'] == 1
    assert seen[-1].state.estimates == 4


def test_an_unloaded_replay_reads_the_pressure_alone(tmp_path):
    record(tmp_path / 'in.mcap', [item for item in readings() if item[0] == PRESSURE])
    with refused(RecordingError, 'no_topic'):
        input_topics(open_recording(tmp_path / 'in.mcap'), ESTIMATOR, {})
    unloaded = Estimator(arm=ESTIMATOR.arm, settings=EstimatorSettings(wrench_required=False))
    seen = replayed(tmp_path / 'in.mcap', tmp_path / 'out.mcap', unloaded)
    assert seen[-1].outcome.shape.force == (0.0, 0.0)


def test_a_tally_counts_what_the_steps_say(replay):
    tally = Tally()
    for step in replay[2]:
        tally.count(step, PRESSURE)
    assert (tally.messages, tally.pressures) == (2 * len(PRESSURES), len(PRESSURES))
    assert dict(tally.state.rejected) == {'out_of_range': 1, 'not_finite': 1}
    assert tally.last is replay[2][-1].outcome
    assert tally.refusal.reason == 'not_finite'
    assert 0.0 < tally.worst_residual < 1e-6


# Measured targets


TARGETS = '/pneunet/targets'


def with_targets(moved=0.0, count=23):
    """Forty readings of a steady load, and targets where the model has them, but for a lift."""
    arm = ESTIMATOR.arm
    shape = solve(arm, pressure=30e3, force=(0.1, 0.0), stations=2241)  # 0.05 mm apart
    x, y = (np.interp(arm.target_arclength, shape.arclength, row) for row in (shape.x, shape.y))
    for index in range(40):
        stamp = stamp_of(index)
        yield '/pneunet/end_wrench', stamp, wrench(stamp, 0.1)
        yield PRESSURE, stamp, pressure(stamp, 30e3)
        shown = targets_message(stamp, x[:count], y[:count] + moved, 'pneunet_base', ROSBAGS_TYPES)
        yield TARGETS, stamp + LATE_NS, shown


def watched_replay(folder, said, settings=None):
    """Replay with the consistency monitor; returns the tally and the recording written."""
    record(folder / 'in.mcap', said)
    recording = open_recording(folder / 'in.mcap')
    estimator = Estimator(arm=ESTIMATOR.arm, settings=settings or EstimatorSettings())
    topics, tally = input_topics(recording, estimator, {}), Tally()
    targets = targets_topic(recording, estimator, {})
    with write_recording(folder / 'out.mcap') as writer:
        record_steps(
            writer, recording, estimator, topics, lambda step: tally.count(step, PRESSURE),
            targets=targets,
        )  # fmt: skip
    return tally, open_recording(folder / 'out.mcap')


def test_targets_where_they_must_be_are_no_news(tmp_path):
    tally, written = watched_replay(tmp_path, with_targets())
    assert tally.consistency.matched == 40
    assert tally.disagreement.rms < 0.2
    assert not tally.disagreement.beyond
    source = open_recording(tmp_path / 'in.mcap')
    assert list(written.raw_messages([TARGETS])) == list(source.raw_messages([TARGETS]))
    assert tally.pressures == tally.state.estimates == 40


def test_targets_elsewhere_are_told_of(tmp_path):
    tally, _ = watched_replay(tmp_path, with_targets(moved=5e-3))
    assert tally.disagreement.beyond


def test_targets_of_another_arm_are_refused_and_the_replay_goes_on(tmp_path):
    tally, _ = watched_replay(tmp_path, with_targets(count=3))
    assert tally.refusal.reason == 'unreadable'
    assert '3 points' in tally.refusal.sentence
    assert dict(tally.consistency.unmatched) == {'unreadable': 40}
    assert tally.state.estimates == 40


def test_targets_can_be_left_alone(tmp_path):
    settings = EstimatorSettings(watch_targets=False)
    tally, written = watched_replay(tmp_path, with_targets(), settings)
    assert tally.disagreement is None
    assert TARGETS not in {topic.name for topic in written.topics}


# What a reader of the topics finds


def test_curvature_is_five_rows_over_the_stations(replay, estimates):
    for item, (_, estimate) in zip(written(replay, 'curvature'), estimates, strict=True):
        field, station = item.message.layout.dim
        assert (field.label, field.size, field.stride) == ('field', 5, 5 * 57)
        assert (station.label, station.size, station.stride) == ('station', 57, 57)
        rows = item.message.data.reshape(5, 57)
        shape = estimate.shape
        expected = (shape.arclength, shape.curvature, shape.intrinsic_curvature, shape.moment)
        np.testing.assert_array_equal(rows, [*expected, estimate.std_curvature])


def test_the_jacobian_is_three_rows_of_four(replay, estimates):
    for item, (_, estimate) in zip(written(replay, 'tip_jacobian'), estimates, strict=True):
        assert [dim.size for dim in item.message.layout.dim] == [3, 4]
        assert [dim.stride for dim in item.message.layout.dim] == [12, 4]
        np.testing.assert_array_equal(item.message.data.reshape(3, 4), estimate.jacobian)


def test_the_tip_is_a_pose_whose_covariance_is_that_of_x_y_and_the_turn_about_z(replay, estimates):
    for item, (_, estimate) in zip(written(replay, 'tip'), estimates, strict=True):
        pose = item.message.pose.pose
        x, y, theta = estimate.shape.tip
        assert (pose.position.x, pose.position.y, pose.position.z) == (x, y, 0.0)
        turn = 2.0 * np.arctan2(pose.orientation.z, pose.orientation.w)
        assert turn == pytest.approx(theta, abs=1e-12)
        covariance = item.message.pose.covariance.reshape(6, 6)
        planar = [0, 1, 5]
        np.testing.assert_array_equal(covariance[np.ix_(planar, planar)], estimate.tip_covariance)
        assert not covariance[2:5].any()
        assert not covariance[:, 2:5].any()


def test_the_centerline_is_a_pose_per_station(replay, estimates):
    for item, (_, estimate) in zip(written(replay, 'centerline'), estimates, strict=True):
        poses = [stamped.pose for stamped in item.message.poses]
        np.testing.assert_array_equal([pose.position.x for pose in poses], estimate.shape.x)
        np.testing.assert_array_equal([pose.position.y for pose in poses], estimate.shape.y)
        turns = [2.0 * np.arctan2(pose.orientation.z, pose.orientation.w) for pose in poses]
        np.testing.assert_allclose(turns, estimate.shape.theta, atol=1e-12)


def test_the_shape_is_a_point_cloud_of_all_that_is_known_of_each_station(replay, estimates):
    float32, float64 = 7, 8  # of PointField
    for item, (_, estimate) in zip(written(replay, 'shape'), estimates, strict=True):
        cloud, shape = item.message, estimate.shape
        kinds = {field.name: field.datatype for field in cloud.fields}
        assert kinds == dict.fromkeys('xyz', float32) | dict.fromkeys(
            ('s', 'theta', 'kappa', 'kappa0', 'moment', 'std_x', 'std_y'), float64
        )
        assert (cloud.height, cloud.width) == (1, 57)
        points = np.ndarray(
            57,
            np.dtype(
                {
                    'names': list(kinds),
                    'formats': [{float32: '<f4', float64: '<f8'}[kind] for kind in kinds.values()],
                    'offsets': [field.offset for field in cloud.fields],
                    'itemsize': cloud.point_step,
                }
            ),
            cloud.data.tobytes(),
        )
        for name, expected in (
            ('x', shape.x.astype(np.float32)),
            ('y', shape.y.astype(np.float32)),
            ('z', np.zeros(57)),
            ('s', shape.arclength),
            ('theta', shape.theta),
            ('kappa', shape.curvature),
            ('kappa0', shape.intrinsic_curvature),
            ('moment', shape.moment),
            ('std_x', estimate.std_x),
            ('std_y', estimate.std_y),
        ):
            np.testing.assert_array_equal(points[name], expected, err_msg=name)


def test_every_compared_frame_counts_once():
    recording = open_recording(share_path('bags/lab_day/heldout.mcap'))
    targets = targets_topic(recording, ESTIMATOR, {})
    tally = Tally()
    assert tally.agreement(ESTIMATOR.arm) is None
    for step in steps(recording, ESTIMATOR, input_topics(recording, ESTIMATOR, {}), targets):
        tally.count(step, '/pneunet/pressure')
    assert len(tally.compared) == tally.consistency.matched > 100
    assert tally.agreement(ESTIMATOR.arm).frames == len(tally.compared)

"""Messages of both bindings: what is read, what is published, and that live and replay agree."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.messages.builders import Input, Output
from pneunet_ros.messages.estimate import OUTPUTS, STATE_POINT
from pneunet_ros.messages.readings import (
    decode_pressure,
    decode_wrench,
    PRESSURE_TYPE,
    SENSORS,
    WRENCH_TYPE,
)
from pneunet_ros.recordings.message_store import deserialize, jazzy, ROSBAGS_TYPES, serialize
import pytest
from support.random_estimates import plain, random_estimate, rclpy_class, RclpyTypes
from support.refusals import refused

FRAME = 'pneunet_base'
OUTPUT = {output.name: output for output in OUTPUTS}


@pytest.fixture(
    params=[
        pytest.param(ROSBAGS_TYPES, id='rosbags'),
        pytest.param(RclpyTypes(), id='rclpy', marks=pytest.mark.ros),
    ]
)
def types(request):
    return request.param


def header(types, sec=3, nanosec=250_000_001, frame_id='sensor'):
    stamp = types('builtin_interfaces/msg/Time')(sec=sec, nanosec=nanosec)
    return types('std_msgs/msg/Header')(stamp=stamp, frame_id=frame_id)


def pressure_message(types, pressure=31e3, variance=0.0, **stamp):
    return types(PRESSURE_TYPE)(
        header=header(types, **stamp), fluid_pressure=pressure, variance=variance
    )


def wrench_message(types, force=(0.175, 0.07, 9.0), torque=(8.0, 7.0, 1e-3)):
    vector = types('geometry_msgs/msg/Vector3')
    return types(WRENCH_TYPE)(
        header=header(types, frame_id='load_cell'),
        wrench=types('geometry_msgs/msg/Wrench')(
            force=vector(x=force[0], y=force[1], z=force[2]),
            torque=vector(x=torque[0], y=torque[1], z=torque[2]),
        ),
    )


# ---- the table ----------------------------------------------------------------------------------


def test_topics_are_those_of_the_contract():
    assert [(topic.name, topic.type, topic.direction) for topic in (*SENSORS, *OUTPUTS)] == [
        ('pressure', 'sensor_msgs/msg/FluidPressure', 'in'),
        ('end_wrench', 'geometry_msgs/msg/WrenchStamped', 'in'),
        ('targets', 'sensor_msgs/msg/PointCloud2', 'in'),
        ('tip_pose', 'geometry_msgs/msg/PoseStamped', 'in'),
        ('base_imu', 'sensor_msgs/msg/Imu', 'in'),
        ('state', 'sensor_msgs/msg/PointCloud2', 'out'),
        ('centerline', 'nav_msgs/msg/Path', 'out'),
        ('curvature', 'std_msgs/msg/Float64MultiArray', 'out'),
        ('shape', 'sensor_msgs/msg/PointCloud2', 'out'),
        ('tip', 'geometry_msgs/msg/PoseWithCovarianceStamped', 'out'),
        ('tip_jacobian', 'std_msgs/msg/Float64MultiArray', 'out'),
    ]
    assert all(isinstance(topic, Input) for topic in SENSORS)
    assert all(isinstance(topic, Output) for topic in OUTPUTS)


def test_every_type_of_the_table_is_known_to_recordings():
    assert {topic.type for topic in (*SENSORS, *OUTPUTS)} <= jazzy().fielddefs.keys()


# ---- readings -----------------------------------------------------------------------------------


def test_a_pressure_message_is_a_reading(types):
    reading = decode_pressure(pressure_message(types, pressure=31e3, variance=3600.0))
    assert reading == PressureReading(stamp_ns=3_250_000_001, pressure=31e3, variance=3600.0)
    assert type(reading.stamp_ns) is int
    assert type(reading.pressure) is float


def test_a_wrench_message_is_a_reading_with_what_is_out_of_the_plane(types):
    assert decode_wrench(wrench_message(types)) == WrenchReading(
        stamp_ns=3_250_000_001,
        force_x=0.175,
        force_y=0.07,
        moment=1e-3,
        force_z=9.0,
        moment_x=8.0,
        moment_y=7.0,
        frame_id='load_cell',
    )


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf])
def test_values_that_are_no_numbers_are_passed_on(types, value):
    pressure = decode_pressure(pressure_message(types, pressure=value)).pressure
    force = decode_wrench(wrench_message(types, force=(value, 0.0, 0.0))).force_x
    assert str(pressure) == str(force) == str(value)


def test_stamps_lose_nothing(types):
    stamp = {'sec': 2_147_483_647, 'nanosec': 999_999_999}
    assert decode_pressure(pressure_message(types, **stamp)).stamp_ns == 2_147_483_647_999_999_999


def test_another_type_is_refused_with_its_name(types):
    with refused(MessageError, 'unreadable'):
        decode_pressure(wrench_message(types))
    with refused(MessageError, 'unreadable'):
        decode_wrench(pressure_message(types))


def test_a_stamp_of_more_than_a_second_of_nanoseconds_is_refused():
    with refused(MessageError, 'unreadable'):
        decode_pressure(pressure_message(ROSBAGS_TYPES, nanosec=1_000_000_000))


def test_content_that_is_no_number_is_refused():
    with refused(MessageError, 'unreadable'):
        decode_pressure(pressure_message(ROSBAGS_TYPES, pressure='high'))


@pytest.mark.ros
@pytest.mark.parametrize(
    ('make', 'type_name', 'decode'),
    [
        (pressure_message, PRESSURE_TYPE, decode_pressure),
        (wrench_message, WRENCH_TYPE, decode_wrench),
    ],
)
def test_a_reading_is_the_same_live_and_recorded(make, type_name, decode):
    from rclpy.serialization import deserialize_message, serialize_message

    live = make(RclpyTypes())
    recorded = deserialize(bytes(serialize_message(live)), type_name, jazzy())
    played = deserialize_message(serialize(make(ROSBAGS_TYPES), type_name), rclpy_class(type_name))
    assert decode(live) == decode(recorded) == decode(played)


# ---- estimates ----------------------------------------------------------------------------------


@pytest.mark.ros
def test_field_checks_of_ros_are_on():
    assert rclpy_class('std_msgs/msg/Header')()._check_fields


@pytest.mark.parametrize('output', OUTPUTS, ids=lambda output: output.name)
def test_stamped_outputs_carry_frame_and_stamp_of_the_estimate(types, output):
    message = output.encode(random_estimate(stamp_ns=1_500_000_007), FRAME, types)
    if not hasattr(message, 'header'):
        assert output.type == 'std_msgs/msg/Float64MultiArray'
        return
    assert message.header.frame_id == FRAME
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_007)


def test_centerline_is_a_pose_per_station(types):
    estimate = random_estimate(stations=9)
    path = OUTPUT['centerline'].encode(estimate, FRAME, types)
    shape = estimate.shape
    assert [pose.pose.position.x for pose in path.poses] == shape.x.tolist()
    assert [pose.pose.position.y for pose in path.poses] == shape.y.tolist()
    for pose, theta in zip(path.poses, shape.theta, strict=True):
        assert plain(pose.header) == plain(path.header)
        assert pose.pose.position.z == 0.0
        turn = pose.pose.orientation
        assert (turn.x, turn.y) == (0.0, 0.0)
        # +x of the pose is the tangent.
        assert 1 - 2 * turn.z**2 == pytest.approx(math.cos(theta), abs=1e-14)
        assert 2 * turn.z * turn.w == pytest.approx(math.sin(theta), abs=1e-14)


def test_curvature_has_its_rows_by_field_and_station(types):
    estimate = random_estimate(stations=9)
    message = OUTPUT['curvature'].encode(estimate, FRAME, types)
    first, second = message.layout.dim
    assert (first.label, first.size, first.stride) == ('field', 5, 45)
    assert (second.label, second.size, second.stride) == ('station', 9, 9)
    assert message.layout.data_offset == 0
    rows = np.array(message.data).reshape(5, 9)
    shape = estimate.shape
    expected = [
        shape.arclength,
        shape.curvature,
        shape.intrinsic_curvature,
        shape.moment,
        estimate.std_curvature,
    ]
    np.testing.assert_array_equal(rows, expected)


def test_shape_is_a_point_per_station(types):
    estimate = random_estimate(stations=9)
    cloud = OUTPUT['shape'].encode(estimate, FRAME, types)
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 9, 72, 648)
    assert cloud.is_dense
    assert not cloud.is_bigendian
    assert [(field.name, field.offset, field.datatype, field.count) for field in cloud.fields] == [
        ('x', 0, 7, 1),
        ('y', 4, 7, 1),
        ('z', 8, 7, 1),
        ('s', 16, 8, 1),
        ('theta', 24, 8, 1),
        ('kappa', 32, 8, 1),
        ('kappa0', 40, 8, 1),
        ('moment', 48, 8, 1),
        ('std_x', 56, 8, 1),
        ('std_y', 64, 8, 1),
    ]
    formats = {7: '<f4', 8: '<f8'}
    layout = np.dtype(
        {
            'names': [field.name for field in cloud.fields],
            'formats': [formats[field.datatype] for field in cloud.fields],
            'offsets': [field.offset for field in cloud.fields],
            'itemsize': cloud.point_step,
        }
    )
    points = np.frombuffer(bytes(cloud.data), layout)
    shape = estimate.shape
    np.testing.assert_array_equal(points['x'], shape.x.astype(np.float32))
    np.testing.assert_array_equal(points['y'], shape.y.astype(np.float32))
    np.testing.assert_array_equal(points['z'], 0.0)
    np.testing.assert_array_equal(points['s'], shape.arclength)
    np.testing.assert_array_equal(points['theta'], shape.theta)
    np.testing.assert_array_equal(points['kappa'], shape.curvature)
    np.testing.assert_array_equal(points['kappa0'], shape.intrinsic_curvature)
    np.testing.assert_array_equal(points['moment'], shape.moment)
    np.testing.assert_array_equal(points['std_x'], estimate.std_x)
    np.testing.assert_array_equal(points['std_y'], estimate.std_y)


def test_messages_do_not_share_what_a_reader_may_change(types):
    first = OUTPUT['shape'].encode(random_estimate(), FRAME, types)
    first.fields.clear()
    assert len(OUTPUT['shape'].encode(random_estimate(), FRAME, types).fields) == 10


def test_tip_is_the_last_station_with_its_covariance(types):
    estimate = random_estimate()
    message = OUTPUT['tip'].encode(estimate, FRAME, types)
    x, y, theta = estimate.shape.tip
    position, turn = message.pose.pose.position, message.pose.pose.orientation
    assert (position.x, position.y, position.z) == (x, y, 0.0)
    assert (turn.x, turn.y) == (0.0, 0.0)
    assert (turn.z, turn.w) == (math.sin(theta / 2), math.cos(theta / 2))
    covariance = np.array(message.pose.covariance).reshape(6, 6)
    moving = [0, 1, 5]
    np.testing.assert_array_equal(covariance[np.ix_(moving, moving)], estimate.tip_covariance)
    still = [2, 3, 4]
    assert not covariance[still].any()
    assert not covariance[:, still].any()


def test_state_is_all_that_a_controller_needs_in_one_point(types):
    estimate = random_estimate(5)
    message = OUTPUT['state'].encode(estimate, FRAME, types)
    assert (message.header.frame_id, message.width, message.height) == (FRAME, 1, 1)
    assert {item.name: (item.offset, item.datatype, item.count) for item in message.fields} == {
        **{name: (4 * place, 7, 1) for place, name in enumerate('xyz')},
        'mode': (12, 5, 1),
        **{
            name: (16 + 8 * place, 8, 1)
            for place, name in enumerate(
                ['theta', 'vx', 'vy', 'omega']
                + [f'cov_{part}' for part in ('xx', 'xy', 'xt', 'yy', 'yt', 'tt')]
            )
        },
        'tip_jacobian': (96, 8, 12),
        'settled': (192, 5, 1),
    }
    (point,) = np.frombuffer(message.data, STATE_POINT)
    x, y, theta = estimate.shape.tip
    assert (point['x'], point['y'], point['z']) == (np.float32(x), np.float32(y), 0.0)
    assert point['theta'] == theta
    covariance = estimate.tip_covariance
    assert (point['cov_xt'], point['cov_yy']) == (covariance[0, 2], covariance[1, 1])
    np.testing.assert_array_equal(point['tip_jacobian'].reshape(3, 4), estimate.jacobian)
    assert (point['vx'], point['vy'], point['omega']) == (0.0, 0.0, 0.0)
    assert (point['mode'], point['settled']) == (0, 1)  # a prediction, without motion


def test_state_has_the_velocity_of_a_moving_arm(types):
    motion = SimpleNamespace(velocity=np.array([0.1, -0.2, 3.0]), settled=False)
    estimate = dataclasses.replace(random_estimate(5), motion=motion)
    (point,) = np.frombuffer(OUTPUT['state'].encode(estimate, FRAME, types).data, STATE_POINT)
    assert [point[name] for name in ('vx', 'vy', 'omega')] == [0.1, -0.2, 3.0]
    assert point['settled'] == 0


def test_tip_jacobian_is_labeled(types):
    estimate = random_estimate()
    message = OUTPUT['tip_jacobian'].encode(estimate, FRAME, types)
    rows, columns = message.layout.dim
    assert (rows.label, rows.size, rows.stride) == ('x, y, theta', 3, 12)
    assert (columns.label, columns.size, columns.stride) == ('pressure, F1, F2, M', 4, 4)
    np.testing.assert_array_equal(np.array(message.data).reshape(3, 4), estimate.jacobian)


@pytest.mark.ros
@pytest.mark.parametrize('output', OUTPUTS, ids=lambda output: output.name)
def test_live_and_replay_publish_the_same_values(output):
    from rclpy.serialization import serialize_message

    estimate = random_estimate(seed=5)
    live = output.encode(estimate, FRAME, RclpyTypes())
    replay = output.encode(estimate, FRAME, ROSBAGS_TYPES)
    assert plain(live) == plain(replay)
    recorded = deserialize(bytes(serialize_message(live)), output.type, jazzy())
    assert plain(recorded) == plain(replay)

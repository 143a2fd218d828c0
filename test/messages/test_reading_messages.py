"""Readings through messages and back, and clouds of targets laid out in every way."""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.errors import MessageError
from pneunet_ros.core.readings import PressureReading, WrenchReading
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.point_cloud import point_type
from pneunet_ros.messages.readings import (
    decode_pressure,
    decode_targets,
    decode_tip_pose,
    decode_wrench,
    pressure_message,
    PRESSURE_TYPE,
    SENSORS,
    targets_message,
    tip_pose_message,
    wrench_message,
    WRENCH_TYPE,
)
from pneunet_ros.recordings.message_store import deserialize, jazzy, ROSBAGS_TYPES, serialize
import pytest
from support.made_recordings import header
from support.refusals import refused

BASE = 'pneunet_base'
STAMP = 3_250_000_001
X, Y = np.array([0.0, 0.01, np.nan, 0.03]), np.array([0.0, 0.001, np.nan, 0.009])
FIELDS = [('x', '<f8', 0), ('y', '<f8', 8), ('id', '<i4', 16)]
DATATYPES = {'i2': 3, 'i4': 5, 'u4': 6, 'f4': 7, 'f8': 8}


def cloud(fields=FIELDS, size=24, *, ids=(0, 1, 2, 3), frame_id=BASE, rows=1, padding=0, **other):
    """Return a cloud of the four targets above, its points laid out by `fields`."""
    points = np.zeros(len(ids), point_type(tuple(fields), size))
    for place, number in enumerate(ids):
        for name, values in (('x', X), ('y', Y), ('id', np.arange(4))):
            if name in points.dtype.names:
                points[name][place] = values[number % 4] if name != 'id' else number
    width = points.size // rows
    raw = points.view(np.uint8).reshape(rows, -1)
    raw = np.pad(raw, ((0, 0), (0, padding)), constant_values=255).reshape(-1)
    make = ROSBAGS_TYPES('sensor_msgs/msg/PointField')
    content = {
        'header': header(STAMP, frame_id),
        'height': rows,
        'width': width,
        'fields': [
            make(name=name, offset=offset, datatype=DATATYPES[kind[1:]], count=1)
            for name, kind, offset in fields
        ],
        'is_bigendian': any(kind[0] == '>' for _, kind, _ in fields),
        'point_step': size,
        'row_step': width * size + padding,
        'data': raw,
        'is_dense': False,
    }
    return ROSBAGS_TYPES(POINTS_TYPE)(**(content | other))


def renamed(message):
    """Return a cloud whose last field is a second x."""
    message.fields[-1].name = 'x'
    return message


def recorded(message, type_name):
    """Return a message as it comes out of a recording."""
    return deserialize(serialize(message, type_name), type_name, jazzy())


def test_pressure_comes_back_as_it_was():
    reading = PressureReading(stamp_ns=STAMP, pressure=31e3, variance=3600.0)
    message = pressure_message(STAMP, [31e3], 'hose', ROSBAGS_TYPES, variance=3600.0)
    message = recorded(message, PRESSURE_TYPE)
    assert decode_pressure(message) == reading
    assert message.header.frame_id == 'hose'


def test_wrench_comes_back_as_it_was():
    reading = WrenchReading(
        stamp_ns=STAMP, force_x=0.175, force_y=-0.07, moment=1e-3, frame_id='cell'
    )
    message = wrench_message(STAMP, [0.175, -0.07, 1e-3], 'cell', ROSBAGS_TYPES)
    message = recorded(message, WRENCH_TYPE)
    assert decode_wrench(message) == reading


def test_targets_come_back_as_they_were():
    message = targets_message(STAMP, X, [0.0, 0.001, 5.0, np.nan], BASE, ROSBAGS_TYPES, std=1e-4)
    found = decode_targets(recorded(message, POINTS_TYPE), BASE, 4)
    assert found.stamp_ns == STAMP
    np.testing.assert_array_equal(found.x, np.float32([0.0, 0.01, np.nan, np.nan]))
    np.testing.assert_array_equal(found.y, np.float32([0.0, 0.001, np.nan, np.nan]))
    np.testing.assert_array_equal(found.std, [1e-4, 1e-4, np.nan, np.nan])
    assert np.isnan(found.area).all()


@pytest.mark.parametrize(
    'message',
    [
        cloud(),
        cloud(ids=(3, 1, 0, 2)),
        cloud([('id', '<u4', 2), ('y', '<f4', 7), ('x', '<f8', 11)], 20),
        cloud([('x', '>f8', 0), ('y', '>f4', 8), ('id', '>i4', 12)], 16),
        cloud(rows=2, padding=5),
        cloud(rows=4),
    ],
    ids=['plain', 'turned', 'odd offsets', 'big-endian', 'padded rows', 'column'],
)
def test_points_are_read_however_they_are_laid_out(message):
    found = decode_targets(recorded(message, POINTS_TYPE), BASE, 4)
    np.testing.assert_allclose(found.x, X, rtol=1e-7)
    np.testing.assert_allclose(found.y, Y, rtol=1e-7)
    assert found.seen == 3


@pytest.mark.parametrize(
    ('message', 'said'),
    [
        (cloud(frame_id='camera'), "frame 'camera', but must be in 'pneunet_base'"),
        (cloud(ids=(0, 1, 2)), 'there are 3 points in targets, but the arm has 4 targets'),
        (
            cloud(ids=(0, 1, 2)),
            'For another arm, use --model .calibrate: --arm; a node: the parameter model_file',
        ),
        (cloud(ids=(0, 1, 2, 2)), 'must be 0 to 3, each once, not 0, 1, 2, 2'),
        (cloud(ids=(0, 1, 2, 4)), 'must be 0 to 3, each once, not 0, 1, 2, 4'),
        (cloud(ids=(0, 1, 2, -1)), 'must be 0 to 3, each once'),
        (cloud(FIELDS[:2]), 'the field id of targets is missing: it must be int32'),
        (cloud(FIELDS[1:]), 'the field x of targets is missing: it must be float'),
        (cloud([*FIELDS[:2], ('id', '<f4', 16)]), 'the field id of targets is no int32'),
        (cloud([('x', '<i4', 0), *FIELDS[1:]], ids=(0, 1)), 'the field x of targets is no float'),
        (renamed(cloud([*FIELDS, ('w', '<f4', 20)])), 'has a field twice'),
        (cloud(point_step=18), 'the field id does not lie within the 18 bytes'),
        (cloud(data=np.zeros(95, np.uint8)), '95 bytes cannot hold 1 x 4 points of 24 bytes'),
        (cloud(rows=2, row_step=20), 'rows of 20 bytes cannot hold 2 points'),
        (cloud(width=2**32 - 1), 'cannot hold'),
        (cloud(width=0), 'there are 0 points'),
        (cloud(point_step=0), 'does not lie within the 0 bytes'),
        (
            cloud(
                [], 0, height=10**5, width=2**32 - 1, row_step=1, data=np.zeros(10**5, np.uint8)
            ),
            'points of 0 bytes',
        ),
        (cloud(point_step=2**32 - 1), 'a point of 4294967295 bytes is not possible'),
    ],
)
def test_clouds_that_are_no_targets_are_refused(message, said):
    with pytest.raises(MessageError, match=said):
        decode_targets(recorded(message, POINTS_TYPE), BASE, 4)


def test_what_is_no_cloud_is_refused():
    with refused(MessageError, 'unreadable'):
        decode_targets(object(), BASE)


def test_fields_beside_may_be_missing():
    found = decode_targets(cloud(), BASE)
    assert math.isnan(found.std[0])


@pytest.mark.parametrize('sensor', SENSORS, ids=lambda sensor: sensor.name)
def test_a_row_of_every_sensor_comes_back_from_its_message(sensor):
    row = np.random.default_rng(0).uniform(0.01, 0.1, sensor.row_shape(4)).astype(np.float32)
    message = recorded(sensor.message(STAMP, row, BASE, ROSBAGS_TYPES), sensor.type)
    stamp_ns, read = sensor.read(message, EstimatorSettings())
    assert stamp_ns == STAMP
    np.testing.assert_allclose(read, row, rtol=1e-14)
    assert sensor.present(read[None]).tolist() == [True]
    assert sensor.present(np.full((1, *row.shape), np.nan)).tolist() == [False]


def test_a_target_or_tip_at_the_clamp_was_not_seen():
    """Trackers of tags and motion capture write zeros where they see nothing."""
    x, y = np.array([0.0, 0.0, 0.0, 0.03]), np.array([0.0, 0.0, 0.01, 0.0])
    found = decode_targets(targets_message(1, x, y, BASE, ROSBAGS_TYPES), BASE)
    assert np.isfinite(found.x).tolist() == [True, False, True, True]
    pose = decode_tip_pose(tip_pose_message(1, np.zeros(3), BASE, ROSBAGS_TYPES))
    assert np.isnan([pose.x, pose.y, pose.heading]).all()
    pose = decode_tip_pose(tip_pose_message(1, np.array([0.0, 0.0, 0.4]), BASE, ROSBAGS_TYPES))
    assert np.isnan([pose.x, pose.y]).all()
    assert pose.heading == pytest.approx(0.4)  # of an inertial sensor
    pose = decode_tip_pose(tip_pose_message(1, np.array([0.1, 0.0, 0.0]), 'f', ROSBAGS_TYPES))
    assert (pose.x, pose.y, pose.heading) == (0.1, 0.0, 0.0)

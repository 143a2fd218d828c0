"""Messages of sensors from their bytes: the same readings as by the reader of ROS."""

from __future__ import annotations

import struct

import numpy as np
from pneunet_ros.messages.base_frames import imu_message
from pneunet_ros.messages.cdr_reader import read_message
from pneunet_ros.messages.readings import BASE_IMU, END_WRENCH, PRESSURE
from pneunet_ros.messages.readings import FRAMES as TF
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
import pytest

FRAMES = ['', 'b', 'pneunet_base', 'ünïcode', 'a' * 7, 'a' * 8]
SENSORS = {
    PRESSURE: np.array([31e3]),
    END_WRENCH: np.array([0.1, -0.2, 1e-3]),
    BASE_IMU: np.array([0.1, 9.8, -0.2, 0.3]),
}


def made(sensor, frame_id='base'):
    """Give a message of a sensor and its bytes."""
    message = sensor.message(1_700_000_000_123_456_789, SENSORS[sensor], frame_id, ROSBAGS_TYPES)
    return message, bytes(serialize(message, sensor.type))


@pytest.mark.parametrize('frame_id', FRAMES)
@pytest.mark.parametrize('sensor', SENSORS, ids=lambda one: one.name)
def test_a_reading_is_that_of_the_message(sensor, frame_id):
    message, raw = made(sensor, frame_id)
    assert sensor.decode(read_message(raw, sensor.type)) == sensor.decode(message)


def test_an_imu_may_read_no_angular_velocity():
    for rate, read in ((np.nan, (np.nan,) * 3), (0.3, (0.0, 0.0, 0.3))):
        row = np.array([0.1, 9.8, -0.2, rate])
        found = BASE_IMU.decode(BASE_IMU.message(1, row, 'base', ROSBAGS_TYPES))
        assert found.rate == pytest.approx(read, nan_ok=True)
    message = imu_message(1, row, 'base', ROSBAGS_TYPES, std=0.2)
    message.angular_velocity.x = np.inf
    assert np.isnan(BASE_IMU.decode(message).rate).all()
    assert BASE_IMU.decode(message).variance == pytest.approx(0.04)
    message.linear_acceleration_covariance[4] = np.nan
    assert BASE_IMU.decode(message).variance in (0.0, pytest.approx(0.04))


@pytest.mark.parametrize('sensor', SENSORS, ids=lambda one: one.name)
def test_what_is_cut_off_or_of_another_kind_is_left_to_ros(sensor):
    _, raw = made(sensor)
    assert read_message(raw, sensor.type) is not None
    assert all(read_message(raw[:end], sensor.type) is None for end in range(len(raw)))
    assert read_message(b'\x00\x00' + raw[2:], sensor.type) is None
    assert read_message(raw, TF.type) is None
    assert read_message(raw[:12] + struct.pack('<I', 2**31) + raw[16:], sensor.type) is None

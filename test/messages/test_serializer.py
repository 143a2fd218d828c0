"""Messages filled in place are the bytes of plain serialization."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pneunet_ros.core.errors import MessageError
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.recordings.message_store import deserialize, jazzy, ROSBAGS_TYPES, serialize
import pytest
from support.random_estimates import plain, random_estimate, RclpyTypes
from support.refusals import refused

BY_NAME = {output.name: output for output in OUTPUTS}


def serializer(frame_id='pneunet_base'):
    return MessageSerializer(types=ROSBAGS_TYPES, serialize=serialize, frame_id=frame_id)


@pytest.mark.parametrize('output', OUTPUTS, ids=lambda output: output.name)
@pytest.mark.parametrize('stations', [1, 2, 57, 100])
@pytest.mark.parametrize('frame_id', ['', 'a', 'pneunet_base', 'arm_2/pneunet_base'])
def test_bytes_are_those_of_plain_serialization(output, stations, frame_id):
    filled = serializer(frame_id)
    for seed, stamp_ns in enumerate((0, 999_999_999, 1_700_000_000_123_456_789)):
        estimate = random_estimate(stations, stamp_ns, seed)
        message = output.encode(estimate, frame_id, ROSBAGS_TYPES)
        assert filled.bytes_of(output, estimate) == serialize(message, output.type)


def test_a_straight_arm_at_rest_is_no_special_case():
    estimate = random_estimate()
    zero = np.zeros(57)
    shape = replace(estimate.shape, x=zero, y=zero, theta=zero, curvature=zero, moment=zero)
    estimate = replace(estimate, shape=shape, jacobian=np.zeros((3, 4)))
    for output in OUTPUTS:
        message = output.encode(estimate, 'f', ROSBAGS_TYPES)
        assert serializer('f').bytes_of(output, estimate) == serialize(message, output.type)


def test_the_number_of_stations_may_change():
    filled = serializer()
    for stations in (57, 9, 57):
        path = BY_NAME['centerline']
        estimate = random_estimate(stations)
        message = deserialize(filled.bytes_of(path, estimate), path.type, jazzy())
        assert len(message.poses) == stations


def test_earlier_bytes_stay_as_they_were():
    filled, tip = serializer(), BY_NAME['tip']
    first = filled.bytes_of(tip, random_estimate(seed=1))
    copy = bytes(bytearray(first))
    filled.bytes_of(tip, random_estimate(seed=2))
    assert first == copy


def test_an_output_without_numbers_is_serialized_plainly():
    filled, estimate = BY_NAME['tip'], random_estimate()

    def build(result, heading, types):
        return filled.build(filled.numbers(result), heading, types)

    tip = replace(filled, numbers=None, build=build)
    message = tip.encode(estimate, 'pneunet_base', ROSBAGS_TYPES)
    assert serializer().bytes_of(tip, estimate) == serialize(message, tip.type)


def test_numbers_that_do_not_stand_in_the_message_are_refused():
    tip = BY_NAME['tip']
    wrong = replace(tip, build=lambda rows, *others: tip.build(rows + 1.0, *others))
    with refused(MessageError, 'not_in_place'):
        serializer().bytes_of(wrong, random_estimate())


@pytest.mark.ros
@pytest.mark.parametrize('output', OUTPUTS, ids=lambda output: output.name)
def test_what_ros_serializes_can_be_filled_too(output):
    from rclpy.serialization import deserialize_message, serialize_message

    types = RclpyTypes()
    filled = MessageSerializer(
        types=types,
        serialize=lambda message, _: bytes(serialize_message(message)),
        frame_id='pneunet_base',
    )
    for seed in range(3):
        estimate = random_estimate(seed=seed)
        raw = filled.bytes_of(output, estimate)
        live = deserialize_message(raw, types(output.type))
        expected = plain(output.encode(estimate, 'pneunet_base', types))
        assert plain(live) == expected
        assert plain(deserialize(raw, output.type, jazzy())) == expected

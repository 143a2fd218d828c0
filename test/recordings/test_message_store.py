"""Types of recordings: known ones, learned ones, and those that mean something else."""

from __future__ import annotations

from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.messages.readings import PRESSURE_TYPE
from pneunet_ros.recordings.message_store import (
    deserialize,
    IDL_HEAD,
    jazzy,
    ROSBAGS_TYPES,
    serialize,
    store_for,
)
import pytest
from support.made_recordings import pressure
from support.refusals import refused

IDL = (
    f'{IDL_HEAD}lab_msgs/msg/Volts\n'
    'module lab_msgs { module msg { struct Volts { double volts; }; }; };'
)


def test_the_definition_of_jazzy_gives_the_types_of_jazzy():
    definition, _ = jazzy().generate_msgdef(PRESSURE_TYPE, ros_version=2)
    assert store_for(PRESSURE_TYPE, definition) is jazzy()
    assert store_for(PRESSURE_TYPE, '') is jazzy()
    comments = '# gauge\n' + definition.replace('fluid_pressure', 'fluid_pressure  # Pa')
    assert store_for(PRESSURE_TYPE, comments) is jazzy()


def test_a_type_that_means_something_else_is_read_as_it_was_meant():
    store = store_for(PRESSURE_TYPE, 'float64 fluid_pressure\nfloat32 temperature\n')
    assert store is not jazzy()
    raw = b'\0\1\0\0' + bytes.fromhex('00000000000010400000c03f')
    message = deserialize(raw, PRESSURE_TYPE, store)
    assert (message.fluid_pressure, message.temperature) == (4.0, 1.5)
    # Jazzy's own type is what it was.
    assert [name for name, _ in jazzy().fielddefs[PRESSURE_TYPE][1]] == [
        'header',
        'fluid_pressure',
        'variance',
    ]


def test_a_definition_in_idl_is_learned():
    store = store_for('lab_msgs/msg/Volts', IDL)
    raw = b'\0\1\0\0' + bytes.fromhex('0000000000001040')
    assert deserialize(raw, 'lab_msgs/msg/Volts', store).volts == 4.0


@pytest.mark.parametrize(
    'definition',
    [
        'volts: float64\n',
        'lab_msgs/Unit unit\n',
        f'{IDL_HEAD}nonsense',
        IDL.replace('Volts', 'Amps'),
    ],
)
def test_a_definition_that_cannot_be_used_is_named(definition):
    with refused(RecordingError, 'wrong_form'):
        store_for('lab_msgs/msg/Volts', definition)


def test_a_type_that_is_nowhere_defined_is_named():
    with refused(RecordingError, 'unknown_type'):
        store_for('lab_msgs/msg/Volts', '')


@pytest.mark.parametrize(
    'raw', [b'', b'\0\1\0\0', b'\7\7\0\0' + bytes(40), b'\0\1\0\0' + bytes(99)]
)
def test_bytes_of_something_else_are_refused(raw):
    with pytest.raises(MessageError):
        deserialize(raw, PRESSURE_TYPE, jazzy())


def test_big_endian_messages_are_read():
    raw = bytes(jazzy().serialize_cdr(pressure(5), PRESSURE_TYPE, little_endian=False))
    assert deserialize(raw, PRESSURE_TYPE, jazzy()) == pressure(5)


def test_a_message_comes_back():
    assert deserialize(serialize(pressure(5), PRESSURE_TYPE), PRESSURE_TYPE, jazzy()) == pressure(
        5
    )


def test_classes_are_found_by_type():
    assert type(pressure(5)) is ROSBAGS_TYPES(PRESSURE_TYPE)
    with pytest.raises(KeyError):
        ROSBAGS_TYPES('lab_msgs/msg/Volts')

"""Recordings read: their topics, the order of their messages, and what is said about the rest."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
import random
import tracemalloc

from mcap.writer import CompressionType, Writer
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.messages.readings import (
    BASE_IMU,
    decode_pressure,
    decode_wrench,
    END_WRENCH,
    PRESSURE_TYPE,
    TARGETS,
    WRENCH_TYPE,
)
from pneunet_ros.recordings.message_store import jazzy, serialize
from pneunet_ros.recordings.recorded_series import find_series
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.made_recordings import (
    PRESSURE,
    pressure,
    STEP_NS,
    WRENCH,
    write_by_mcap,
    write_readings,
)
from support.refusals import reasons, refused


@pytest.fixture(params=['file.mcap', 'folder'])
def recording(request, tmp_path):
    return open_recording(write_readings(tmp_path / request.param))


# ---- topics -------------------------------------------------------------------------------------


def test_topics_are_listed_with_type_and_count(recording):
    assert [(topic.name, topic.type, topic.count) for topic in recording.topics] == [
        (WRENCH, WRENCH_TYPE, 100),
        (PRESSURE, PRESSURE_TYPE, 100),
    ]
    assert recording.topic(PRESSURE).definition.splitlines()[0] == 'std_msgs/Header header'
    assert recording.sentences == ()
    assert recording.count([PRESSURE]) == 100
    assert recording.count([PRESSURE, WRENCH, '/missing']) == 200
    assert (recording.start_ns, recording.end_ns) == (0, 99 * STEP_NS)


def test_a_topic_is_found_by_type_and_last_name(recording):
    assert recording.find('pressure', PRESSURE_TYPE) == PRESSURE
    assert recording.find('end_wrench', WRENCH_TYPE) == WRENCH
    assert recording.candidates('pressure', PRESSURE_TYPE) == (PRESSURE,)
    assert recording.candidates('sure', PRESSURE_TYPE) == ()


def test_a_last_name_may_have_parts(tmp_path):
    path = write_readings(tmp_path / 'r.mcap', pressure_topic='/arm/line/pressure')
    recording = open_recording(path)
    assert recording.find('line/pressure', PRESSURE_TYPE) == '/arm/line/pressure'
    assert recording.find('arm/line/pressure', PRESSURE_TYPE) == '/arm/line/pressure'
    assert recording.candidates('ine/pressure', PRESSURE_TYPE) == ()


def test_a_missing_topic_lists_those_that_are_there(recording):
    with refused(RecordingError, 'no_topic') as caught:
        recording.find('pressure', WRENCH_TYPE)
    said = str(caught.value)
    assert all(topic in said for topic in (PRESSURE, WRENCH, '--topic pressure='))


def test_two_candidates_are_listed(tmp_path):
    with write_recording(tmp_path / 'r.mcap') as writer:
        for topic in ('/left/pressure', '/right/pressure'):
            writer.write(writer.add(topic, PRESSURE_TYPE), 0, pressure(0))
    recording = open_recording(tmp_path / 'r.mcap')
    with refused(RecordingError, 'ambiguous_topic') as caught:
        recording.find('pressure', PRESSURE_TYPE)
    said = str(caught.value)
    assert all(topic in said for topic in ('/left/pressure', '/right/pressure', '--topic'))
    assert recording.find('pressure', PRESSURE_TYPE, '/right/pressure') == '/right/pressure'


def test_the_sensors_of_another_arm_are_not_those_of_a_named_topic(tmp_path):
    with write_recording(tmp_path / 'r.mcap') as writer:
        for topic in ('/left/pressure', '/right/pressure'):
            writer.write(writer.add(topic, PRESSURE_TYPE), 0, pressure(0))
        for arm in ('left', 'right'):
            writer.add(f'/{arm}/targets', TARGETS.type)
        writer.add('/right/end_wrench', END_WRENCH.type)
        writer.add('/base_imu', BASE_IMU.type)
    recording = open_recording(tmp_path / 'r.mcap')
    for arm, wrench in (('left', None), ('right', '/right/end_wrench')):
        named = {'pressure': f'/{arm}/pressure'}
        assert find_series(recording, END_WRENCH, named, required=False) == wrench
        assert find_series(recording, BASE_IMU, named, required=False) == '/base_imu'
    with refused(RecordingError, 'no_topic') as caught:
        find_series(recording, END_WRENCH, {'pressure': '/left/pressure'})
    assert '/right/end_wrench' not in str(caught.value)  # not proposed as a remedy either


@pytest.mark.parametrize('valve', ['/valve/pressure', '/arm/filtered/pressure'])
@pytest.mark.parametrize('arm', ['/arm/', '/'])
def test_a_second_pressure_of_one_arm_takes_no_sensor_from_it(tmp_path, valve, arm):
    with write_recording(tmp_path / 'r.mcap') as writer:
        for topic in (f'{arm}pressure', valve):
            writer.write(writer.add(topic, PRESSURE_TYPE), 0, pressure(0))
        writer.add(f'{arm}end_wrench', END_WRENCH.type)
    recording = open_recording(tmp_path / 'r.mcap')
    assert find_series(recording, END_WRENCH, {'pressure': valve}) == f'{arm}end_wrench'


def test_an_override_must_name_a_topic_of_the_type(recording):
    assert recording.find('gauge', PRESSURE_TYPE, PRESSURE) == PRESSURE
    with refused(RecordingError, 'no_topic'):
        recording.find('pressure', PRESSURE_TYPE, '/gauge')
    with refused(RecordingError, 'wrong_type'):
        recording.find('pressure', PRESSURE_TYPE, WRENCH)


# ---- messages -----------------------------------------------------------------------------------


def test_messages_come_in_log_time_order_and_ties_in_the_order_asked_for(recording):
    messages = list(recording.messages([WRENCH, PRESSURE]))
    assert [(m.topic, m.log_time_ns) for m in messages] == [
        (topic, index * STEP_NS) for index in range(100) for topic in (WRENCH, PRESSURE)
    ]
    turned = [message.topic for message in recording.messages([PRESSURE, WRENCH])]
    assert turned == [PRESSURE, WRENCH] * 100
    assert [message.topic for message in recording.messages([PRESSURE])] == [PRESSURE] * 100


def test_messages_hold_what_was_written(recording):
    for index, (topic, log_time, message, raw) in enumerate(recording.messages([PRESSURE])):
        reading = decode_pressure(message)
        assert (reading.stamp_ns, reading.pressure) == (index * STEP_NS, float(index))
        assert topic == PRESSURE
        assert raw == serialize(pressure(log_time, float(index)), PRESSURE_TYPE)
    forces = [decode_wrench(entry.message).force_x for entry in recording.messages([WRENCH])]
    assert forces == [float(index) for index in range(100)]


def test_raw_messages_are_the_same_without_decoding(recording):
    decoded = [(m.topic, m.log_time_ns, m.raw) for m in recording.messages([WRENCH, PRESSURE])]
    assert [tuple(message) for message in recording.raw_messages([WRENCH, PRESSURE])] == decoded


@pytest.mark.parametrize('options', [{}, {'use_chunking': False}, {'chunk_size': 10**6}])
def test_messages_logged_out_of_order_are_put_in_order(tmp_path, options):
    # Every tenth is late by two chunks or so, and all log times come twice.
    times = [(index // 2 - (40 if index % 10 == 0 else 0)) * 1000 + 10**6 for index in range(400)]
    recording = open_recording(write_by_mcap(tmp_path / 'r.mcap', times, **options))
    found = list(recording.messages([PRESSURE]))
    assert [message.log_time_ns for message in found] == sorted(times)
    # Of equal log times, the one written first comes first.
    order = sorted(range(400), key=lambda index: (times[index], index))
    assert [decode_pressure(message.message).pressure for message in found] == order


def test_files_of_a_folder_are_merged_in_log_time_order(tmp_path):
    folder = write_readings(tmp_path / 'bag')
    times = [index * STEP_NS + STEP_NS // 2 for index in range(100)]
    write_by_mcap(folder / 'bag_1.mcap', times)
    metadata = folder / 'metadata.yaml'
    text = metadata.read_text()
    assert '- bag.mcap' in text
    metadata.write_text(text.replace('- bag.mcap', '- bag.mcap\n  - bag/bag_1.mcap', 1))
    recording = open_recording(folder)
    assert recording.topic(PRESSURE).count == 200
    log_times = [message.log_time_ns for message in recording.raw_messages([PRESSURE])]
    assert log_times == [index * STEP_NS // 2 for index in range(200)]


def test_a_large_recording_is_not_held_in_memory(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', list(range(20_000)), chunk_size=20_000)
    size = path.stat().st_size
    recording = open_recording(path)
    tracemalloc.start()
    assert sum(1 for _ in recording.raw_messages([PRESSURE])) == 20_000
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < size / 4


def test_a_recording_can_be_left_early_and_read_again(recording):
    messages = recording.messages([PRESSURE])
    next(messages)
    messages.close()
    assert sum(1 for _ in recording.messages([PRESSURE])) == 100


def test_a_topic_that_is_not_there_is_an_error(recording):
    with refused(RecordingError, 'no_topic'):
        next(recording.messages(['/missing']))


# ---- what cannot be read ------------------------------------------------------------------------


@pytest.mark.parametrize('share', [0.2, 0.5, 0.8, 0.95])
def test_a_truncated_recording_is_read_as_far_as_it_goes(tmp_path, share):
    path = write_readings(tmp_path / 'r.mcap')
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    recording = open_recording(path)
    found = list(recording.messages([topic.name for topic in recording.topics]))
    (note,) = recording.sentences
    assert (note.reason, str(len(found)) in note) == ('cut_off', True)
    assert all(message.log_time_ns == index // 2 * STEP_NS for index, message in enumerate(found))


@pytest.mark.parametrize('shape', ['plain', 'zstd', 'lz4', 'no_chunks'])
def test_damage_anywhere_is_a_sentence_or_a_difference_but_no_crash(tmp_path, shape):
    options = {
        'plain': {},
        'zstd': {'compression': CompressionType.ZSTD},
        'lz4': {'compression': CompressionType.LZ4},
        'no_chunks': {'use_chunking': False},
    }
    path = write_by_mcap(tmp_path / 'r.mcap', list(range(60)), **options[shape])
    whole = path.read_bytes()
    dice = random.Random(7)
    for _ in range(300):
        raw = bytearray(whole[: dice.choice([len(whole), dice.randrange(20, len(whole))])])
        for _ in range(dice.randrange(1, 6)):
            raw[dice.randrange(8, len(raw))] = dice.randrange(256)
        path.write_bytes(raw)
        with suppress(RecordingError):
            recording = open_recording(path)
            for _ in recording.messages([topic.name for topic in recording.topics]):
                pass


def write_channels(path, channels, compression=CompressionType.NONE):
    """Write one pressure to each channel: topic, message encoding, type, schema encoding, text."""
    with path.open('wb') as stream:
        writer = Writer(stream, compression=compression)
        writer.start('ros2')
        for topic, encoding, type_name, schema_encoding, text in channels:
            schema = 0
            if type_name:
                schema = writer.register_schema(type_name, schema_encoding, text.encode())
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, 5, serialize(pressure(5), PRESSURE_TYPE), 5)
        writer.finish()
    return path


DEFINITION = jazzy().generate_msgdef(PRESSURE_TYPE, ros_version=2)[0]
GOOD = ('/p', 'cdr', PRESSURE_TYPE, 'ros2msg', DEFINITION)


def test_channels_of_other_encodings_are_left_out_and_said(tmp_path):
    path = write_channels(
        tmp_path / 'r.mcap',
        [
            GOOD,
            ('/json', 'json', 'Pressure', 'jsonschema', '{}'),
            ('/proto', 'cdr', 'Pressure', 'protobuf', ''),
            ('/bare', 'cdr', '', '', ''),
            ('/p', 'cdr', 'std_msgs/msg/Empty', 'ros2msg', ''),
        ],
    )
    recording = open_recording(path)
    assert [(topic.name, topic.count) for topic in recording.topics] == [('/p', 1)]
    names = [sentence.split()[0] for sentence in recording.sentences]
    assert names == ['/json', '/proto', '/bare', '/p']
    assert set(reasons(recording.sentences)) == {'not_supported'}
    assert len(list(recording.messages(['/p']))) == 1


def test_two_publishers_of_a_topic_are_one_topic(tmp_path):
    recording = open_recording(write_channels(tmp_path / 'r.mcap', [GOOD, GOOD]))
    assert [topic.count for topic in recording.topics] == [2]
    assert len(list(recording.messages(['/p']))) == 2


def test_a_type_unknown_to_ros_is_read_by_its_definition(tmp_path):
    channel = ('/p', 'cdr', 'lab_msgs/msg/Gauge', 'ros2msg', DEFINITION)
    recording = open_recording(write_channels(tmp_path / 'r.mcap', [GOOD, channel]))
    (message,) = recording.messages(['/p'])
    assert decode_pressure(message.message).pressure == 31e3


def test_a_type_that_is_nowhere_defined_is_an_error_only_when_it_is_needed(tmp_path):
    channel = ('/gauge', 'cdr', 'lab_msgs/msg/Gauge', 'ros2msg', '')
    recording = open_recording(write_channels(tmp_path / 'r.mcap', [GOOD, channel]))
    assert len(list(recording.messages(['/p']))) == 1
    assert len(list(recording.raw_messages(['/gauge']))) == 1
    with refused(RecordingError, 'unknown_type'):
        next(recording.messages(['/gauge']))


def test_a_message_of_another_type_is_an_error_with_topic_and_time(tmp_path):
    channel = ('/w', 'cdr', WRENCH_TYPE, 'ros2msg', '')
    recording = open_recording(write_channels(tmp_path / 'r.mcap', [channel]))
    with refused(RecordingError, 'damaged'):
        next(recording.messages(['/w']))


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('', 'not_a_mapping'),
        ('[]', 'not_a_mapping'),
        ('a: 1', 'not_a_mapping'),
        ('\0', 'not_yaml'),
        ('rosbag2_bagfile_information: {}', 'wrong_form'),
        ('{', 'not_yaml'),
    ],
)
def test_other_metadata_is_refused(tmp_path, text, reason):
    folder = write_readings(tmp_path / 'bag')
    (folder / 'metadata.yaml').write_text(text)
    with refused(RecordingError, reason):
        open_recording(folder)


@pytest.mark.parametrize(
    ('old', 'new', 'sentence'),
    [
        ('storage_identifier: mcap', 'storage_identifier: bag', 'stored as bag'),
        ("compression_format: ''", 'compression_format: lz5', 'stored as mcap lz5'),
    ],
)
def test_other_storage_is_refused(tmp_path, old, new, sentence):
    folder = write_readings(tmp_path / 'bag')
    metadata = folder / 'metadata.yaml'
    assert old in metadata.read_text()
    metadata.write_text(metadata.read_text().replace(old, new))
    with refused(RecordingError, 'not_supported'):
        open_recording(folder)


def test_a_folder_of_images_is_sent_to_the_verb_that_takes_it(tmp_path):
    (tmp_path / 'frame1.png').write_bytes(b'')
    with refused(RecordingError, 'wrong_kind'):
        open_recording(tmp_path)


def test_pictures_beside_recordings_make_no_folder_of_images(tmp_path):
    folder = write_readings(tmp_path / 'bag')
    (tmp_path / 'plot.png').write_bytes(b'')
    with refused(RecordingError, 'wrong_kind'):
        open_recording(tmp_path)
    (folder / 'metadata.yaml').unlink()
    (folder / 'plot.png').write_bytes(b'')
    assert open_recording(folder).count([PRESSURE]) == 100
    for number in range(20):
        (folder / f'{number}.mcap').write_bytes(b'')
    with refused(RecordingError, 'wrong_kind'):
        open_recording(folder)
    for file in folder.iterdir():
        file.unlink()
    with refused(RecordingError, 'wrong_kind'):
        open_recording(folder)


@pytest.mark.parametrize(
    ('name', 'reason'),
    [(r'a\0b', 'not_yaml'), (r'\ud800', 'not_yaml'), (r'..', 'wrong_form'), (r'', 'wrong_form')],
)
def test_a_name_that_no_file_of_a_folder_can_have_is_refused(tmp_path, name, reason):
    folder = write_readings(tmp_path / 'bag')
    metadata = folder / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('- bag.mcap', f'- "{name}"', 1))
    with refused(RecordingError, reason):
        open_recording(folder)


def test_a_file_is_named_once(tmp_path):
    folder = write_readings(tmp_path / 'bag')
    metadata = folder / 'metadata.yaml'
    text = metadata.read_text().replace('  - bag.mcap\n', '  - bag.mcap\n' * 2000, 1)
    metadata.write_text(text)
    with refused(RecordingError, 'given_twice'):
        open_recording(folder)


def test_names_that_no_topic_has_are_left_out_and_said_shortly(tmp_path):
    many = [(f'/{index}{"a" * 5000}', 'cdr', PRESSURE_TYPE, 'ros2msg', '') for index in range(50)]
    recording = open_recording(write_channels(tmp_path / 'r.mcap', [GOOD, *many]))
    assert [topic.name for topic in recording.topics] == ['/p']
    assert recording.sentences[0].reason == 'too_large'
    assert recording.sentences[-1].startswith('30 ')
    assert sum(map(len, recording.sentences)) < 20_000


def test_a_recording_of_which_nothing_is_left_says_why(tmp_path):
    options = {'repeat_channels': False, 'chunk_size': 10**6}
    path = write_by_mcap(tmp_path / 'r.mcap', list(range(20)), **options)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 4] ^= 1
    path.write_bytes(raw)
    with refused(RecordingError, 'no_topic'):
        open_recording(path).find('pressure', PRESSURE_TYPE)


def test_chunks_that_all_overlap_are_not_held_in_memory_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr('pneunet_ros.recordings.recording.MOST_WAITING', 50_000)
    times = [index % 2 * 10**6 + index for index in range(400)]
    recording = open_recording(write_by_mcap(tmp_path / 'r.mcap', times))
    with refused(RecordingError, 'too_large'):
        deque(recording.raw_messages([PRESSURE]), maxlen=0)


def test_a_missing_recording_or_file_of_it_is_named(tmp_path):
    with refused(RecordingError, 'not_found'):
        open_recording(tmp_path / 'nowhere')
    folder = write_readings(tmp_path / 'bag')
    (folder / 'bag.mcap').unlink()
    with refused(RecordingError, 'unreadable'):
        open_recording(folder)

"""Recordings written: other readers open them, and they stand whole or not at all."""

from __future__ import annotations

import errno
from pathlib import Path
import signal
import subprocess
import sys

from mcap.reader import make_reader
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.readings import PRESSURE_TYPE, WRENCH_TYPE
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.recordings.limits import LARGEST_CHUNK
from pneunet_ros.recordings.message_store import ROSBAGS_TYPES, serialize
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import CHUNK, MessageStorage, write_recording
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosReliability
from rosbags.rosbag2 import Reader
from ruamel.yaml import YAML
from support.made_recordings import header, PRESSURE, pressure, STEP_NS, WRENCH, write_readings
from support.random_estimates import plain, random_estimate
from support.refusals import refused


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize('name', ['file.mcap', 'folder'])
def test_rosbags_reads_what_was_written(tmp_path, name):
    path = write_readings(tmp_path / name)
    with Reader(path) as reader:
        assert reader.message_count == 200
        assert {connection.topic for connection in reader.connections} == {PRESSURE, WRENCH}
        for connection in reader.connections:
            assert connection.ext.serialization_format == 'cdr'
            (qos,) = connection.ext.offered_qos_profiles
            assert qos.reliability == QosReliability.RELIABLE
    with AnyReader([path]) as reader:
        times = [
            (timestamp, connection.topic, reader.deserialize(raw, connection.msgtype))
            for connection, timestamp, raw in reader.messages()
        ]
    assert len(times) == 200
    assert times[-1][0] == 99 * STEP_NS


def test_mcap_reads_what_was_written(tmp_path):
    path = write_readings(tmp_path / 'file.mcap')
    with path.open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        assert summary.statistics.message_count == 200
        assert {schema.encoding for schema in summary.schemas.values()} == {'ros2msg'}
        assert {channel.message_encoding for channel in summary.channels.values()} == {'cdr'}
        for channel in summary.channels.values():
            assert 'reliability: reliable' in channel.metadata['offered_qos_profiles']
        messages = list(reader.iter_messages())
    assert [message.log_time for _, _, message in messages][::2] == [
        index * STEP_NS for index in range(100)
    ]
    assert all(message.publish_time == message.log_time for _, _, message in messages)


def test_a_folder_is_as_rosbag2_has_it(tmp_path):
    folder = write_readings(tmp_path / 'arm')
    assert names(tmp_path) == ['arm']
    assert names(folder) == ['arm.mcap', 'metadata.yaml']
    bag = YAML(typ='safe').load(folder / 'metadata.yaml')['rosbag2_bagfile_information']
    assert bag['version'] == 9
    assert bag['storage_identifier'] == 'mcap'
    assert bag['relative_file_paths'] == ['arm.mcap']
    assert bag['message_count'] == 200
    assert bag['duration'] == {'nanoseconds': 99 * STEP_NS}
    hashes = {
        entry['topic_metadata']['name']: entry['topic_metadata']['type_description_hash']
        for entry in bag['topics_with_message_count']
    }
    assert hashes[PRESSURE].startswith('RIHS01_')


def test_a_bare_file_is_all_that_is_left(tmp_path):
    write_readings(tmp_path / 'arm.mcap')
    assert names(tmp_path) == ['arm.mcap']


def test_all_outputs_of_the_estimator_come_back(tmp_path):
    estimates = [random_estimate(stamp_ns=index * STEP_NS, seed=index) for index in range(20)]
    filled = MessageSerializer(types=ROSBAGS_TYPES, serialize=serialize, frame_id='base')
    with write_recording(tmp_path / 'r.mcap') as writer:
        handles = {output: writer.add(f'/arm/{output.name}', output.type) for output in OUTPUTS}
        for estimate in estimates:
            for output, handle in handles.items():
                writer.write_raw(handle, estimate.stamp_ns, filled.bytes_of(output, estimate))
    recording = open_recording(tmp_path / 'r.mcap')
    for output in OUTPUTS:
        topic = recording.find(output.name, output.type)
        messages = [plain(message.message) for message in recording.messages([topic])]
        assert messages == [
            plain(output.encode(estimate, 'base', ROSBAGS_TYPES)) for estimate in estimates
        ]


def test_topics_are_copied_unchanged(tmp_path):
    source = open_recording(write_readings(tmp_path / 'in.mcap'))
    both = [WRENCH, PRESSURE]
    with write_recording(tmp_path / 'out', inputs=[source.path]) as writer:
        handles = {name: writer.add_copy(source.topic(name)) for name in both}
        for topic, log_time, raw in source.raw_messages(both):
            writer.write_raw(handles[topic], log_time, raw)
    copy = open_recording(tmp_path / 'out')
    assert copy.topics == source.topics
    assert list(copy.raw_messages(both)) == list(source.raw_messages(both))


def test_a_type_of_the_lab_is_copied_with_its_definition(tmp_path):
    definition = 'std_msgs/Header header\nfloat64 volts\n' + '=' * 80 + '\nMSG: std_msgs/Header\n'
    definition += 'builtin_interfaces/Time stamp\nstring frame_id\n' + '=' * 80
    definition += '\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n'
    raw = serialize(pressure(5), PRESSURE_TYPE)[:-8]  # header and one number
    with write_recording(tmp_path / 'in.mcap') as writer:
        handle = writer.add('/volts', 'lab_msgs/msg/Volts', definition)
        writer.write_raw(handle, 5, raw)
    source = open_recording(tmp_path / 'in.mcap')
    with write_recording(tmp_path / 'out.mcap') as writer:
        writer.write_raw(writer.add_copy(source.topic('/volts')), 5, raw)
    (message,) = open_recording(tmp_path / 'out.mcap').messages(['/volts'])
    assert message.message.volts == 31e3
    assert plain(message.message.header) == plain(header(5))


def test_the_largest_message_may_follow_small_ones(tmp_path):
    sizes = [CHUNK // 2, LARGEST_CHUNK - CHUNK // 4]
    with write_recording(tmp_path / 'r.mcap') as writer:
        handle = writer.add(PRESSURE, PRESSURE_TYPE)
        for size in sizes:
            writer.write_raw(handle, size, bytes(size))
    recording = open_recording(tmp_path / 'r.mcap')
    assert [len(raw) for _, _, raw in recording.raw_messages([PRESSURE])] == sizes


def test_a_recording_without_messages_is_one(tmp_path):
    with write_recording(tmp_path / 'r.mcap') as writer:
        writer.add(PRESSURE, PRESSURE_TYPE)
    recording = open_recording(tmp_path / 'r.mcap')
    assert recording.topic(PRESSURE).count == 0
    assert (recording.start_ns, recording.end_ns) == (0, 0)
    assert list(recording.messages([PRESSURE])) == []


def test_the_same_content_gives_the_same_bytes(tmp_path):
    first = write_readings(tmp_path / 'a' / 'r.mcap').read_bytes()
    assert write_readings(tmp_path / 'b' / 'r.mcap').read_bytes() == first


# ---- what is refused ----------------------------------------------------------------------------


def test_an_unknown_type_is_refused(tmp_path):
    with refused(RecordingError, 'unknown_type'), write_recording(tmp_path / 'r.mcap') as writer:
        writer.add('/volts', 'lab_msgs/msg/Volts')
    assert names(tmp_path) == []


def test_a_topic_is_added_once(tmp_path):
    with refused(RecordingError, 'given_twice'), write_recording(tmp_path / 'r.mcap') as writer:
        writer.add(PRESSURE, PRESSURE_TYPE)
        writer.add(PRESSURE, WRENCH_TYPE)


def test_unfit_content_is_refused(tmp_path):
    with refused(MessageError, 'not_serialized'), write_recording(tmp_path / 'r.mcap') as writer:
        writer.write(writer.add(PRESSURE, PRESSURE_TYPE), 0, pressure(0, value='high'))


def test_a_log_time_before_1970_is_refused(tmp_path):
    with refused(RecordingError, 'out_of_bounds'), write_recording(tmp_path / 'r.mcap') as writer:
        writer.write(writer.add(PRESSURE, PRESSURE_TYPE), -1, pressure(0))


@pytest.mark.parametrize('name', ['out.db3', 'out.bag', 'out.txt', 'out.MCAP'])
def test_names_of_other_formats_are_refused(tmp_path, name):
    with refused(RecordingError, 'wrong_suffix'):
        write_readings(tmp_path / name)


@pytest.mark.parametrize('name', ['file.mcap', 'folder', 'day_25.11'])
def test_an_existing_output_is_refused_or_replaced_at_the_end(tmp_path, name):
    path = write_readings(tmp_path / name)
    with refused(RecordingError, 'exists'):
        write_readings(path)
    with pytest.raises(KeyError), write_recording(path, overwrite=True) as writer:
        writer.add(PRESSURE, PRESSURE_TYPE)
        raise KeyError
    assert open_recording(path).count([PRESSURE]) == 100
    with write_recording(path, overwrite=True) as writer:
        writer.write(writer.add(PRESSURE, PRESSURE_TYPE), 0, pressure(0))
    assert open_recording(path).count([PRESSURE]) == 1
    assert names(tmp_path) == [name]


def test_a_folder_that_is_no_recording_is_never_replaced(tmp_path):
    folder = write_readings(tmp_path / 'arm')
    (folder / 'notes.txt').write_text('mine')
    with refused(RecordingError, 'holds_other_files'), write_recording(folder, overwrite=True):
        pytest.fail('work was done')


def test_the_input_is_not_overwritten(tmp_path):
    path = write_readings(tmp_path / 'in.mcap')
    with (
        refused(RecordingError, 'overwrites_input'),
        write_recording(path, overwrite=True, inputs=[path]),
    ):
        pytest.fail('work was done')


@pytest.mark.parametrize('name', ['file.mcap', 'folder'])
@pytest.mark.parametrize('when', ['write', 'close'])
def test_a_full_disk_is_a_sentence_and_leaves_nothing(tmp_path, monkeypatch, name, when):
    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    with refused(RecordingError, 'unwritable'), write_recording(tmp_path / name) as writer:
        monkeypatch.setattr(f'{MessageStorage.__module__}.MessageStorage.{when}', full)
        writer.write(writer.add(PRESSURE, PRESSURE_TYPE), 0, pressure(0))
    assert names(tmp_path) == []


def test_a_disk_that_is_really_full_leaves_nothing(tmp_path, foreign_environment):
    # No device of limited size without root: a limit on the size of files is as good.
    code = (
        'import resource, signal, sys\n'
        'from support.made_recordings import write_readings\n'
        'from pneunet_ros.core.errors import RecordingError\n'
        'signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n'
        'resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))\n'
        'try:\n'
        '    write_readings(sys.argv[1], count=20_000)\n'
        'except RecordingError as error:\n'
        '    print(error.reason)\n'
    )
    result = run(code, str(tmp_path / 'r.mcap'), env=foreign_environment)
    assert result.stdout == 'unwritable\n'
    assert names(tmp_path) == []


@pytest.mark.parametrize('name', ['file.mcap', 'folder'])
def test_after_a_kill_nothing_stands_under_the_name(tmp_path, name, foreign_environment):
    code = (
        'import itertools, os, signal, sys\n'
        'from support.made_recordings import PRESSURE, pressure\n'
        'from pneunet_ros.messages.readings import PRESSURE_TYPE\n'
        'from pneunet_ros.recordings.recording_writer import write_recording\n'
        'with write_recording(sys.argv[1]) as writer:\n'
        '    handle = writer.add(PRESSURE, PRESSURE_TYPE)\n'
        '    for index in range(20_000):\n'
        '        writer.write(handle, index, pressure(index))\n'
        '    os.kill(os.getpid(), signal.SIGKILL)\n'
    )
    result = run(code, str(tmp_path / name), env=foreign_environment)
    assert result.returncode == -signal.SIGKILL
    assert not (tmp_path / name).exists()
    (left,) = names(tmp_path)
    assert left.startswith('.')
    assert left.endswith('.partial')
    # What was written so far can be had until the next run, which removes it.
    (unfinished,) = (tmp_path / left).rglob('*.mcap')
    recording = open_recording(unfinished)
    assert recording.count([PRESSURE]) > 1000
    assert len(recording.sentences) == 1
    write_readings(tmp_path / name)
    assert names(tmp_path) == [name]


def run(code, argument, env):
    root = Path(__file__).resolve().parents[2]
    return subprocess.run(
        [sys.executable, '-c', code, argument],
        env={**env, 'PYTHONPATH': f'{root}:{root / "test"}'},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def test_a_folder_of_other_recordings_is_never_replaced(tmp_path):
    data = tmp_path / 'data'
    data.mkdir()
    for name in ('monday.mcap', 'tuesday.mcap'):
        write_readings(data / name)
    with refused(RecordingError, 'holds_other_files'), write_recording(data, overwrite=True):
        pytest.fail('work was done')
    assert names(data) == ['monday.mcap', 'tuesday.mcap']


def test_a_folder_that_was_renamed_is_replaced_with_the_files_that_it_lists(tmp_path):
    write_readings(tmp_path / 'arm').rename(tmp_path / 'better')
    with write_recording(tmp_path / 'better', overwrite=True) as writer:
        writer.write(writer.add(PRESSURE, PRESSURE_TYPE), 0, pressure(0))
    assert open_recording(tmp_path / 'better').count([PRESSURE]) == 1

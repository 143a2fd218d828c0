"""Files written are read by mcap's own readers, seeking and not, with all checksums right."""

from __future__ import annotations

from io import BytesIO

from mcap.reader import NonSeekingReader, SeekingReader
from mcap.stream_reader import StreamReader
from pneunet_ros.mcap_file import open_mcap
from pneunet_ros.mcap_writer import McapWriter
import pytest


def written(messages, chunk_size=None, monkeypatch=None, channels=2):
    """A file of (channel, log time, data)."""
    if chunk_size:
        monkeypatch.setattr('pneunet_ros.mcap_writer.CHUNK_SIZE', chunk_size)
    stream = BytesIO()
    writer = McapWriter(stream, 'ros2')
    schema = writer.add_schema('std_msgs/msg/String', 'ros2msg', b'string data\n')
    for channel in range(1, channels + 1):
        assert writer.add_channel(f'/{channel}', schema, {'key': 'value'}) == channel
    for channel, log_time, data in messages:
        writer.write(channel, log_time, data)
    writer.finish('rosbag2', {'serialized_metadata': 'text'})
    return stream.getvalue()


MESSAGES = [(1 + index % 2, 1000 - index, bytes(index % 7)) for index in range(200)]


@pytest.mark.parametrize('chunk_size', [None, 1, 500])
@pytest.mark.parametrize('reader_class', [SeekingReader, NonSeekingReader])
def test_readers_of_mcap_find_all_messages(monkeypatch, chunk_size, reader_class):
    raw = written(MESSAGES, chunk_size, monkeypatch)
    reader = reader_class(BytesIO(raw), validate_crcs=True)
    found = [
        (channel.topic, message.log_time, message.publish_time, message.data)
        for _, channel, message in reader.iter_messages()
    ]
    assert found == [(f'/{c}', time, time, data) for c, time, data in reversed(MESSAGES)]


def test_all_records_are_well_formed(monkeypatch):
    raw = written(MESSAGES, 500, monkeypatch)
    records = list(StreamReader(BytesIO(raw), validate_crcs=True).records)
    kinds = [type(record).__name__ for record in records]
    assert kinds[:4] == ['Header', 'Schema', 'Channel', 'Channel']
    assert kinds[-1] == 'Footer'
    assert kinds.count('Message') == 200
    assert kinds.count('SummaryOffset') == 5


def test_the_summary_tells_what_there_is(monkeypatch):
    reader = SeekingReader(BytesIO(written(MESSAGES, 500, monkeypatch)), validate_crcs=True)
    assert (reader.get_header().profile, reader.get_header().library) == ('ros2', 'pneunet_ros')
    summary = reader.get_summary()
    assert summary.statistics.message_count == 200
    assert summary.statistics.channel_message_counts == {1: 100, 2: 100}
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 5
    assert summary.statistics.message_start_time == 801
    assert summary.statistics.message_end_time == 1000
    assert [channel.metadata for channel in summary.channels.values()] == [{'key': 'value'}] * 2
    (metadata,) = reader.iter_metadata()
    assert metadata.metadata == {'serialized_metadata': 'text'}


def test_places_in_the_index_are_those_of_the_messages(monkeypatch):
    raw = written(MESSAGES, 500, monkeypatch)
    records = list(StreamReader(BytesIO(raw), emit_chunks=True).records)
    data, checked = b'', 0
    for record in records:
        if type(record).__name__ == 'Chunk':
            data = record.data
        if type(record).__name__ == 'MessageIndex':
            for log_time, place in record.records:
                assert data[place] == 5  # a message
                assert data[place + 15 : place + 23] == log_time.to_bytes(8, 'little')
                checked += 1
    assert checked == 200


def test_a_topic_may_come_later(tmp_path, monkeypatch):
    monkeypatch.setattr('pneunet_ros.mcap_writer.CHUNK_SIZE', 100)
    path = tmp_path / 'r.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream, 'ros2')
        schema = writer.add_schema('std_msgs/msg/String', 'ros2msg', b'')
        first = writer.add_channel('/first', schema, {})
        for log_time in range(20):
            writer.write(first, log_time, b'12345678')
        late = writer.add_channel('/late', writer.add_schema('a/msg/B', 'ros2msg', b''), {})
        writer.write(late, 20, b'')
        writer.finish('rosbag2', {})
    file = open_mcap(path)
    assert file.counts == {first: 20, late: 1}
    assert file.damage is None


def test_a_file_without_messages_is_well_formed():
    reader = SeekingReader(BytesIO(written([])), validate_crcs=True)
    summary = reader.get_summary()
    assert summary.statistics.message_count == 0
    assert [channel.topic for channel in summary.channels.values()] == ['/1', '/2']
    assert list(reader.iter_messages()) == []

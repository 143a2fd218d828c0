"""What an MCAP file holds, be it whole, unindexed, compressed, cut off or damaged."""

from __future__ import annotations

from mcap.writer import CompressionType, IndexType
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.recordings.mcap_file import MAGIC, open_mcap, read_block
import pytest
from support.made_recordings import write_by_mcap, write_readings

TIMES = [index * 1000 for index in range(200)]

SHAPES = {
    'plain': {},
    'zstd': {'compression': CompressionType.ZSTD},
    'lz4': {'compression': CompressionType.LZ4},
    'no_chunks': {'use_chunking': False},
    'no_index': {'index_types': IndexType.NONE},
    'no_message_index': {'index_types': IndexType.CHUNK},
    'no_statistics': {'use_statistics': False},
    'no_repeated_channels': {'repeat_channels': False},
    'no_repeated_schemas': {'repeat_schemas': False},
    'no_checksums': {'enable_crcs': False},
    'no_summary': {
        'index_types': IndexType.NONE,
        'repeat_channels': False,
        'repeat_schemas': False,
        'use_statistics': False,
        'use_summary_offsets': False,
    },
}


def log_times(file):
    with file.path.open('rb') as stream:
        return [
            log_time
            for block in file.blocks
            for _, log_time, _ in read_block(file.path, stream, block)
        ]


@pytest.mark.parametrize('shape', SHAPES)
def test_every_way_to_write_a_file_reads_the_same(tmp_path, shape):
    file = open_mcap(write_by_mcap(tmp_path / 'r.mcap', TIMES, **SHAPES[shape]))
    assert file.damage is None
    assert log_times(file) == TIMES
    assert sum(file.counts.values()) == len(TIMES)
    assert [channel.topic for channel in file.channels.values()] == ['/pneunet/pressure']
    assert [schema.encoding for schema in file.schemas.values()] == ['ros2msg']
    for block in file.blocks:
        assert block.channels == {1}
        assert block.start_ns <= block.end_ns


def test_messages_outside_of_chunks_are_split_into_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr('pneunet_ros.recordings.mcap_file.LOOSE_RUN', 2000)
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, use_chunking=False)
    file = open_mcap(path)
    assert len(file.blocks) > 5
    assert log_times(file) == TIMES


@pytest.mark.parametrize('shape', ['plain', 'zstd', 'lz4', 'no_chunks'])
def test_a_file_cut_off_anywhere_is_read_as_far_as_it_goes(tmp_path, shape):
    whole = write_by_mcap(tmp_path / 'whole.mcap', TIMES, **SHAPES[shape]).read_bytes()
    path = tmp_path / 'cut.mcap'
    counts = []
    for size in [*range(len(MAGIC), len(whole), 197), *range(len(whole) - 40, len(whole))]:
        path.write_bytes(whole[:size])
        file = open_mcap(path)
        found = log_times(file)
        counts.append(len(found))
        assert found == TIMES[: len(found)]
        assert file.damage in (
            f'{path} ends in the middle of a record: {len(found)} messages were read',
            f'{path} was not closed by its writer: {len(found)} messages were read',
        )
    assert counts == sorted(counts)
    assert counts[-1] == len(TIMES)
    # Not only whole chunks: what is there of the last one counts, too.
    if shape in ('plain', 'no_chunks'):
        assert len(set(counts)) > 50


def test_a_recording_of_one_chunk_is_not_lost_when_it_is_cut_off(tmp_path):
    path = write_readings(tmp_path / 'r.mcap')
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    file = open_mcap(path)
    assert len(file.blocks) == 1
    assert sum(file.counts.values()) > 50


def test_zeros_of_a_crashed_file_system_end_the_file(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2] + bytes(100_000))
    file = open_mcap(path)
    assert 0 < len(log_times(file)) < len(TIMES)
    assert file.damage is not None


def test_damage_inside_a_whole_file_is_an_error_with_its_place(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES)
    raw = bytearray(path.read_bytes())
    place = open_mcap(path).blocks[3].offset
    raw[place + 300] ^= 1
    path.write_bytes(raw)
    file = open_mcap(path)
    with pytest.raises(RecordingError, match=rf'r\.mcap is damaged in the chunk at byte {place}'):
        log_times(file)


@pytest.mark.parametrize('shape', ['plain', 'zstd', 'lz4'])
def test_damage_inside_an_unindexed_file_ends_it(tmp_path, shape):
    options = SHAPES['no_summary'] | SHAPES[shape]
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, **options)
    raw = bytearray(path.read_bytes())
    raw[len(raw) // 2] ^= 1
    path.write_bytes(raw)
    file = open_mcap(path)
    assert 'is damaged at byte' in file.damage
    assert log_times(file) == TIMES[: sum(file.counts.values())]


def test_unknown_compression_is_named(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, compression=CompressionType.LZ4)
    path.write_bytes(path.read_bytes().replace(b'lz4', b'lz9'))
    with pytest.raises(RecordingError, match="compression 'lz9' is unknown, zstd and lz4"):
        log_times(open_mcap(path))


@pytest.mark.parametrize(
    ('content', 'sentence'),
    [
        (b'', 'is empty'),
        (b'#ROSBAG V2.0\n', 'is no MCAP file'),
        (b'SQLite format 3\0' + bytes(100), 'ros2 bag convert'),
        (MAGIC[:5], 'is no MCAP file'),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, sentence):
    path = tmp_path / 'r.mcap'
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=rf'r\.mcap {sentence}|{sentence}'):
        open_mcap(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(RecordingError, match=r'r\.mcap cannot be read: No such file'):
        open_mcap(tmp_path / 'r.mcap')


def test_only_magic_is_a_recording_without_messages(tmp_path):
    path = tmp_path / 'r.mcap'
    path.write_bytes(MAGIC)
    file = open_mcap(path)
    assert file.blocks == ()
    assert file.damage == f'{path} was not closed by its writer: 0 messages were read'

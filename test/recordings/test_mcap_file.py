"""What an MCAP file holds, be it whole, unindexed, compressed, cut off or damaged."""

from __future__ import annotations

import random
import re
import struct
import tracemalloc
import zlib

from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Footer
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.recordings import mcap_file
from pneunet_ros.recordings.mcap_file import open_mcap, read_block
from pneunet_ros.recordings.mcap_records import MAGIC
from pneunet_ros.recordings.recording import open_recording
import pytest
from support.made_recordings import PRESSURE, WRENCH, write_by_mcap, write_readings
from support.refusals import reasons, refused
import zstandard

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
    assert file.damage == ()
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
            (f'{path} ends in the middle of a record: {len(found)} messages were read',),
            (f'{path} was not closed by its writer: {len(found)} messages were read',),
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
    assert file.damage


@pytest.mark.parametrize('shape', ['plain', 'zstd', 'lz4', 'no_index'])
def test_a_damaged_chunk_is_skipped_and_said(tmp_path, shape):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, **SHAPES[shape])
    raw = bytearray(path.read_bytes())
    block = open_mcap(path).blocks[3]
    raw[block.offset + block.length - 30] ^= 1
    path.write_bytes(raw)
    file = open_mcap(path)
    found = log_times(file)
    lost = [time for time in TIMES if block.start_ns <= time <= block.end_ns]
    assert found == [time for time in TIMES if time not in lost]
    (note,) = file.damage
    assert note.reason == 'damaged'
    assert (str(block.offset) in note, f'{len(lost)} of 200 ' in note) == (True, True)


@pytest.mark.parametrize('shape', ['plain', 'zstd', 'lz4'])
def test_damage_inside_an_unindexed_file_is_said_as_well(tmp_path, shape):
    options = SHAPES['no_summary'] | SHAPES[shape]
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, **options)
    blocks = open_mcap(path).blocks
    raw = bytearray(path.read_bytes())
    for block in blocks[2:5]:
        raw[block.offset + block.length - 30] ^= 1
    path.write_bytes(raw)
    file = open_mcap(path)
    assert (file.damage[0].reason, str(blocks[2].offset) in file.damage[0]) == ('damaged', True)
    assert len(file.blocks) == len(blocks) - 3


def test_of_a_file_that_is_cut_off_the_damaged_chunks_are_said_too(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES)
    raw = bytearray(path.read_bytes())
    block = open_mcap(path).blocks[3]
    raw[block.offset + block.length - 30] ^= 1
    path.write_bytes(raw[: len(raw) // 2])
    damage = open_mcap(path).damage
    assert reasons(damage) == ['damaged', 'cut_off']
    assert str(block.offset) in damage[0]


def test_a_huge_attachment_between_messages_is_not_read(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES[:20], use_chunking=False)
    raw = path.read_bytes()
    blocks = open_mcap(path).blocks
    start, size = blocks[0].offset + blocks[0].length // 20, 20_000_000_000
    with path.open('wb') as stream:
        stream.write(raw[:start] + struct.pack('<BQ', Opcode.ATTACHMENT, size))
        stream.truncate(stream.tell() + size)
        stream.seek(0, 2)
        stream.write(raw[start:])
    file = open_mcap(path)
    assert log_times(file) == TIMES[:20]
    assert len(file.blocks) == 2


def test_a_file_that_lost_messages_without_a_trace_says_so(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, chunk_size=2000)
    raw = path.read_bytes()
    block = open_mcap(path).blocks[3]
    path.write_bytes(raw[: block.offset] + raw[block.offset + block.length :])
    count = len(log_times(open_mcap(path)))
    assert count < len(TIMES)
    (note,) = open_mcap(path).damage
    assert (note.reason, '200' in note, str(count) in note) == ('lost', True, True)


@pytest.mark.parametrize('name', ['r.mcap', 'bag'])
def test_no_flipped_bit_of_a_recording_of_ours_is_silent(tmp_path, name):
    path = write_readings(tmp_path / name, 5)
    file = path if path.is_file() else path / f'{name}.mcap'
    whole = file.read_bytes()
    topics = [PRESSURE, WRENCH]
    before = list(open_recording(path).raw_messages(topics))
    dice = random.Random(8)
    silent = []
    for _ in range(400):
        raw = bytearray(whole)
        place = dice.randrange(len(raw))
        raw[place] ^= 1 << dice.randrange(8)
        file.write_bytes(raw)
        try:
            recording = open_recording(path)
            after = list(recording.raw_messages(topics))
        except RecordingError:
            continue
        if after != before and not recording.sentences:
            silent.append(place)
    assert silent == []


def test_what_we_write_has_every_checksum_that_mcap_knows(tmp_path):
    path = write_readings(tmp_path / 'r.mcap')
    raw = path.read_bytes()
    with path.open('rb') as stream:
        found = {type(record): record for record in StreamReader(stream, emit_chunks=True).records}
    assert found[Chunk].uncompressed_crc == zlib.crc32(found[Chunk].data)
    data = raw.rindex(struct.pack('<BQI', Opcode.DATA_END, 4, found[DataEnd].data_section_crc))
    assert found[DataEnd].data_section_crc == zlib.crc32(raw[:data])
    summary = raw[found[Footer].summary_start : -len(MAGIC) - 4]
    assert found[Footer].summary_crc == zlib.crc32(summary)


# ---- files that are made to exhaust a machine ---------------------------------------------------


def chunk_record(content: bytes, size: int | None = None) -> bytes:
    """Return a chunk of zstd that announces so many bytes."""
    packed = zstandard.compress(content)
    size = len(content) if size is None else size
    head = struct.pack('<QQQII', 0, 0, size, 0, 4) + b'zstd' + struct.pack('<Q', len(packed))
    return struct.pack('<BQ', Opcode.CHUNK, len(head) + len(packed)) + head + packed


def write_chunks(path, *chunks):
    head = struct.pack('<BQII', Opcode.HEADER, 8, 0, 0)
    path.write_bytes(MAGIC + head + b''.join(chunks))
    return path


def test_a_chunk_of_empty_messages_is_refused(tmp_path):
    message = struct.pack('<BQHIQQ', Opcode.MESSAGE, 22, 1, 0, 0, 0)
    path = write_chunks(tmp_path / 'r.mcap', chunk_record(message * 200_000))
    assert path.stat().st_size < 9_000
    with refused(RecordingError, 'too_large'):
        open_mcap(path)


def test_a_chunk_of_records_of_no_kind_is_refused_at_once(tmp_path, monkeypatch):
    path = write_chunks(tmp_path / 'r.mcap', chunk_record(bytes(90_000_000)))
    heads = iter(range(10**6))  # ten million would be there
    monkeypatch.setattr(
        mcap_file, 'records', lambda data: ((0, next(heads), 0) for _ in range(10**7))
    )
    with refused(RecordingError, 'too_large'):
        open_mcap(path)


def test_chunks_of_nothing_are_refused_before_they_fill_the_memory(tmp_path):
    nothing = chunk_record(struct.pack('<BQ', 0x80, 30_000_000) + bytes(30_000_000))
    path = write_chunks(tmp_path / 'r.mcap', *[nothing] * 6)
    tracemalloc.start()
    try:
        with refused(RecordingError, 'too_large'):
            open_mcap(path)
        assert tracemalloc.get_traced_memory()[1] < 100_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize('opcode', [Opcode.CHUNK, Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL])
def test_a_sparse_huge_record_is_not_read(tmp_path, opcode):
    path = write_chunks(tmp_path / 'r.mcap')
    size = 20_000_000_000
    with path.open('r+b') as stream:
        stream.seek(0, 2)
        stream.write(struct.pack('<BQ', opcode, size))
        stream.truncate(stream.tell() + size)
        stream.seek(0, 2)
        stream.write(struct.pack('<BQI', Opcode.DATA_END, 4, 0))
        stream.write(struct.pack('<BQQQI', Opcode.FOOTER, 20, 0, 0, 0) + MAGIC)
    assert open_mcap(path).damage[0].reason == 'damaged'


def test_messages_logged_beyond_what_a_clock_can_say_are_left_out(tmp_path):
    times = [*TIMES[:20], 2**63, 2**64 - 1]
    file = open_mcap(write_by_mcap(tmp_path / 'r.mcap', times))
    assert log_times(file) == TIMES[:20]
    (note,) = file.damage
    assert (note.reason, ' 2 ' in note) == ('too_late', True)


def test_unknown_compression_is_named(tmp_path):
    path = write_by_mcap(tmp_path / 'r.mcap', TIMES, compression=CompressionType.LZ4)
    path.write_bytes(path.read_bytes().replace(b'lz4', b'lz9'))
    with refused(RecordingError, 'damaged'):
        open_mcap(path)


@pytest.mark.parametrize(
    ('content', 'reason'),
    [
        (b'', 'empty'),
        (b'#ROSBAG V2.0\n', 'wrong_kind'),
        (b'SQLite format 3\0' + bytes(100), 'wrong_kind'),
        (MAGIC[:5], 'wrong_kind'),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, reason):
    path = tmp_path / 'r.mcap'
    path.write_bytes(content)
    with refused(RecordingError, reason):
        open_mcap(path)


@pytest.mark.parametrize(
    ('name', 'sentence'),
    [
        ('film.MP4', r'film\.MP4 contains images: `pneunet track FILM --readings TABLE\.csv'),
        ('film.avi', 'film.avi contains images: `pneunet track FILM'),
        ('t.csv', r't\.csv is a table: `pneunet import TABLE\.csv --output REC\.mcap`'),
        ('bag.db3', 'bag.db3 is not an MCAP file: .*ros2 bag convert'),
    ],
)
def test_the_verb_that_takes_a_film_or_a_table_is_named(tmp_path, name, sentence):
    path = tmp_path / name
    path.write_bytes(b'time_s,pressure_pa')
    with refused(RecordingError, 'wrong_kind') as caught:
        open_mcap(path)
    assert re.search(sentence, str(caught.value))


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with refused(RecordingError, 'unreadable'):
        open_mcap(tmp_path / 'r.mcap')


def test_only_magic_is_a_recording_without_messages(tmp_path):
    path = tmp_path / 'r.mcap'
    path.write_bytes(MAGIC)
    file = open_mcap(path)
    assert file.blocks == ()
    assert reasons(file.damage) == ['damaged']

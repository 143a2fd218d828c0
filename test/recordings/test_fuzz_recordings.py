"""Recordings, damaged in any way: what they still hold, or a sentence; never anything else."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
import struct
import tracemalloc
from typing import Any

from hypothesis import strategies as st
import lz4.frame
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer
from pneunet_ros.core.errors import MessageError, RecordingError
from pneunet_ros.messages.builders import POINTS_TYPE
from pneunet_ros.messages.readings import PRESSURE_TYPE, targets_message, WRENCH_TYPE
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.limits import LARGEST_CHUNK
from pneunet_ros.recordings.mcap_records import chunk_content
from pneunet_ros.recordings.message_store import (
    deserialize,
    IDL_HEAD,
    jazzy,
    ROSBAGS_TYPES,
    SEPARATOR,
    serialize,
    store_for,
)
from pneunet_ros.recordings.recording import open_recording
from pneunet_ros.recordings.recording_writer import write_recording
import pytest
from support.fuzzing import AMOUNTS, answer, damaged_bytes, damaged_text, fuzz
from support.made_recordings import PRESSURE, pressure, STEP_NS, WRENCH, wrench
import zstandard

TARGETS = '/pneunet/targets'
SHAPES: dict[str, dict[str, Any]] = {
    'plain': {},
    'zstd': {'compression': CompressionType.ZSTD},
    'lz4': {'compression': CompressionType.LZ4},
    'no chunks': {'use_chunking': False},
    'no checksums': {'enable_crcs': False, 'compression': CompressionType.ZSTD},
    'no index': {'index_types': IndexType.NONE},
}


def whole_recording(path: Path, **options: Any) -> bytes:
    """Write readings and targets of a short run by mcap's own writer."""
    options = {'compression': CompressionType.NONE, 'chunk_size': 1500} | options
    with path.open('wb') as stream:
        writer = Writer(stream, **options)
        writer.start('ros2')
        channels = {}
        for topic, kind in (
            (PRESSURE, PRESSURE_TYPE),
            (WRENCH, WRENCH_TYPE),
            (TARGETS, POINTS_TYPE),
        ):
            definition = jazzy().generate_msgdef(kind, ros_version=2)[0]
            schema = writer.register_schema(kind, 'ros2msg', definition.encode())
            channels[topic] = kind, writer.register_channel(topic, 'cdr', schema)
        for stamp in range(STEP_NS, 9 * STEP_NS, STEP_NS):
            seen = targets_message(stamp, [0.0, 0.1], [0.0, 0.01], 'pneunet_base', ROSBAGS_TYPES)
            for topic, message in (
                (WRENCH, wrench(stamp)),
                (PRESSURE, pressure(stamp)),
                (TARGETS, seen),
            ):
                kind, channel = channels[topic]
                writer.add_message(channel, stamp, serialize(message, kind), stamp)
        writer.finish()
    return path.read_bytes()


def read_all(path: Path) -> int:
    """Read everything that is there in every way there is, and copy it."""
    recording = open_recording(path)
    assert all(isinstance(sentence, str) for sentence in recording.sentences)
    names = [topic.name for topic in recording.topics]
    times = [message.log_time_ns for message in recording.raw_messages(names)]
    assert times == sorted(times)
    return len(times)


def decode_all(path: Path) -> None:
    """Decode every topic and copy all of it as replay does."""
    recording = open_recording(path)
    output = path.with_name('copy.mcap')
    with write_recording(output, overwrite=True) as writer:
        topics = {topic.name: writer.add_copy(topic) for topic in recording.topics}
        for message in recording.messages(list(topics)):
            writer.write_raw(topics[message.topic], message.log_time_ns, message.raw)


@AMOUNTS
@pytest.mark.parametrize('shape', SHAPES)
def test_any_bytes_are_read_or_refused(tmp_path, shape, examples):
    path = tmp_path / 'r.mcap'
    whole = whole_recording(path, **SHAPES[shape])
    assert answer(read_all, path) == 24
    assert answer(read_run, path, 2)[0].x.shape == (8, 2)

    def body(raw: bytes) -> None:
        path.write_bytes(raw)
        for attempt in (read_all, decode_all):
            answer(attempt, path)
        answer(read_run, path, 2)

    fuzz(max(examples // 3, 20), body, raw=damaged_bytes(whole))


def test_topics_that_were_announced_and_stayed_empty_are_named(tmp_path):
    with write_recording(tmp_path / 'r.mcap') as writer:
        for topic, kind in ((PRESSURE, PRESSURE_TYPE), (TARGETS, POINTS_TYPE)):
            writer.add(topic, kind)
        writer.write(writer.add(WRENCH, WRENCH_TYPE), STEP_NS, wrench(STEP_NS))
    found = answer(read_run, tmp_path / 'r.mcap', 2)
    assert isinstance(found, RecordingError)
    assert found.reason == 'nothing_usable'


@pytest.mark.parametrize('compression', ['zstd', 'lz4'])
def test_a_chunk_is_not_unpacked_beyond_what_it_announces(compression):
    packed = zstandard.compress if compression == 'zstd' else lz4.frame.compress
    bomb = packed(bytes(400_000_000))

    def chunk(size: int) -> bytes:
        head = struct.pack('<QQQII', 0, 0, size, 0, len(compression)) + compression.encode()
        content = head + struct.pack('<Q', len(bomb)) + bomb
        return struct.pack('<BQ', Opcode.CHUNK, len(content)) + content

    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match='size'):
            chunk_content(chunk(1000))
        with pytest.raises(ValueError, match=str(LARGEST_CHUNK)):
            chunk_content(chunk(LARGEST_CHUNK + 1))
        assert tracemalloc.get_traced_memory()[1] < 100_000_000
    finally:
        tracemalloc.stop()


# ---- definitions of types, which become code in the library that reads them ---------------------

LINES = [
    'string[1000000000] a', 'std_msgs/Empty[1000000000] a', 'float64[1000000000] a',
    'float64[] a', 'pneunet/Own a', 'pneunet/Own[3] a', 'string<=5 a', 'wstring a',
    'string A="""', "string A='''", 'int32 A=5',
    'string A=\\"\\"\\"', 'uint8 class', 'uint8 __class__', 'uint8 import',
    'int32 a 5', 'sensor_msgs/FluidPressure a', 'Header header', '# comment', '=' * 80,
    'MSG: pneunet/Own',
    'MSG: std_msgs/Header', 'MSG: a/b/c/d', 'byte[<=3] b', 'int64 c', 'string A=__import__("os")',
    'IDL: pneunet/Own', 'module a { struct B { long c; }; };', '@verbatim', 'string A=\\',
]  # fmt: skip
RAW = serialize(pressure(1), PRESSURE_TYPE)


def learn(definition: str, name: str, raw: bytes) -> None:
    store = store_for(name, definition)
    with suppress(MessageError):
        deserialize(raw, name, store)
    store.generate_msgdef(name, ros_version=2)


@AMOUNTS
def test_any_definition_is_learned_or_refused(examples):
    whole = jazzy().generate_msgdef(PRESSURE_TYPE, ros_version=2)[0]
    scraps = st.sampled_from([f'\n{line}\n' for line in LINES]) | st.text(max_size=5)
    names = st.sampled_from(
        [PRESSURE_TYPE, 'pneunet/msg/Own', 'pneunet/Own', 'a\nb', '', '../x/msg/Y']
    )
    raws = damaged_bytes(RAW)

    def body(definition: str, name: str, raw: bytes) -> None:
        answer(learn, definition, name, raw)

    fuzz(examples, body, definition=damaged_text(whole, scraps), name=names, raw=raws)


DIFFICULT = {
    'parentheses in parentheses': f'{IDL_HEAD}a/msg/B\nmodule a {{ const long A = ((((1)))); }};',
    'very long': '# comment\n' * 30_000,
    'arrays that become code': 'string[100000] a',
    'arrays of arrays': f'Part[5000] a\nPart[5001] b\n{SEPARATOR}MSG: a/Part\nstring a\n',
    'itself': 'a/Own a',
    'unknown': 'b/Other a',
}


@pytest.mark.parametrize('what', DIFFICULT)
def test_definitions_that_would_take_forever_are_refused(what):
    found = answer(store_for, 'a/msg/Own', DIFFICULT[what])
    assert isinstance(found, RecordingError)
    assert 'a/msg/Own' in str(found)


def test_parentheses_in_comments_of_a_definition_do_no_harm():
    text = """@verbatim (language="comment", text="a (b (c))" "(\\"(")"""
    definition = (
        f'{IDL_HEAD}a/msg/B\nmodule a {{ module msg {{ {text} struct B {{ long c; }}; }}; }};'
    )
    assert 'a/msg/B' in store_for('a/msg/B', definition).fielddefs


@pytest.mark.parametrize('line', LINES)
def test_no_definition_executes(tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    touch = '__import__("pathlib").Path("was_here").touch()'
    for text in (line, f'string A=""" + {touch} + """', f'int32 a[{touch}]', f'int32 {touch}'):
        answer(learn, f'{text}\n{line}\n', 'pneunet/msg/Own', RAW)
        answer(learn, 'int32 a\n', f'pneunet/msg/Own\n{text}', RAW)
    assert not list(tmp_path.iterdir())

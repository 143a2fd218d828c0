"""An MCAP file written: chunks with checksums and indexes, as rosbag2 and Foxglove expect them.

The `mcap` package writes such files as well; this writer spends a quarter of the time per message,
which is most of what a replay costs.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping
import struct
import sys
from typing import BinaryIO
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b'\x89MCAP0\r\n'
LIBRARY = 'pneunet_ros'
CHUNK_SIZE = 1 << 20  # bytes of records after which a chunk is closed

_MESSAGE = struct.Struct('<BQHIQQ')  # opcode, length; channel, sequence, log time, publish time
_MESSAGE_LENGTH = _MESSAGE.size - 9  # of what follows opcode and length, without the data
# Opcode, length; first and last log time, size, checksum, no compression, size as stored.
_CHUNK = struct.Struct('<BQQQQIIQ')
_INDEX = struct.Struct('<BQHI')  # opcode, length; channel, bytes of entries


class McapWriter:
    """Writes records into a stream; `finish` makes it a file that can be read from its index."""

    def __init__(self, stream: BinaryIO, profile: str) -> None:
        """Begin a file in an open stream; profile: what kind of messages it holds, 'ros2'."""
        self._stream = stream
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self.counts: Counter[int] = Counter()  # messages in closed chunks, by channel
        # The chunk being filled: its records, their size, and (log time, place) by channel.
        self._records: list[bytes] = []
        self._size = 0
        self._indexes: dict[int, array[int]] = {}
        stream.write(MAGIC + _bytes(Header(profile=profile, library=LIBRARY)))
        self._position = stream.tell()

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Define a type of messages; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._append(_bytes(schema))
        return len(self._schemas)

    def add_channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Define a topic of CDR messages; returns its id."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding='cdr',
            schema_id=schema,
            metadata=dict(metadata),
        )
        self._channels.append(channel)
        self._indexes[channel.id] = array('Q')
        self._append(_bytes(channel))
        return len(self._channels)

    def write(self, channel: int, log_time: int, data: bytes) -> None:
        """Write a message; log_time in ns from 0 on, which is its publish time, too."""
        length = len(data)
        index = self._indexes[channel]
        index.append(log_time)
        index.append(self._size)
        self._records.append(
            _MESSAGE.pack(Opcode.MESSAGE, _MESSAGE_LENGTH + length, channel, 0, log_time, log_time)
        )
        self._records.append(data)
        self._size += _MESSAGE.size + length
        if self._size > CHUNK_SIZE:
            self.close_chunk()

    @property
    def times(self) -> tuple[int, int]:
        """First and last log time (ns) of all closed chunks, both 0 without messages."""
        start = min((chunk.message_start_time for chunk in self._chunks), default=0)
        return start, max((chunk.message_end_time for chunk in self._chunks), default=0)

    def close_chunk(self) -> None:
        """Write the chunk and its indexes; without messages, its records wait for the first."""
        indexes = {channel: index for channel, index in self._indexes.items() if index}
        if not indexes:
            return
        data = b''.join(self._records)
        start = min(min(index[::2]) for index in indexes.values())
        end = max(max(index[::2]) for index in indexes.values())
        offset = self._position
        self._put(
            _CHUNK.pack(
                Opcode.CHUNK,
                _CHUNK.size - 9 + len(data),
                start,
                end,
                len(data),
                zlib.crc32(data),
                0,
                len(data),
            )
        )
        self._put(data)
        chunk_length = self._position - offset
        places = {}
        for channel, index in indexes.items():
            places[channel] = self._position
            entries = _little_endian(index)
            length = _INDEX.size - 9 + len(entries)
            self._put(_INDEX.pack(Opcode.MESSAGE_INDEX, length, channel, len(entries)) + entries)
            self.counts[channel] += len(index) // 2
            self._indexes[channel] = array('Q')
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=chunk_length,
                message_start_time=start,
                message_end_time=end,
                message_index_offsets=places,
                message_index_length=self._position - offset - chunk_length,
                compression='',
                compressed_size=len(data),
                uncompressed_size=len(data),
            )
        )
        self._records, self._size = [], 0

    def finish(self, name: str, metadata: Mapping[str, str]) -> None:
        """Write one record of metadata, then index and footer; the stream stays open."""
        self.close_chunk()
        record = _bytes(Metadata(name=name, metadata=dict(metadata)))
        place = MetadataIndex(offset=self._position, length=len(record), name=name)
        self._put(record + _bytes(DataEnd(data_section_crc=0)))
        start = self._position
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.METADATA_INDEX, [place]),
        ]
        summary, offsets = b'', b''
        for opcode, entries in groups:
            group = b''.join(_bytes(entry) for entry in entries)
            if group:
                begin = start + len(summary)
                offset = SummaryOffset(
                    group_opcode=opcode, group_start=begin, group_length=len(group)
                )
                offsets += _bytes(offset)
                summary += group
        footer = Footer(
            summary_start=start, summary_offset_start=start + len(summary), summary_crc=0
        )
        # The checksum covers the summary and all of the footer that stands before it.
        footer.summary_crc = zlib.crc32(summary + offsets + _bytes(footer)[:-4])
        self._put(summary + offsets + _bytes(footer) + MAGIC)

    def _append(self, record: bytes) -> None:
        self._records.append(record)
        self._size += len(record)

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)

    def _statistics(self) -> Statistics:
        start, end = self.times
        return Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(self.counts),
            chunk_count=len(self._chunks),
            message_count=self.counts.total(),
            message_start_time=start,
            message_end_time=end,
            metadata_count=1,
            schema_count=len(self._schemas),
        )


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _little_endian(numbers: array[int]) -> bytes:
    if sys.byteorder == 'big':
        numbers = array('Q', numbers)
        numbers.byteswap()
    return numbers.tobytes()

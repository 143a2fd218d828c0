"""The messages of an MCAP file, block by block.

A block is a stretch of the file that holds messages: a chunk, or a run of messages outside of
chunks. It is read whole; nothing else of the file has to be in memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

import lz4.frame
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from pneunet_ros.core.errors import RecordingError
import zstandard

RECORD_HEAD = struct.Struct('<BQ')  # opcode, length of what follows
MESSAGE_HEAD = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time; the data follow
# First and last log time, size and checksum of the content, length of the compression's name.
_CHUNK_HEAD = struct.Struct('<QQQII')

LARGEST_CHUNK = 1_000_000_000  # bytes of its content; writers begin a new one at a few MB

# What the decompressors and the parsing of damaged bytes raise.
DAMAGE = (ValueError, OverflowError, struct.error, RuntimeError, zstandard.ZstdError)


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A stretch of a file: offset and length in bytes, log times in ns, the channels in it.

    `loose`: a run of records outside of chunks; otherwise the record of one chunk.
    """

    offset: int
    length: int
    loose: bool
    start_ns: int
    end_ns: int
    channels: frozenset[int]


@dataclass(frozen=True, slots=True, kw_only=True)
class McapFile:
    """What a file holds: channels and schemas by id, messages per channel, and blocks.

    `damage` is a sentence when the file does not go as far as its writer meant, else None.
    """

    path: Path
    channels: dict[int, Channel]
    schemas: dict[int, Schema]
    counts: dict[int, int]
    blocks: tuple[Block, ...]
    damage: str | None


def read_block(path: Path, stream: BinaryIO, block: Block) -> Iterator[tuple[int, int, bytes]]:
    """Yield the messages of a block as they stand: channel id, log time in ns, serialized bytes.

    Raises RecordingError naming `path` when the block is damaged.
    """
    stream.seek(block.offset)
    data = stream.read(block.length)
    try:
        if not block.loose:
            data = chunk_content(data)
        for opcode, start, end in records(data):
            if opcode == Opcode.MESSAGE:
                channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, start)
                yield channel, log_time, data[start + MESSAGE_HEAD.size : end]
    except DAMAGE as error:
        raise RecordingError(
            f'{path} is damaged in the chunk at byte {block.offset} ({error}): '
            'recover it with `mcap recover`'
        ) from error


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of every whole record in `data`."""
    position, size = 0, len(data)
    while position + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        start = position + RECORD_HEAD.size
        position = start + length
        if position > size:
            return
        yield opcode, start, position


def chunk_content(record: bytes) -> bytes:
    """Return the records inside a chunk's record; of one that is cut off, what there is.

    Raises one of DAMAGE when the content is not what its writer put there.
    """
    _, _, size, checksum, length = _CHUNK_HEAD.unpack_from(record, RECORD_HEAD.size)
    place = RECORD_HEAD.size + _CHUNK_HEAD.size
    compression = record[place : place + length].decode()
    (stored,) = struct.unpack_from('<Q', record, place + length)
    data = record[place + length + 8 :]
    whole = len(data) >= stored
    if size > LARGEST_CHUNK:
        raise ValueError(f'it has {size} bytes, more than {LARGEST_CHUNK}')
    # No more is unpacked than was announced, whatever the bytes would become.
    if compression == 'zstd':
        data = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
    elif compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    elif compression:
        raise ValueError(f'its compression {compression!r} is unknown, zstd and lz4 can be read')
    if whole and len(data) != size:
        raise ValueError('its size is wrong')
    if whole and checksum and zlib.crc32(data) != checksum:
        raise ValueError('its checksum is wrong')
    return data

"""The records of an MCAP file: their layout, their checksums, and the content of chunks.

Lengths in a file are never trusted, because it may be damaged or designed to exhaust memory.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

import lz4.frame
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.recordings.limits import LARGEST_CHUNK
import zstandard

MAGIC = b'\x89MCAP0\r\n'
RECORD_HEAD = struct.Struct('<BQ')  # opcode, length of the content
MESSAGE_HEAD = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time; the data follow
CHUNK_HEAD = struct.Struct('<QQQII')  # first and last log time, size, checksum, length of a name
STORED_SIZE = struct.Struct('<Q')  # after the name of the compression
FOOTER = struct.Struct('<QQI')  # start of summary, start of its offsets, checksum
CHECKSUM = struct.Struct('<I')
PIECE = 1 << 20  # bytes read at a time for a checksum

# Errors of the decompressors, and of parsing damaged bytes.
DAMAGE = (ValueError, OverflowError, struct.error, RuntimeError, zstandard.ZstdError, McapError)

_CHUNK_CHECKSUM = struct.calcsize('<QQQ')  # bytes before it in a chunk
_FOOTER_CHECKSUM = struct.calcsize('<QQ')


class UnknownCompression(RecordingError):
    """A chunk with an unsupported compression."""


def records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of every complete record in `data`.

    Replaces the StreamReader of the library, which trusts lengths and is half as fast.
    """
    position, size = 0, len(data)
    while position + RECORD_HEAD.size <= size:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        start = position + RECORD_HEAD.size
        position = start + length
        if position > size:
            return
        yield opcode, start, position


def message_head(data: bytes | memoryview, start: int, end: int) -> tuple[int, int]:
    """Return channel and log time (ns) of a message record; ValueError if it is too short."""
    if end - start < MESSAGE_HEAD.size:
        raise ValueError('a message in it is too short')
    channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(data, start)
    return channel, log_time


def chunk_content(record: bytes | memoryview) -> bytes | memoryview:
    """Return the records of a chunk, or the available part of a truncated chunk.

    Raises one of DAMAGE if the content is damaged, UnknownCompression if the compression is
    unknown.
    """
    _, length = RECORD_HEAD.unpack_from(record)
    body = memoryview(record)[RECORD_HEAD.size :]
    _, _, size, checksum, name_length = CHUNK_HEAD.unpack_from(body)
    named = CHUNK_HEAD.size + name_length
    compression = bytes(body[CHUNK_HEAD.size : named]).decode()
    (stored,) = STORED_SIZE.unpack_from(body, named)
    data: bytes | memoryview = body[named + STORED_SIZE.size :][:stored]
    if size > LARGEST_CHUNK:
        raise ValueError(f'it has {size} bytes, more than {LARGEST_CHUNK}')
    # Never unpack more than the declared size.
    if compression == 'zstd':
        data = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
    elif compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1)
    elif compression:
        raise UnknownCompression(
            f'its compression {compression!r} is unknown; zstd and lz4 can be read'
        )
    if len(body) >= length:
        if len(data) != size:
            raise ValueError('its size is wrong')
        if checksum and zlib.crc32(data) != checksum:
            raise ValueError('its checksum is wrong')
    return data


def checksum_of(stream: BinaryIO, start: int, end: int) -> int:
    """Return the CRC-32 of a part of a file, from byte `start` up to `end`."""
    stream.seek(start)
    checksum = 0
    while piece := stream.read(min(PIECE, end - stream.tell())):
        checksum = zlib.crc32(piece, checksum)
    return checksum


def write_checksums(path: Path) -> None:
    """Write the CRC-32 of every chunk, of the data section and of the summary into a file.

    rosbags writes no checksums, without which damage would go unnoticed. Each checksum covers the
    range defined by the MCAP specification.
    """
    with path.open('r+b') as stream:
        position = len(MAGIC)
        stream.seek(position)
        while head := stream.read(RECORD_HEAD.size):
            opcode, length = RECORD_HEAD.unpack(head)
            start = position + len(head)
            if opcode == Opcode.CHUNK:
                checksum = zlib.crc32(chunk_content(head + stream.read(length)))
                _put(stream, start + _CHUNK_CHECKSUM, checksum)
            elif opcode == Opcode.DATA_END:
                _put(stream, start, checksum_of(stream, 0, position))
            elif opcode == Opcode.FOOTER:
                stream.seek(start)
                summary, _, _ = FOOTER.unpack(stream.read(length))
                offset = start + _FOOTER_CHECKSUM
                _put(stream, offset, checksum_of(stream, summary or position, offset))
                return
            position = start + length
            stream.seek(position)


def _put(stream: BinaryIO, offset: int, checksum: int) -> None:
    stream.seek(offset)
    stream.write(CHECKSUM.pack(checksum))

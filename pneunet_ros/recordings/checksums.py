"""Adds checksums to a finished MCAP file, because rosbags writes none."""

from __future__ import annotations

from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from mcap.opcode import Opcode
from pneunet_ros.recordings.mcap_file import (
    CHECKSUM,
    checksum_of,
    chunk_content,
    FOOTER,
    MAGIC,
    RECORD_HEAD,
)

_CHUNK_CHECKSUM = struct.calcsize('<QQQ')  # bytes before it in a chunk
_FOOTER_CHECKSUM = struct.calcsize('<QQ')


def write_checksums(path: Path) -> None:
    """Write the CRC-32 of every chunk, of the data section and of the summary into a file.

    Each covers the range defined by the specification of MCAP. Without them, damage would be
    silent.
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
                place = start + _FOOTER_CHECKSUM
                _put(stream, place, checksum_of(stream, summary or position, place))
                return
            position = start + length
            stream.seek(position)


def _put(stream: BinaryIO, place: int, checksum: int) -> None:
    stream.seek(place)
    stream.write(CHECKSUM.pack(checksum))

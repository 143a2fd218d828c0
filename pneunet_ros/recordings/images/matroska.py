"""Detects Matroska and WebM files, and whether one is cut off.

These files have no frame count, and their duration is the end of the last frame on a clock with an
arbitrary start. However, the segment, which contains all data, states its size in bytes.
"""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from pneunet_ros.files.regular_file import open_regular

MAGIC = b'\x1a\x45\xdf\xa3'
SEGMENT = b'\x18\x53\x80\x67'


def is_matroska(path: Path) -> bool:
    """Whether a file begins like Matroska or WebM."""
    with open_regular(path) as stream:
        return stream.read(len(MAGIC)) == MAGIC


def is_cut(path: Path) -> bool:
    """Whether a Matroska file is shorter than its segment; False if no size is stated."""
    with open_regular(path) as stream:
        size_on_disk = stream.seek(0, 2)
        stream.seek(len(MAGIC))
        header = _read_size(stream)
        if header is None:
            return False
        stream.seek(header, 1)
        if stream.read(len(SEGMENT)) != SEGMENT:
            return False
        size = _read_size(stream)
        return size is not None and stream.tell() + size > size_on_disk


def _read_size(stream: BinaryIO) -> int | None:
    """Read a variable-length size of one to eight bytes; None: unknown."""
    first = stream.read(1)
    if not first or not first[0]:
        return None
    more = 8 - first[0].bit_length()
    rest = stream.read(more)
    bits = 7 * (1 + more)
    value = int.from_bytes(first + rest, 'big') & ((1 << bits) - 1)
    return None if len(rest) < more or value == (1 << bits) - 1 else value

"""A video of variable frame rate: the table of frame durations of an mp4 file, written anew."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import struct

CONTAINERS = (b'moov', b'trak', b'mdia', b'minf', b'stbl')
HEAD = 8  # bytes: size and kind of a box


def stretch_frames(path: Path, shares: Sequence[float]) -> None:
    """Give each frame its share of the usual duration; their sum must stay what it was."""
    path.write_bytes(_rewritten(path.read_bytes(), shares))


def _rewritten(boxes: bytes, shares: Sequence[float]) -> bytes:
    parts, at = [], 0
    while at < len(boxes):
        size, kind = struct.unpack_from('>I4s', boxes, at)
        content = boxes[at + HEAD : at + size]
        if kind in CONTAINERS:
            content = _rewritten(content, shares)
        elif kind == b'stts':
            _, entries, count, duration = struct.unpack('>IIII', content)
            assert (entries, count) == (1, len(shares))
            rows = [struct.pack('>II', 1, round(share * duration)) for share in shares]
            content = struct.pack('>II', 0, len(rows)) + b''.join(rows)
        parts.append(struct.pack('>I4s', HEAD + len(content), kind) + content)
        at += size
    return b''.join(parts)

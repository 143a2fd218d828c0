"""Size limits of recordings; sizes declared in a file are not trusted."""

from __future__ import annotations

from dataclasses import dataclass

from pneunet_ros.core.settings import tuning


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingLimits:
    """Sizes beyond which a recording is damaged, or made to exhaust memory."""

    chunk: int = tuning(
        100_000_000,
        'content of a chunk or message; writers begin a new chunk at a few MB',
        unit='byte',
        source='convention: a raw image of 8K',
    )
    definition: int = tuning(
        1_000_000,
        'record that names a topic or defines a type',
        unit='byte',
        source='convention: a hundred times what is usual, 10 kB',
    )
    expansion: int = tuning(
        1_000,
        'content of all chunks, unpacked; readings are packed 2 to 10 times',
        unit='size of the file',
        source='convention: black images are packed 1000 times',
    )
    unpacked: int = tuning(100_000_000, 'unpacked size that any file may have', unit='byte')
    records: int = tuning(
        1,
        'records in chunks per byte of the file',
        unit='1/byte',
        source='convention: a message with a log time of its own takes more than a byte',
    )
    waiting: int = tuning(
        300_000_000,
        'messages held at once to put them in order, where chunks overlap in time',
        unit='byte',
    )
    name: int = tuning(
        255, 'name of a topic or type', unit='character', source='literature: rmw of ROS 2'
    )


LIMITS = RecordingLimits()

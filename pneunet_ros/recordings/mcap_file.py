"""Contents of an MCAP file, determined in one pass, and its messages.

Complete, unindexed (`fastwrite`) and truncated files have the same description, so that readers of
messages need not distinguish them. Every existing checksum is verified; damaged parts are skipped
and listed in `McapFile.damage`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
import io
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.files.regular_file import readable
from pneunet_ros.recordings.file_kinds import recording_from
from pneunet_ros.recordings.limits import (
    ALWAYS_UNPACKED,
    LARGEST_CHUNK,
    LARGEST_DEFINITION,
    MOST_EXPANSION,
    RECORDS_PER_BYTE,
)
from pneunet_ros.recordings.mcap_records import (
    CHECKSUM,
    checksum_of,
    chunk_content,
    DAMAGE,
    MAGIC,
    MESSAGE_HEAD,
    message_head,
    RECORD_HEAD,
    records,
    STORED_SIZE,
    UnknownCompression,
)

CUT_OFF = 'ends in the middle of a record'
LOOSE_RUN = 1 << 20  # bytes of messages outside of chunks that make a block
LATEST_LOG_TIME = 2**63 - 1  # ns, in the year 2262


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A part of a file that is read as a whole: offset and length in bytes, log times, channels.

    `loose`: consecutive records outside of chunks, rather than the record of one chunk.
    """

    offset: int
    length: int
    loose: bool
    start_ns: int
    end_ns: int
    channels: frozenset[int]


@dataclass(frozen=True, slots=True, kw_only=True)
class McapFile:
    """Contents of a file: channels and schemas by id, messages per channel, and blocks.

    `damage`: notes on unreadable parts.
    """

    path: Path
    channels: dict[int, Channel]
    schemas: dict[int, Schema]
    counts: dict[int, int]
    blocks: tuple[Block, ...]
    damage: tuple[Note, ...]


def open_mcap(path: Path, name: Path | None = None) -> McapFile:
    """Scan the contents of a file; name: its name in messages, if it is a copy.

    Raises RecordingError if it cannot be read, is not an MCAP file, or exceeds the size limits; a
    truncated or damaged file is not an error and is described as far as possible.
    """
    name = name or path
    try:
        with readable(path, name) as stream:
            return replace(_Scan(name, stream, _size_of_mcap(name, stream)).run(), path=path)
    except UnknownCompression as error:
        raise RecordingError(f'{name}: {error}', reason='damaged') from error


def check_is_mcap(path: Path, name: Path | None = None) -> None:
    """Raise RecordingError if a file does not begin like an MCAP file, or cannot be read."""
    with readable(path, name) as stream:
        _size_of_mcap(name or path, stream)


def _size_of_mcap(path: Path, stream: BinaryIO) -> int:
    """Return the size of a file in bytes, if it begins correctly."""
    size = stream.seek(0, io.SEEK_END)
    stream.seek(0)
    if size == 0:
        raise RecordingError(f'{path} is empty: give an MCAP recording', reason='empty')
    if stream.read(len(MAGIC)) != MAGIC:
        raise RecordingError(f'{path} {recording_from(path)}', reason='wrong_kind')
    return size


def read_block(path: Path, stream: BinaryIO, block: Block) -> Iterator[tuple[int, int, bytes]]:
    """Yield the raw messages of a block: channel id, log time in ns, serialized bytes.

    Raises RecordingError naming `path` if the block was damaged after the file was opened.
    """
    stream.seek(block.offset)
    data: bytes | memoryview = stream.read(block.length)
    try:
        if not block.loose:
            data = chunk_content(data)
        for opcode, start, end in records(data):
            if opcode == Opcode.MESSAGE:
                channel, log_time = message_head(data, start, end)
                if log_time <= LATEST_LOG_TIME:
                    yield channel, log_time, bytes(data[start + MESSAGE_HEAD.size : end])
    except DAMAGE as error:
        raise RecordingError(
            f'{path} changed while it was being read, in the chunk at byte {block.offset} '
            f'({error})',
            reason='changed',
        ) from error


@dataclass(slots=True)
class _Scan:
    """One pass over a file, from the first to the last complete record."""

    path: Path
    stream: BinaryIO
    size: int
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    blocks: list[Block] = field(default_factory=list)
    unpacked: int = 0  # bytes
    packed: int = 0  # records in chunks
    skipped: list[tuple[int, str]] = field(default_factory=list)  # byte and reason of chunks
    too_late: int = 0  # messages
    data_end: tuple[int, int] | None = None  # byte and checksum
    announced: int | None = None  # messages by the summary

    def run(self) -> McapFile:
        """Scan, and report unreadable parts."""
        reason = self._walk()
        return McapFile(
            path=self.path,
            channels=self.channels,
            schemas=self.schemas,
            counts=dict(self.counts),
            blocks=tuple(self.blocks),
            damage=tuple(
                Note(f'{self.path} {note}', reason=note.reason) for note in self._damage(reason)
            ),
        )

    def _damage(self, reason: str | None) -> Iterator[Note]:
        """Describe the damage of the file."""
        count = self.counts.total()
        if self.skipped:
            yield Note(self._loss(count), reason='damaged')
        if reason is not None:
            why = 'cut_off' if reason == CUT_OFF else 'damaged'
            yield Note(f'{reason}: {count} messages were read', reason=why)
        elif self.skipped:
            pass  # the next checks would report the same damage
        elif self.data_end is None:
            yield Note(
                f'is damaged: the end of its data is not marked; {count} messages were read',
                reason='damaged',
            )
        elif not self._data_is_intact(*self.data_end):
            yield (
                Note(
                    'is damaged outside of its chunks (the checksum of its data is wrong); '
                    f'{count} messages were read',
                    reason='damaged',
                )
            )
        elif self.announced is not None and self.announced != count + self.too_late:
            yield Note(f'declares {self.announced} messages, but {count} were read', reason='lost')
        undefined = sum(number for key, number in self.counts.items() if key not in self.channels)
        if undefined:
            yield Note(
                f'has {undefined} messages without a topic, which were skipped', reason='no_topic'
            )
        if self.too_late:
            yield Note(
                f'has {self.too_late} messages logged after the year 2262, which were skipped',
                reason='too_late',
            )

    def _loss(self, count: int) -> str:
        """Name the skipped chunks."""
        byte, why = self.skipped[0]
        chunks = 'a damaged chunk was skipped,'
        if len(self.skipped) > 1:
            chunks = f'{len(self.skipped)} damaged chunks were skipped, the first'
        lost = f'{count} messages were read'
        if self.announced is not None and self.announced > count:
            lost = f'{self.announced - count} of {self.announced} messages are lost'
        return f'is damaged: {chunks} at byte {byte} ({why}); {lost}'

    def _data_is_intact(self, end: int, checksum: int) -> bool:
        """Verify the checksum of the data, if it has one."""
        return not checksum or checksum_of(self.stream, 0, end) == checksum

    def _walk(self) -> str | None:
        """Collect blocks record by record; return why this stopped before the footer, or ''."""
        position = len(MAGIC)
        run = _Run(position)
        cut_off = False
        try:
            while position < self.size:
                self.stream.seek(position)
                head = self.stream.read(RECORD_HEAD.size)
                cut_off = len(head) < RECORD_HEAD.size
                opcode, length = RECORD_HEAD.unpack(head)
                end = position + len(head) + length
                cut_off = end > self.size
                if opcode == Opcode.FOOTER:
                    return CUT_OFF if end + len(MAGIC) > self.size else None
                if opcode == 0:  # left by some file systems after a crash
                    return f'contains only zeros from byte {position} on'
                if opcode != Opcode.MESSAGE and run.count:  # the next record may be of any length
                    self._block(run, position, loose=True)
                    run = _Run(position)
                if opcode == Opcode.CHUNK:
                    self._chunk(position, min(end, self.size), cut_off)
                if cut_off:
                    return CUT_OFF
                if opcode == Opcode.MESSAGE:
                    if not run.count:
                        run.start = position
                    self._loose_message(run, length)
                    if end - run.start > LOOSE_RUN:
                        self._block(run, end, loose=True)
                        run = _Run(end)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._definition(opcode, self._read(length))
                elif opcode == Opcode.DATA_END:
                    self.data_end = position, *CHECKSUM.unpack(self._read(length))
                elif opcode == Opcode.STATISTICS:
                    (self.announced,) = STORED_SIZE.unpack_from(self._read(length))
                position = end
            return 'was not closed by its writer'
        except DAMAGE:
            return CUT_OFF if cut_off else f'is damaged at byte {position}'
        finally:
            self._block(run, position, loose=True)

    def _read(self, length: int) -> bytes:
        """Read the rest of a small record."""
        if length > LARGEST_DEFINITION:
            raise ValueError(f'a record of {length} bytes')
        return self.stream.read(length)

    def _loose_message(self, run: _Run, length: int) -> None:
        """Register a message outside of chunks."""
        if length > LARGEST_CHUNK:
            raise ValueError(f'a message of {length} bytes')
        head = self.stream.read(min(length, MESSAGE_HEAD.size))
        self._message(run, *message_head(head, 0, len(head)))

    def _chunk(self, start: int, end: int, cut_off: bool) -> None:
        """Read a chunk, or its available part; a damaged chunk is skipped."""
        run = _Run(start)
        try:
            if end - start > LARGEST_CHUNK + LARGEST_DEFINITION:
                raise ValueError(f'it has {end - start} bytes, more than {LARGEST_CHUNK}')
            self.stream.seek(start)
            data = chunk_content(self.stream.read(end - start))
            self._unpacked(len(data))
            most = RECORDS_PER_BYTE * self.size
            for opcode, first, last in records(data):
                self.packed += 1
                if self.packed > most:  # stop before reading all of them
                    raise self._refusal('more records than it has bytes')
                if opcode == Opcode.MESSAGE:
                    self._message(run, *message_head(data, first, last))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._definition(opcode, bytes(data[first:last]))
        except DAMAGE as error:
            if not cut_off:  # a truncated chunk may be empty
                why = ' '.join(str(error).split()) or 'it cannot be unpacked'
                self.skipped.append((start, why))
            return
        self._block(run, end, loose=False)

    def _unpacked(self, length: int) -> None:
        """Count the unpacked bytes; reject a file that expands too much."""
        self.unpacked += length
        if self.unpacked > ALWAYS_UNPACKED + MOST_EXPANSION * self.size:
            raise self._refusal(f'more than {MOST_EXPANSION} times its size')

    def _message(self, run: _Run, channel: int, log_time: int) -> None:
        """Count a message."""
        if log_time > LATEST_LOG_TIME:
            self.too_late += 1
        else:
            run.add(channel, log_time)

    def _definition(self, opcode: int, data: bytes) -> None:
        """Register a schema or channel; repetitions in the summary are ignored."""
        stream = ReadDataStream(io.BytesIO(data))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas.setdefault(schema.id, schema)
        else:
            channel = Channel.read(stream)
            self.channels.setdefault(channel.id, channel)

    def _block(self, run: _Run, end: int, *, loose: bool) -> None:
        """Store a block with the channels and log times of its messages."""
        if not run.count:
            return
        self.counts.update(run.channels)
        self.blocks.append(
            Block(
                offset=run.start,
                length=end - run.start,
                loose=loose,
                start_ns=run.first_ns,
                end_ns=run.last_ns,
                channels=frozenset(run.channels),
            )
        )

    def _refusal(self, what: str) -> RecordingError:
        return RecordingError(
            f'{self.path} contains {what}: it is damaged, or was made to exhaust memory; if '
            'neither is true, rewrite it without compression',
            reason='too_large',
        )


@dataclass(slots=True)
class _Run:
    """Consecutive messages in a file, from byte `start` on."""

    start: int
    count: int = 0
    first_ns: int = LATEST_LOG_TIME
    last_ns: int = 0
    channels: Counter[int] = field(default_factory=Counter)

    def add(self, channel: int, log_time: int) -> None:
        """Add a message."""
        self.count += 1
        self.channels[channel] += 1
        self.first_ns = min(self.first_ns, log_time)
        self.last_ns = max(self.last_ns, log_time)

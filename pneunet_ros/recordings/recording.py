"""Reads messages from files and folders of rosbag2.

Messages are read in log time order without loading the recording into memory;
`Recording.sentences` reports missing or truncated parts. `recording_writer` writes recordings.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import Channel
from pneunet_ros.core.errors import MessageError, RecordingError, shorten
from pneunet_ros.core.notes import Note
from pneunet_ros.core.progress import report_progress, STEP
from pneunet_ros.files.regular_file import open_regular
from pneunet_ros.messages.readings import is_estimated
from pneunet_ros.recordings.bag_folder import report_unread_parts, stored_files
from pneunet_ros.recordings.limits import LONGEST_NAME, MOST_WAITING
from pneunet_ros.recordings.mcap_file import McapFile, open_mcap, read_block
from pneunet_ros.recordings.message_store import deserialize, store_for
from pneunet_ros.recordings.plain_mcap import plain_mcap, unpacked_message

SCHEMA_ENCODINGS = ('ros2msg', 'ros2idl')
LEFT_OUT_SHOWN = 20  # excluded channels listed by name
MESSAGE_OVERHEAD = 300  # bytes of overhead per message in Python


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedTopic:
    """A topic of a recording: full name, type, number of messages, definition of the type."""

    name: str
    type: str
    count: int
    definition: str


class RawMessage(NamedTuple):
    """A raw message: name of its topic, log time in ns, serialized bytes."""

    topic: str
    log_time_ns: int
    raw: bytes


class RecordedMessage(NamedTuple):
    """A message: name of its topic, log time in ns, content by field name, serialized bytes."""

    topic: str
    log_time_ns: int
    message: Any
    raw: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """A recording: its topics sorted by name, and sentences about unreadable parts.

    `start_ns` and `end_ns` are the first and last log time, both 0 without messages. `files` are
    its files in order and `channels` the names of topics by channel id for each of them.
    """

    path: Path
    topics: tuple[RecordedTopic, ...]
    sentences: tuple[str, ...]
    start_ns: int
    end_ns: int
    files: tuple[McapFile, ...]
    channels: tuple[Mapping[int, str], ...]

    def topic(self, name: str) -> RecordedTopic:
        """Return the topic of this full name; RecordingError lists the available ones."""
        for topic in self.topics:
            if topic.name == name:
                return topic
        raise RecordingError(
            f'{self.path} has no topic {name}; it contains {self.contents()}', reason='no_topic'
        )

    def candidates(self, last_name: str, type_name: str) -> tuple[str, ...]:
        """List the topics of this type with this last name (or names like 'image_raw/compressed').

        An estimated wrench is not a reading and is selected only by its full name.
        """
        return tuple(
            topic.name
            for topic in self.topics
            if topic.type == type_name
            and f'/{topic.name}'.endswith(f'/{last_name}')
            and not is_estimated(topic.name)
        )

    def find(self, last_name: str, type_name: str, override: str | None = None) -> str:
        """Return the one topic of this type and last name, like `find_any`."""
        return self.find_any({last_name: type_name}, override)

    def find_any(
        self, types: Mapping[str, str], override: str | None = None, label: str | None = None
    ) -> str:
        """Return the one topic with one of these last names and its type.

        types: type by last name; the first one is used by `--topic`. override: its full name, if
        given; the topic may then have any of the types. label: describes several candidates, e.g.
        'with images'; None: described by names and types. Raises RecordingError listing the
        candidates if there are several, or the existing topics if there is none.
        """
        option = f'--topic {next(iter(types))}='
        names, kinds = ' or '.join(types), ' or '.join(types.values())
        if override is not None:
            chosen = self.topic(override)
            if chosen.type not in types.values():
                raise RecordingError(
                    f'{self.path}: {option}{override} names a topic of type {chosen.type}, '
                    f'but {kinds} is needed',
                    reason='wrong_type',
                )
            return override
        found = [topic for name, kind in types.items() for topic in self.candidates(name, kind)]
        if len(found) == 1:
            return found[0]
        if found:
            called = label or f'{names} of type {kinds}'
            raise RecordingError(
                f'{self.path} has {len(found)} topics {called}: {", ".join(found)}; choose one, '
                f'e.g. {option}{found[0]}',
                reason='ambiguous_topic',
            )
        raise RecordingError(
            f'{self.path} has no topic {names} of type {kinds}; it contains {self.contents()}; '
            f'name a topic of that type with {option}/its/name',
            reason='no_topic',
        )

    def count(self, topics: Iterable[str]) -> int:
        """Count the messages of these topics: the total for a progress bar."""
        names = set(topics)
        return sum(topic.count for topic in self.topics if topic.name in names)

    def raw_messages(self, topics: Sequence[str]) -> Iterator[RawMessage]:
        """Yield the messages of these topics in log time order, serialized.

        Messages with equal log time are in the order of `topics`. Raises RecordingError if a file
        turns out to be damaged.
        """
        rank = {name: file_index for file_index, name in enumerate(topics)}
        order, read, total = count(), 0, self.count(topics)
        blocks = sorted(
            (block.start_ns, file_index, number)
            for file_index, file in enumerate(self.files)
            for number, block in enumerate(file.blocks)
            if any(self.channels[file_index].get(channel) in rank for channel in block.channels)
        )
        pending: list[tuple[int, int, int, RawMessage]] = []
        held_bytes = 0
        with ExitStack() as stack:
            streams = [stack.enter_context(_open(file.path)) for file in self.files]
            for index, (_, file_index, number) in enumerate(blocks):
                file, names = self.files[file_index], self.channels[file_index]
                for channel, log_time, raw in read_block(
                    file.path, streams[file_index], file.blocks[number]
                ):
                    name = names.get(channel)
                    if name is not None and name in rank:
                        raw = unpacked_message(raw)
                        message = RawMessage(name, log_time, raw)
                        pending.append((log_time, rank[name], next(order), message))
                        held_bytes += len(raw) + MESSAGE_OVERHEAD
                        _check_held(file.path, held_bytes)
                pending.sort()
                # The remaining blocks start at the next one: earlier messages are in order.
                ready = len(pending)
                if index + 1 < len(blocks):
                    ready = bisect_left(pending, (blocks[index + 1][0],))
                for entry in pending[:ready]:
                    yield entry[3]
                    read += 1
                    if read % STEP == 0:
                        report_progress(f'reading {self.path.name}', read, total)
                    held_bytes -= len(entry[3].raw) + MESSAGE_OVERHEAD
                del pending[:ready]

    def messages(self, topics: Sequence[str]) -> Iterator[RecordedMessage]:
        """Yield the decoded messages of these topics, in the order of `raw_messages`.

        Raises RecordingError if a message does not have the type of its topic, or if the type is
        unknown.
        """
        types = {name: self.topic(name) for name in topics}
        stores = {name: store_for(topic.type, topic.definition) for name, topic in types.items()}
        for name, log_time, raw in self.raw_messages(topics):
            try:
                message = deserialize(raw, types[name].type, stores[name])
            except MessageError as error:
                raise RecordingError(
                    f'{self.path}: the message of {name} at log time {log_time} ns is not a '
                    f'{types[name].type}: {error}',
                    reason='damaged',
                ) from error
            yield RecordedMessage(name, log_time, message, raw)

    def contents(self) -> str:
        """List the topics with their types as text."""
        topics = ', '.join(f'{topic.name} ({topic.type})' for topic in self.topics)
        return topics or '; '.join(('no messages', *self.sentences))


def open_recording(path: str | Path) -> Recording:
    """Open a file of rosbag2 (.mcap, .db3, also packed by zstd) or a folder of such files.

    Raises RecordingError if there is none, or if its files are of another kind. Truncated files
    are read as far as possible, and channels without ROS 2 messages are skipped; `sentences`
    reports both.
    """
    path = Path(path)
    files, sentences = list[McapFile](), list[str]()
    for stored in stored_files(path):
        file = open_mcap(plain_mcap(stored), stored)
        files.append(file)
        sentences += file.damage
    if not sentences:
        sentences += report_unread_parts(path, sum(sum(file.counts.values()) for file in files))
    left_out: list[str] = []
    topics: dict[str, RecordedTopic] = {}
    channels: list[dict[int, str]] = []
    for file in files:
        names: dict[int, str] = {}
        for key, channel in sorted(file.channels.items()):
            topic = _recorded_topic(file, channel)
            known = topics.get(channel.topic, topic)
            if topic is None or known is None or known.type != topic.type:
                left_out.append(_left_out(file, channel, known))
                continue
            if known is not topic:
                topic = replace(known, count=known.count + topic.count)
            topics[topic.name] = topic
            names[key] = topic.name
        channels.append(names)
    sentences += left_out[:LEFT_OUT_SHOWN]
    if len(left_out) > LEFT_OUT_SHOWN:
        sentences.append(
            Note(
                f'{len(left_out) - LEFT_OUT_SHOWN} more channels of {path} were skipped',
                reason='not_supported',
            )
        )
    blocks = [block for file in files for block in file.blocks if block.channels]
    return Recording(
        path=path,
        topics=tuple(topics[name] for name in sorted(topics)),
        sentences=tuple(sentences),
        start_ns=min((block.start_ns for block in blocks), default=0),
        end_ns=max((block.end_ns for block in blocks), default=0),
        files=tuple(files),
        channels=tuple(channels),
    )


def _recorded_topic(file: McapFile, channel: Channel) -> RecordedTopic | None:
    """Describe the topic of a channel; None if it does not contain ROS 2 messages."""
    schema = file.schemas.get(channel.schema_id)
    if channel.message_encoding != 'cdr' or schema is None:
        return None
    if schema.encoding not in SCHEMA_ENCODINGS:
        return None
    if max(len(channel.topic), len(schema.name)) > LONGEST_NAME:
        return None
    return RecordedTopic(
        name=channel.topic,
        type=schema.name,
        count=file.counts.get(channel.id, 0),
        definition=schema.data.decode(errors='replace'),
    )


def _left_out(file: McapFile, channel: Channel, known: RecordedTopic | None) -> Note:
    schema = file.schemas.get(channel.schema_id)
    longest = max(len(channel.topic), len(schema.name) if schema else 0)
    if longest > LONGEST_NAME:
        return Note(
            f'{shorten(channel.topic, LONGEST_NAME)} in {file.path} was skipped: the name of '
            f'its topic or type has {longest} characters, and {LONGEST_NAME} are allowed',
            reason='too_large',
        )
    encodings = channel.message_encoding, schema.encoding if schema else ''
    what = ' with '.join(encoding or 'nothing' for encoding in encodings)
    if known is not None and schema is not None:
        return Note(
            f'{channel.topic} in {file.path} was read as {known.type} only; its messages of type '
            f'{schema.name} ({what}) were skipped',
            reason='not_supported',
        )
    return Note(
        f'{channel.topic} in {file.path} was skipped: it contains no ROS 2 messages ({what})',
        reason='not_supported',
    )


def _check_held(path: Path, held_bytes: int) -> None:
    if held_bytes > MOST_WAITING:
        raise RecordingError(
            f'{path} has more than {MOST_WAITING // 10**6} MB of messages in one chunk, or in '
            'chunks that overlap in time: sort it with `mcap sort`',
            reason='too_large',
        )


def _open(path: Path) -> BinaryIO:
    try:
        return open_regular(path)
    except OSError as error:
        raise RecordingError(
            f'{path} cannot be read: {error.strerror}', reason='unreadable'
        ) from error

"""Writes messages to a bare .mcap file or to a rosbag2 folder for ROS 2 tools.

The files have profile `ros2`, schemas `ros2msg` and messages `cdr`, like those of rosbag2. A
recording appears under its name only when it is complete.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
import json
import os
from pathlib import Path
import re
import struct
from typing import Any

from mcap.opcode import Opcode
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.messages.builders import Output
from pneunet_ros.messages.serializer import MessageSerializer
from pneunet_ros.recordings.bag_folder import METADATA, own_files
from pneunet_ros.recordings.limits import LARGEST_CHUNK
from pneunet_ros.recordings.mcap_file import LATEST_LOG_TIME
from pneunet_ros.recordings.mcap_records import MESSAGE_HEAD, RECORD_HEAD, write_checksums
from pneunet_ros.recordings.message_store import IDL_HEAD, ROSBAGS_TYPES, serialize, store_for
from pneunet_ros.recordings.recording import RecordedTopic
from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2.enums import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter

BARE = 'of-a-bare-file'  # name of the folder from which this file is moved
BARE_SUFFIX = '.mcap'  # of a recording that is a single file
VERSION = 9  # of the metadata
CHUNK = 1 << 20  # bytes of messages per chunk, as in rosbag2
MESSAGE = struct.Struct(RECORD_HEAD.format + MESSAGE_HEAD.format.lstrip('<'))
PLAIN_TEXT = re.compile(r'[A-Za-z/_][A-Za-z0-9_./-]*')  # needs no quotes in YAML
YAML_WORDS = frozenset({'null', 'true', 'false', 'yes', 'no', 'on', 'off', 'y', 'n'})
_FOREVER = {'sec': 9_223_372_036, 'nsec': 854_775_807}  # infinite duration, as written by rosbag2

# The QoS for `ros2 bag play`, as of the live estimator.
PLAYBACK_QOS = {
    'history': 'keep_last',
    'depth': 10,
    'reliability': 'reliable',
    'durability': 'volatile',
    'deadline': _FOREVER,
    'lifespan': _FOREVER,
    'liveliness': 'automatic',
    'liveliness_lease_duration': _FOREVER,
    'avoid_ros_namespace_conventions': False,
}


class MessageStorage(McapWriter):
    """The MCAP file of rosbags, with messages added to its chunks as a whole."""

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message as a whole, six times as fast as field by field."""
        filled = self.chunk.bio.tell()
        if filled and filled + MESSAGE.size + len(data) > LARGEST_CHUNK:
            self.close_chunk()
        chunk = self.chunk
        chunk.message_start_time = min(timestamp, chunk.message_start_time)
        chunk.message_end_time = max(timestamp, chunk.message_end_time)
        self.message_start_time = min(timestamp, self.message_start_time)
        self.message_end_time = max(timestamp, self.message_end_time)
        self.channel_stats[connection.id] += 1
        chunk.msgs[connection.id].append((timestamp, chunk.bio.tell()))
        length = MESSAGE_HEAD.size + len(data)
        chunk.bio.write(
            MESSAGE.pack(Opcode.MESSAGE, length, connection.id, 0, timestamp, timestamp)
        )
        chunk.bio.write(data)
        if chunk.bio.tell() > CHUNK:
            self.close_chunk()


class RecordingWriter:
    """Writer for the messages of a new recording; made by `write_recording`."""

    __slots__ = ('_connections', '_path', '_storage')

    def __init__(self, path: Path, storage: MessageStorage) -> None:
        """Write into an open file; `path`: its name as given by the user."""
        self._path, self._storage = path, storage
        self._connections: list[Connection] = []

    def add(self, topic: str, type_name: str, definition: str = '') -> Connection:
        """Add a topic, and return the handle for writing to it.

        definition: of a type not in ROS 2 Jazzy, as in a recording. Raises RecordingError if the
        type is unknown, or if the topic was added before.
        """
        store = store_for(type_name, definition)
        if any(connection.topic == topic for connection in self._connections):
            raise RecordingError(
                f'{self._path}: {topic} would be written twice', reason='given_twice'
            )
        definition = definition or store.generate_msgdef(type_name, ros_version=2)[0]
        in_idl = definition.startswith(IDL_HEAD)
        form = MessageDefinitionFormat.IDL if in_idl else MessageDefinitionFormat.MSG
        connection = Connection(
            id=len(self._connections) + 1,
            topic=topic,
            msgtype=type_name,
            msgdef=MessageDefinition(form, definition),
            digest=store.hash_rihs01(type_name),
            msgcount=0,
            ext=ConnectionExtRosbag2(serialization_format='cdr', offered_qos_profiles=[]),
            owner=self,
        )
        if all(known.msgtype != type_name for known in self._connections):
            self._storage.add_msgtype(connection)
        self._storage.add_connection(connection, yaml_text([PLAYBACK_QOS]))
        self._connections.append(connection)
        return connection

    def add_copy(self, topic: RecordedTopic) -> Connection:
        """Add a topic of another recording, to be copied by `write_raw`."""
        return self.add(topic.name, topic.type, topic.definition)

    def write(self, connection: Connection, log_time_ns: int, message: Any) -> None:
        """Write a message made of `ROSBAGS_TYPES`; raises MessageError for unfit content."""
        self.write_raw(connection, log_time_ns, serialize(message, connection.msgtype))

    def write_raw(self, connection: Connection, log_time_ns: int, raw: bytes) -> None:
        """Write a serialized message; raises RecordingError for an invalid log time."""
        if not 0 <= log_time_ns <= LATEST_LOG_TIME:
            raise RecordingError(
                f'{self._path}: a message of {connection.topic} has the log time {log_time_ns} '
                f'ns, but only times from 0 to {LATEST_LOG_TIME} ns can be recorded',
                reason='out_of_bounds',
            )
        self._storage.write(connection, log_time_ns, raw)

    def metadata(self) -> dict[str, Any]:
        """Return the metadata of rosbag2 for the recording."""
        storage, name = self._storage, self._storage.path.name
        messages = sum(storage.channel_stats.values())
        span = {
            'starting_time': {'nanoseconds_since_epoch': storage.message_start_time},
            'duration': {
                'nanoseconds': max(0, storage.message_end_time - storage.message_start_time)
            },
            'message_count': messages,
        }
        return {
            'version': VERSION,
            'storage_identifier': 'mcap',
            'relative_file_paths': [name],
            **span,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': one.topic,
                        'type': one.msgtype,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': [PLAYBACK_QOS],
                        'type_description_hash': one.digest,
                    },
                    'message_count': storage.channel_stats[one.id],
                }
                for one in self._connections
            ],
            'compression_format': '',
            'compression_mode': '',
            'files': [{'path': name, **span}],
            'custom_data': None,
            'ros_distro': 'rosbags',
        }


class OutputTopics:
    """Topics of a new recording for the outputs of a node, with the messages of the node."""

    def __init__(
        self, writer: RecordingWriter, names: Mapping[str, Output[Any]], frame_id: str
    ) -> None:
        """Add the topics; names: the outputs by the full names of their topics."""
        self._connections = {
            output.name: writer.add(name, output.type) for name, output in names.items()
        }
        self._serializer = MessageSerializer(
            types=ROSBAGS_TYPES, serialize=serialize, frame_id=frame_id
        )

    def messages(
        self, results: Iterable[tuple[Output[Any], Any]]
    ) -> Iterator[tuple[Connection, bytes]]:
        """Yield the topic and the serialized message of each result."""
        for output, result in results:
            yield self._connections[output.name], self._serializer.bytes_of(output, result)


def yaml_text(value: Any) -> str:
    """Return YAML of nested mappings and lists, fifty times as fast as a library."""
    return '\n'.join(yaml_lines(value))


def yaml_lines(value: Any) -> Iterator[str]:
    """Yield the lines of a mapping or a list, keys in their order."""
    is_list = isinstance(value, list)
    for key, item in ((None, item) for item in value) if is_list else sorted(value.items()):
        head = '- ' if is_list else f'{key}:'
        if not (isinstance(item, (dict, list)) and item):
            yield f'{head.rstrip()} {yaml_scalar(item)}'
            continue
        lines = list(yaml_lines(item))
        if is_list:
            yield f'- {lines[0]}'
            yield from (f'  {line}' for line in lines[1:])
            continue
        yield head
        deeper = '' if isinstance(item, list) else '  '
        yield from (f'{deeper}{line}' for line in lines)


def yaml_scalar(value: Any) -> str:
    """Return a text, a number, a truth value or None as YAML."""
    if isinstance(value, str) and PLAIN_TEXT.fullmatch(value) and value.lower() not in YAML_WORDS:
        return value
    if value == '':
        return "''"
    return json.dumps(value, ensure_ascii=not str(value).isprintable())


def check_name(path: Path) -> None:
    """Reject the suffix of another kind of file; the name of a folder may end in a date, 25.11."""
    if path.suffix != BARE_SUFFIX and any(letter.isalpha() for letter in path.suffix):
        raise RecordingError(
            f'{path} cannot be written: a recording is either an {BARE_SUFFIX} file, or a folder '
            'whose name has no such ending',
            reason='wrong_suffix',
        )


@contextmanager
def write_recording(
    path: str | Path, *, overwrite: bool = False, inputs: Iterable[str | Path] = ()
) -> Iterator[RecordingWriter]:
    """Write a recording: a single file if `path` ends in .mcap, or else a rosbag2 folder.

    inputs: recordings being read, which must not be overwritten. Raises RecordingError if the path
    cannot be used or if there is no space; after this and any other exception, no file remains.
    """
    path = Path(path)
    check_name(path)
    bare = path.suffix == BARE_SUFFIX
    replaceable = () if bare else own_files(path)
    with atomic_output(
        path, overwrite=overwrite, inputs=inputs, replaceable=replaceable
    ) as temporary:
        # The storage names its file after its folder; a single file is moved out of it.
        folder = temporary.with_name(BARE) if bare else temporary
        folder.mkdir(mode=0o755)
        storage = MessageStorage(folder, CompressionMode.NONE)
        try:
            writer = RecordingWriter(path, storage)
            yield writer
            metadata = writer.metadata()
            storage.close(VERSION, yaml_text(metadata))
        except BaseException:
            with suppress(OSError):  # a full disk, already reported
                storage.abort()
            raise
        write_checksums(storage.path)
        if bare:
            os.rename(storage.path, temporary)
            return
        text = yaml_text({'rosbag2_bagfile_information': metadata})
        (folder / METADATA).write_text(f'{text}\n', encoding='utf-8')

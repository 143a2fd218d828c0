"""Recordings written: messages -> a bare .mcap file or a rosbag2 folder that ROS 2 tools open.

Profile `ros2`, schemas `ros2msg`, messages `cdr`, as rosbag2 has them. A recording appears under
its name when it is complete, and not before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneunet_ros.bag_folder import (
    bag_information,
    BagTopic,
    FOLDER_FILES,
    METADATA,
    metadata_text,
    PLAYBACK_QOS,
    yaml_text,
)
from pneunet_ros.errors import RecordingError
from pneunet_ros.mcap_writer import McapWriter
from pneunet_ros.message_store import IDL_HEAD, serialize, store_for
from pneunet_ros.output import atomic_output
from pneunet_ros.recording import RecordedTopic

OTHER_FORMATS = ('.bag', '.db3', '.sqlite3')


@dataclass(frozen=True, slots=True, kw_only=True)
class WrittenTopic:
    """A topic of a recording that is being written: the handle to write to."""

    name: str
    type: str
    type_hash: str
    channel: int


class RecordingWriter:
    """Takes the messages of a recording that is being written; made by `write_recording`."""

    def __init__(self, path: Path, container: McapWriter) -> None:
        """Write into an open container; `path` is what the user called it."""
        self._path = path
        self._container = container
        self._schemas: dict[tuple[str, str], int] = {}
        self._topics: list[WrittenTopic] = []

    def add(self, topic: str, type_name: str, definition: str = '') -> WrittenTopic:
        """Announce a topic and get the handle to write to it.

        definition: of a type that is not of ROS 2 Jazzy, as a recording carries it. Raises
        RecordingError when the type is not known or the topic was added before.
        """
        if any(added.name == topic for added in self._topics):
            raise RecordingError(f'{self._path}: {topic} would be written twice')
        store = store_for(type_name, definition)
        definition = definition or store.generate_msgdef(type_name, ros_version=2)[0]
        schema = self._schemas.get((type_name, definition))
        if schema is None:
            encoding = 'ros2idl' if definition.startswith(IDL_HEAD) else 'ros2msg'
            schema = self._container.add_schema(type_name, encoding, definition.encode())
            self._schemas[type_name, definition] = schema
        type_hash = store.hash_rihs01(type_name)
        channel = self._container.add_channel(
            topic,
            schema,
            {'offered_qos_profiles': yaml_text([PLAYBACK_QOS]), 'topic_type_hash': type_hash},
        )
        added = WrittenTopic(name=topic, type=type_name, type_hash=type_hash, channel=channel)
        self._topics.append(added)
        return added

    def add_copy(self, topic: RecordedTopic) -> WrittenTopic:
        """Announce a topic of another recording, whose messages will be copied by `write_raw`."""
        return self.add(topic.name, topic.type, topic.definition)

    def write(self, topic: WrittenTopic, log_time_ns: int, message: Any) -> None:
        """Write a message made of `ROSBAGS_TYPES`; raises MessageError for unfit content."""
        self.write_raw(topic, log_time_ns, serialize(message, topic.type))

    def write_raw(self, topic: WrittenTopic, log_time_ns: int, raw: bytes) -> None:
        """Write a serialized message; raises RecordingError for a log time before 1970."""
        if log_time_ns < 0:
            raise RecordingError(
                f'{self._path}: a message of {topic.name} has the log time {log_time_ns} ns, '
                'and only times from 0 on can be recorded'
            )
        self._container.write(topic.channel, log_time_ns, raw)

    def information(self, file: str) -> dict[str, Any]:
        """Describe what was written so far into a file of this name, as rosbag2 does."""
        counts = self._container.counts
        topics = [
            BagTopic(
                name=topic.name,
                type=topic.type,
                type_hash=topic.type_hash,
                count=counts[topic.channel],
            )
            for topic in self._topics
        ]
        return bag_information(file, topics, *self._container.times)


@contextmanager
def write_recording(
    path: str | Path, *, overwrite: bool = False, inputs: Iterable[str | Path] = ()
) -> Iterator[RecordingWriter]:
    """Write a recording: a single file when `path` ends in .mcap, else a rosbag2 folder.

    inputs: recordings that are being read, which must not be overwritten. Raises RecordingError
    when the place cannot be used or there is no room; then, and after any exception, nothing is
    left.
    """
    path = Path(path)
    if path.suffix in OTHER_FORMATS:
        raise RecordingError(
            f'{path} cannot be written: a recording is an .mcap file or a folder without suffix'
        )
    bare = path.suffix == '.mcap'
    replaceable = () if bare else FOLDER_FILES
    with atomic_output(
        path, overwrite=overwrite, inputs=inputs, replaceable=replaceable
    ) as temporary:
        file = temporary if bare else temporary / f'{temporary.name}.mcap'
        file.parent.mkdir(exist_ok=True)
        with file.open('wb') as stream:
            container = McapWriter(stream, 'ros2')
            writer = RecordingWriter(path, container)
            yield writer
            container.close_chunk()
            information = writer.information(file.name)
            container.finish('rosbag2', {'serialized_metadata': yaml_text(information)})
        if not bare:
            (temporary / METADATA).write_text(metadata_text(information), encoding='utf-8')

"""Recordings written: messages -> a bare .mcap file or a rosbag2 folder that ROS 2 tools open.

Profile `ros2`, schemas `ros2msg`, messages `cdr`, as rosbag2 writes them. A recording appears
under its name when it is complete, and not before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import os
from pathlib import Path
from typing import Any

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.recordings.bag_folder import FOLDER_FILES
from pneunet_ros.recordings.checksums import write_checksums
from pneunet_ros.recordings.mcap_file import LATEST_LOG_TIME
from pneunet_ros.recordings.message_store import serialize, store_for
from pneunet_ros.recordings.recording import RecordedTopic
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

BARE = 'of-a-bare-file'  # name of the folder out of which such a file is taken
BARE_SUFFIX = '.mcap'  # of a recording that is a single file
_FOREVER = QosTime(9_223_372_036, 854_775_807)  # how rosbag2 writes an infinite duration

# What `ros2 bag play` shall offer: what the estimator offers live.
PLAYBACK_QOS = Qos(
    history=QosHistory.KEEP_LAST,
    depth=10,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.VOLATILE,
    deadline=_FOREVER,
    lifespan=_FOREVER,
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=_FOREVER,
    avoid_ros_namespace_conventions=False,
)


class RecordingWriter:
    """Takes the messages of a recording that is being written; made by `write_recording`."""

    __slots__ = ('_container', '_path')

    def __init__(self, path: Path, container: Writer) -> None:
        """Write into an open container; `path` is what the user called it."""
        self._path = path
        self._container = container

    def add(self, topic: str, type_name: str, definition: str = '') -> Connection:
        """Announce a topic and get the handle to write to it.

        definition: of a type that is not of ROS 2 Jazzy, as a recording carries it. Raises
        RecordingError when the type is not known or the topic was added before.
        """
        store = store_for(type_name, definition)
        if any(connection.topic == topic for connection in self._container.connections):
            raise RecordingError(
                f'{self._path}: {topic} would be written twice', reason='given_twice'
            )
        return self._container.add_connection(
            topic,
            type_name,
            msgdef=definition or store.generate_msgdef(type_name, ros_version=2)[0],
            rihs01=store.hash_rihs01(type_name),
            offered_qos_profiles=[PLAYBACK_QOS],
        )

    def add_copy(self, topic: RecordedTopic) -> Connection:
        """Announce a topic of another recording, whose messages will be copied by `write_raw`."""
        return self.add(topic.name, topic.type, topic.definition)

    def write(self, connection: Connection, log_time_ns: int, message: Any) -> None:
        """Write a message made of `ROSBAGS_TYPES`; raises MessageError for unfit content."""
        self.write_raw(connection, log_time_ns, serialize(message, connection.msgtype))

    def write_raw(self, connection: Connection, log_time_ns: int, raw: bytes) -> None:
        """Write a serialized message; raises RecordingError for a log time that cannot be."""
        if not 0 <= log_time_ns <= LATEST_LOG_TIME:
            raise RecordingError(
                f'{self._path}: a message of {connection.topic} has the log time {log_time_ns} '
                f'ns, and only times from 0 to {LATEST_LOG_TIME} can be recorded',
                reason='out_of_bounds',
            )
        self._container.write(connection, log_time_ns, raw)


def check_name(path: Path) -> None:
    """Refuse the name of another kind of file; a folder may be named by a date, as day_25.11."""
    if path.suffix != BARE_SUFFIX and any(letter.isalpha() for letter in path.suffix):
        raise RecordingError(
            f'{path} cannot be written: a recording is an {BARE_SUFFIX} file or a folder without '
            'such an ending',
            reason='wrong_suffix',
        )


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
    check_name(path)
    bare = path.suffix == BARE_SUFFIX
    replaceable = () if bare else FOLDER_FILES
    with atomic_output(
        path, overwrite=overwrite, inputs=inputs, replaceable=replaceable
    ) as temporary:
        # The container names its file after its folder; a bare file is taken out of it.
        folder = temporary.with_name(BARE) if bare else temporary
        try:
            with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as container:
                yield RecordingWriter(path, container)
        except WriterError as error:
            raise RecordingError(
                f'{path} cannot be written: {error}', reason='unwritable'
            ) from error
        written = folder / f'{folder.name}{BARE_SUFFIX}'
        write_checksums(written)
        if bare:
            os.rename(written, temporary)

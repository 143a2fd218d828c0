"""Converts compressed (zstd) and sqlite3 files of a recording to plain MCAP.

A copy is made once, in a temporary folder that is removed when the process ends. Individually
compressed messages stay compressed: `recording` unpacks them while reading.
"""

from __future__ import annotations

from contextlib import closing
from functools import cache
import io
from multiprocessing import util
from pathlib import Path
import shutil
import sqlite3
import tempfile
from typing import Any

from mcap.writer import CompressionType, Writer
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.files.regular_file import open_regular, readable
from pneunet_ros.recordings.limits import ALWAYS_UNPACKED, LARGEST_CHUNK, MOST_EXPANSION
from pneunet_ros.recordings.message_store import jazzy
import zstandard

PACKED, SQLITE = '.zstd', '.db3'  # suffixes of rosbag2
PACKED_MESSAGE = b'\x28\xb5\x2f\xfd'  # magic number of zstd; CDR begins with a zero
SQLITE_MAGIC = b'SQLite format 3\0'


def plain_mcap(path: Path) -> Path:
    """Return a file of a recording, or a plain MCAP copy if it is compressed or sqlite3.

    Raises RecordingError if there is no room for the copy, or the file is damaged.
    """
    kind = path.suffix
    with readable(path) as stream:
        if kind not in (PACKED, SQLITE) and stream.read(len(SQLITE_MAGIC)) != SQLITE_MAGIC:
            return path
        status = path.stat()
        return _copy(path, status.st_mtime_ns, status.st_size)


@cache
def _folder() -> Path:
    """Create the folder of copies, which is removed at the end of any process, even a worker."""
    folder = Path(tempfile.mkdtemp(prefix='pneunet-unpacked-'))
    util.Finalize(None, shutil.rmtree, args=(folder, True), exitpriority=1)
    return folder


@cache
def _copy(path: Path, changed_ns: int, size: int) -> Path:
    """Return the plain copy of a file, cached by its modification time."""
    folder = Path(tempfile.mkdtemp(dir=_folder()))
    plain = path
    if path.suffix == PACKED:
        plain = folder / path.stem
        _unpack(path, plain)
    with plain.open('rb') as stream:
        is_sqlite = stream.read(len(SQLITE_MAGIC)) == SQLITE_MAGIC
    if not is_sqlite:
        return plain
    copy = folder / f'{plain.stem}.mcap'
    plain = _with_log(plain, folder)
    try:
        _copy_messages(plain, copy)
    except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
        raise RecordingError(
            f'{path} is not a sqlite3 recording of rosbag2: {error}', reason='wrong_kind'
        ) from error
    if plain is not path:
        plain.unlink()
    return copy


def _with_log(database: Path, folder: Path) -> Path:
    """Return a database, or a copy of it if its write-ahead log contains messages.

    SQLite writes next to a database with such a log even when reading.
    """
    log = _log(database)
    if not log.exists() or not log.stat().st_size:
        return database
    shutil.copyfile(log, folder / log.name)
    return Path(shutil.copyfile(database, folder / database.name))


def _log(database: Path) -> Path:
    """Return the SQLite write-ahead log of a database, if it has one."""
    return database.with_name(f'{database.name}-wal')


def _unpack(path: Path, plain: Path) -> None:
    """Decompress a file up to the size limit, or the beginning of a truncated file."""
    remaining = ALWAYS_UNPACKED + MOST_EXPANSION * path.stat().st_size
    with open_regular(path) as packed, plain.open('wb') as target:
        try:
            for piece in zstandard.ZstdDecompressor().read_to_iter(packed):
                remaining -= len(piece)
                if remaining < 0:
                    raise RecordingError(
                        f'{path} expands to more than {MOST_EXPANSION} times its size',
                        reason='too_large',
                    )
                target.write(piece)
        except zstandard.ZstdError as error:
            raise RecordingError(
                f'{path} cannot be unpacked by zstd: {error}', reason='damaged'
            ) from error


def unpacked_message(raw: bytes) -> bytes:
    """Return a message, unpacked if the recording compresses single messages.

    Raises RecordingError if the message is damaged.
    """
    if not raw.startswith(PACKED_MESSAGE):
        return raw
    try:
        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(raw)) as stream:
            found = stream.read(LARGEST_CHUNK + 1)
    except zstandard.ZstdError as error:
        raise RecordingError(
            f'a message cannot be unpacked by zstd: {error}', reason='damaged'
        ) from error
    if len(found) > LARGEST_CHUNK:
        raise RecordingError(f'a message has more than {LARGEST_CHUNK} bytes', reason='too_large')
    return bytes(found)


def _copy_messages(database: Path, copy: Path) -> None:
    """Write the messages of a database of rosbag2 as MCAP, in the order of their log times."""
    log = _log(database)
    immutable = '' if log.exists() and log.stat().st_size else '&immutable=1'
    source = f'{resolve_links(database, RecordingError).as_uri()}?mode=ro{immutable}'
    with closing(sqlite3.connect(source, uri=True)) as bag, copy.open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start('ros2')
        definitions = _definitions(bag)
        channels: dict[int, int] = {}
        schemas: dict[str, int] = {}
        rows = bag.execute('SELECT id, name, type, serialization_format FROM topics')
        for key, name, kind, serialization in rows:
            if kind not in schemas:
                encoding, text = definitions.get(kind) or ('ros2msg', _definition(kind))
                schemas[kind] = writer.register_schema(kind, encoding, text.encode())
            channels[key] = writer.register_channel(name, serialization, schemas[kind])
        rows = bag.execute('SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id')
        for key, stamp, data in rows:
            if key in channels and 0 <= stamp < 2**63 and len(data) <= LARGEST_CHUNK:
                writer.add_message(channels[key], stamp, bytes(data), stamp)
        writer.finish()


def _definitions(bag: sqlite3.Connection) -> dict[str, Any]:
    """Return encoding and text of the types defined in the database (since ROS 2 Iron)."""
    try:
        return {
            kind: (encoding, text)
            for kind, encoding, text in bag.execute(
                'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            )
            if text and encoding in ('ros2msg', 'ros2idl')
        }
    except sqlite3.OperationalError:
        return {}


def _definition(kind: str) -> str:
    """Return the definition of a type of ROS 2 Jazzy; empty for any other."""
    known = jazzy()
    return known.generate_msgdef(kind, ros_version=2)[0] if kind in known.fielddefs else ''

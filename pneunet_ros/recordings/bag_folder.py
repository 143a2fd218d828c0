"""A recording as a folder: `metadata.yaml` of rosbag2 and the files listed in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from fnmatch import fnmatch
from glob import escape
from pathlib import Path, PurePosixPath
import re
from typing import Any

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.core.notes import Note
from pneunet_ros.core.paths import resolve_links
from pneunet_ros.core.printable import list_names
from pneunet_ros.files.yaml_file import YamlFile
from pneunet_ros.recordings.file_kinds import holds_pictures, recording_from
from pneunet_ros.recordings.plain_mcap import PACKED, SQLITE

METADATA = 'metadata.yaml'
FILES = tuple(f'*{kind}{packed}' for kind in ('.mcap', SQLITE) for packed in ('', PACKED))
STORAGES = ('mcap', 'sqlite3')
NAMES_SHOWN = 12
LONGEST_NAME = 40  # characters of the name of a storage, in a message
FILE = YamlFile(kind='metadata of rosbag2', error=RecordingError)


def own_files(path: Path) -> tuple[str, ...]:
    """Return patterns of the files that belong only to the recording at a folder.

    The metadata, the files listed in it, and files named after the folder.
    """
    listed_files: list[str] = []
    if (path / METADATA).exists():
        with suppress(RecordingError):
            listed_files = [escape(file.name) for file in stored_files(path)]
    name = escape(path.resolve().name)
    return (METADATA, f'{name}.mcap', f'{name}_[0-9]*.mcap', *listed_files)


def stored_files(path: Path) -> list[Path]:
    """List the files of a recording in order: `path` itself, or the files of its folder.

    A folder NAME without metadata is a recording if it contains one file, or parts with the names
    of rosbag2, NAME_0.mcap, NAME_1.mcap. Raises RecordingError if there is no recording, or if its
    storage format cannot be read.
    """
    if not path.exists():
        raise RecordingError(
            f'{path} does not exist: give an .mcap file or a rosbag2 folder', reason='not_found'
        )
    if not path.is_dir():
        return [path]
    if not (path / METADATA).exists():
        files = _files_in(path)
        parts = files if len(files) == 1 else _parts(path)
        if not parts:
            raise RecordingError(f'{path} {_other_folder(path)}', reason='wrong_kind')
        return parts
    names, storage, compression, _ = FILE.load(path / METADATA, _describe_folder)
    if storage not in STORAGES or compression not in ('', 'none', 'zstd'):
        raise RecordingError(
            f'{path} is stored as {storage} {compression}: convert it to mcap with `ros2 bag '
            'convert`',
            reason='not_supported',
        )
    for name, number in Counter(names).items():
        if number > 1:
            raise RecordingError(
                f'{path / METADATA} lists {name} {number} times: list it only once',
                reason='given_twice',
            )
    named = (path / name for name in names)
    # Some versions name the file before it was packed.
    return [
        packed if not file.exists() and (packed := Path(f'{file}{PACKED}')).exists() else file
        for file in named
    ]


def report_unread_parts(path: Path, messages: int) -> Iterator[Note]:
    """Report parts of a recording that are missing, or not listed in its metadata.

    messages: number of messages in its files.
    """
    if not path.is_dir():
        return
    if not (path / METADATA).exists():
        numbers = sorted({number for number, _ in _numbered(path)})
        if numbers != list(range(len(numbers))):
            found = list_names(list(map(str, numbers)), NAMES_SHOWN)
            yield Note(f'{path} has only the parts {found}: others are missing', reason='lost')
        return
    names, _, _, announced = FILE.load(path / METADATA, _describe_folder)
    part = re.match(r'(.+)_\d{1,9}\.', names[0]) if names else None
    stem = (
        part[1] if part else resolve_links(path, RecordingError).name
    )  # the file may have been renamed
    known = {_number(stem, name) for name in names}
    others = [file.name for number, file in _numbered(path, stem) if number not in known]
    if others:
        yield Note(
            f'{list_names(others, NAMES_SHOWN)} was not read: {path / METADATA} does not list it; '
            'write the metadata anew with `ros2 bag reindex`',
            reason='not_supported',
        )
    if announced > messages:
        yield Note(
            f'{path / METADATA} declares {announced} messages, but {messages} were read',
            reason='lost',
        )


def is_recording(path: Path) -> bool:
    """Whether a path is a recording: a file with such a name, or a folder of rosbag2."""
    if not path.is_dir():
        return any(fnmatch(path.name, pattern) for pattern in FILES)
    return (path / METADATA).is_file() or bool(_parts(path))


def _files_in(path: Path) -> list[Path]:
    """Return the files of a folder that are recordings by their names."""
    return sorted(file for file in path.iterdir() if file.is_file() and is_recording(file))


def _number(stem: str, name: str) -> int | None:
    """Return the number of a part of a recording that rosbag2 names STEM_0, STEM_1."""
    match = re.match(rf'{re.escape(stem)}_(\d{{1,9}})\.', name)
    return None if match is None else int(match[1])


def _numbered(path: Path, stem: str = '') -> list[tuple[int, Path]]:
    """Return the parts of a folder with their numbers, in order; stem: if not its name."""
    stem = stem or resolve_links(path, RecordingError).name
    numbers = ((_number(stem, file.name), file) for file in _files_in(path))
    return sorted((number, file) for number, file in numbers if number is not None)


def _parts(path: Path) -> list[Path]:
    """Return the parts of a folder in order; empty if it contains other recordings, too."""
    parts = [file for _, file in _numbered(path)]
    return parts if len(parts) == len(_files_in(path)) else []


def _other_folder(path: Path) -> str:
    """Describe a folder that is not a recording, with a remedy."""
    loose = [file.name for file in _files_in(path)]
    if loose:
        return (
            f'is a folder without {METADATA} (it contains {list_names(loose, NAMES_SHOWN)}): give '
            'one of these recordings instead'
        )
    inner = sorted(file.parent.name for file in path.glob(f'*/{METADATA}'))
    if inner:
        return f'is a folder of recordings: give one of them ({list_names(inner, NAMES_SHOWN)})'
    if holds_pictures(path):
        return recording_from(path)
    return f'is a folder without a recording: it has no {METADATA} and no .mcap file'


def _describe_folder(content: Any) -> tuple[list[str], str, str, int]:
    """Return the names of the files, their storage format, compression, number of messages."""
    where = 'rosbag2_bagfile_information'
    bag = FILE.mapping(FILE.mapping(content, '').get(where), where)
    names, storage = bag.get('relative_file_paths'), bag.get('storage_identifier')
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise RecordingError(
            f'{where}.relative_file_paths must be a list of file names', reason='wrong_form'
        )
    # Old versions wrote the folder before the name.
    names = [PurePosixPath(name).name for name in names]
    if not all(names) or '..' in names:
        raise RecordingError(
            f'{where}.relative_file_paths must name files of the folder', reason='wrong_form'
        )
    count = bag.get('message_count')
    return (
        names,
        str(storage)[:LONGEST_NAME],
        str(bag.get('compression_format') or '').lower()[:LONGEST_NAME],
        count if isinstance(count, int) else 0,
    )

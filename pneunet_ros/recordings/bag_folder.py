"""A recording as a folder: rosbag2's `metadata.yaml` and the MCAP files it names."""

from __future__ import annotations

from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Any

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.files.yaml_file import YamlFile
from pneunet_ros.recordings.file_kinds import holds_pictures, recording_from

METADATA = 'metadata.yaml'
FOLDER_FILES = (METADATA, '*.mcap')  # patterns of all that belongs to such a folder
NAMES_SHOWN = 12
LONGEST_NAME = 40  # characters of a way of storing, in a sentence
FILE = YamlFile(kind='metadata of rosbag2', error=RecordingError)


def mcap_files(path: Path) -> list[Path]:
    """List the MCAP files of a recording in their order: `path` itself, or those of its folder.

    Raises RecordingError when there is no recording, or one that is stored in another way.
    """
    if not path.exists():
        raise RecordingError(f'{path} does not exist: an .mcap file or a rosbag2 folder is needed')
    if not path.is_dir():
        return [path]
    if not (path / METADATA).exists():
        raise RecordingError(f'{path} {_other_folder(path)}')
    names, storage, compression = FILE.load(path / METADATA, _describe_folder)
    if storage != 'mcap' or compression.lower() not in ('', 'none'):
        raise RecordingError(
            f'{path} is stored as {storage} {compression}: turn it into plain mcap with '
            '`ros2 bag convert`'
        )
    for name, number in Counter(names).items():
        if number > 1:
            raise RecordingError(f'{path / METADATA} names {name} {number} times: name it once')
    return [path / name for name in names]


def _other_folder(path: Path) -> str:
    """Say what a folder is that is no recording, and what to do."""
    loose = sorted(file.name for file in path.glob('*.mcap'))
    if loose:
        return (
            f'is a folder without {METADATA} (it holds {_listed(loose)}): name an .mcap file '
            'itself, or complete the folder with `ros2 bag reindex`'
        )
    inner = sorted(file.parent.name for file in path.glob(f'*/{METADATA}'))
    if inner:
        return f'is a folder of recordings: name one of those in it ({_listed(inner)})'
    if holds_pictures(path):
        return recording_from(path)
    return f'is a folder without a recording: no {METADATA} and no .mcap file is in it'


def _listed(names: list[str]) -> str:
    more = f' and {len(names) - NAMES_SHOWN} more' if len(names) > NAMES_SHOWN else ''
    return ', '.join(names[:NAMES_SHOWN]) + more


def _describe_folder(content: Any) -> tuple[list[str], str, str]:
    """Return the names of the files, how they are stored, and how they are compressed."""
    where = 'rosbag2_bagfile_information'
    bag = FILE.mapping(FILE.mapping(content, '').get(where), where)
    names, storage = bag.get('relative_file_paths'), bag.get('storage_identifier')
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise RecordingError(f'{where}.relative_file_paths must be a list of names of files')
    # Old versions wrote the folder before the name.
    names = [PurePosixPath(name).name for name in names]
    if not all(names) or '..' in names:
        raise RecordingError(f'{where}.relative_file_paths must name files of the folder')
    return (
        names,
        str(storage)[:LONGEST_NAME],
        str(bag.get('compression_mode') or '')[:LONGEST_NAME],
    )

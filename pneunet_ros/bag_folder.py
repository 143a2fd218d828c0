"""A recording as a folder: rosbag2's `metadata.yaml` and the MCAP files it names."""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from pneunet_ros.errors import RecordingError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

METADATA = 'metadata.yaml'
FOLDER_FILES = (METADATA, '*.mcap')  # patterns of all that belongs to such a folder


def mcap_files(path: Path) -> list[Path]:
    """List the MCAP files of a recording in their order: `path` itself, or those of its folder.

    Raises RecordingError when there is no recording, or one that is stored in another way.
    """
    if not path.exists():
        raise RecordingError(f'{path} does not exist: an .mcap file or a rosbag2 folder is needed')
    if not path.is_dir():
        return [path]
    try:
        content = YAML(typ='safe').load(path / METADATA)
        bag = content['rosbag2_bagfile_information']
        # Old versions wrote the folder before the name.
        names = [PurePosixPath(name).name for name in bag['relative_file_paths']]
        storage, compression = bag['storage_identifier'], bag.get('compression_mode')
    except FileNotFoundError:
        loose = ', '.join(sorted(file.name for file in path.glob('*.mcap'))) or 'no .mcap file'
        raise RecordingError(
            f'{path} is a folder without {METADATA} (it holds {loose}): name an .mcap file '
            'itself, or complete the folder with `ros2 bag reindex`'
        ) from None
    except (OSError, YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise RecordingError(f'{path / METADATA} is no metadata of rosbag2: {error}') from error
    if storage != 'mcap' or compression not in (None, '', 'none', 'NONE'):
        raise RecordingError(
            f'{path} is stored as {storage} {compression or ""}: turn it into plain mcap with '
            '`ros2 bag convert`'
        )
    return [path / name for name in names]

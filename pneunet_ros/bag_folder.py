"""A recording as a folder: rosbag2's `metadata.yaml` and the MCAP files it names."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO
from pathlib import Path, PurePosixPath
from typing import Any

from pneunet_ros.errors import RecordingError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

METADATA = 'metadata.yaml'
FOLDER_FILES = (METADATA, '*.mcap')  # patterns of all that belongs to such a folder

_BAG = 'rosbag2_bagfile_information'
_FOREVER = {'sec': 9_223_372_036, 'nsec': 854_775_807}  # how rosbag2 writes an infinite duration

# What `ros2 bag play` shall offer: what the estimator offers live.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """A topic in the metadata: name, type, hash of the type's definition, number of messages."""

    name: str
    type: str
    type_hash: str
    count: int


def mcap_files(path: Path) -> list[Path]:
    """List the MCAP files of a recording in their order: `path` itself, or those of its folder.

    Raises RecordingError when there is no recording, or one that is stored in another way.
    """
    if not path.exists():
        raise RecordingError(f'{path} does not exist: an .mcap file or a rosbag2 folder is needed')
    if not path.is_dir():
        return [path]
    try:
        bag = YAML(typ='safe').load(path / METADATA)[_BAG]
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


def bag_information(
    file: str, topics: Iterable[BagTopic], start_ns: int, end_ns: int
) -> dict[str, Any]:
    """Describe a recording of one MCAP file as rosbag2 (version 9, Jazzy) does."""
    topics = list(topics)
    times = {
        'starting_time': {'nanoseconds_since_epoch': start_ns},
        'duration': {'nanoseconds': end_ns - start_ns},
        'message_count': sum(topic.count for topic in topics),
    }
    return {
        'version': 9,
        'storage_identifier': 'mcap',
        **times,
        'topics_with_message_count': [
            {
                'topic_metadata': {
                    'name': topic.name,
                    'type': topic.type,
                    'serialization_format': 'cdr',
                    'offered_qos_profiles': [PLAYBACK_QOS],
                    'type_description_hash': topic.type_hash,
                },
                'message_count': topic.count,
            }
            for topic in topics
        ],
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file],
        'files': [{'path': file, **times}],
        'custom_data': None,
        'ros_distro': 'jazzy',
    }


def metadata_text(information: dict[str, Any]) -> str:
    """Return the content of `metadata.yaml`."""
    return yaml_text({_BAG: information})


def yaml_text(content: Any) -> str:
    """Return YAML without references, which rosbag2 does not expect."""
    yaml = YAML(typ='safe', pure=True)
    yaml.default_flow_style = False
    yaml.width = 1000
    yaml.representer.ignore_aliases = lambda *_: True
    stream = StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()

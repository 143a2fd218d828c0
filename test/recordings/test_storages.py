"""Recordings as rosbag2 stores them: packed by zstd in both modes, sqlite3, split, bare."""

from __future__ import annotations

from contextlib import closing
import multiprocessing
from pathlib import Path
import shutil
import sqlite3
import tempfile

from mcap.writer import Writer as McapWriter
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.offline.survey import recordings_in
from pneunet_ros.recordings.bag_folder import METADATA
from pneunet_ros.recordings.message_store import jazzy
from pneunet_ros.recordings.recording import open_recording
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from support.made_recordings import PRESSURE, pressure, STEP_NS
from support.refusals import reasons, refused
import zstandard

TYPE = 'sensor_msgs/msg/FluidPressure'
COUNT = 50


def write_bag(folder: Path, storage: StoragePlugin, mode: CompressionMode) -> Path:
    """Write pressures 0, 1, ... as rosbags does, which writes what rosbag2 reads."""
    bag = Writer(folder, version=9, storage_plugin=storage)
    if mode is not CompressionMode.NONE:
        bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag:
        topic = bag.add_connection(PRESSURE, TYPE, typestore=jazzy())
        for index in range(COUNT):
            stamp = 10**9 + index * STEP_NS
            raw = jazzy().serialize_cdr(pressure(stamp, float(index)), TYPE)
            bag.write(topic, stamp, raw)
    return folder


def values(path: Path) -> list[float]:
    recording = open_recording(path)
    assert recording.sentences == ()
    return [item.message.fluid_pressure for item in recording.messages([PRESSURE])]


@pytest.mark.parametrize(
    ('storage', 'mode'),
    [
        (StoragePlugin.SQLITE3, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
        (StoragePlugin.MCAP, CompressionMode.NONE),
    ],
)
@pytest.mark.parametrize('metadata', [True, False])
def test_every_storage_is_read_with_and_without_metadata(tmp_path, storage, mode, metadata):
    folder = write_bag(tmp_path / 'bag', storage, mode)
    if not metadata:
        (folder / METADATA).unlink()
    assert values(folder) == list(range(COUNT))
    (file,) = (path for path in folder.iterdir() if path.name != METADATA)
    assert values(file) == list(range(COUNT))


def test_what_only_the_log_of_a_database_holds_is_read(tmp_path):
    """As `--storage-preset-profile resilient` leaves it after a crash."""
    folder = write_bag(tmp_path / 'bag', StoragePlugin.SQLITE3, CompressionMode.NONE)
    (file,) = folder.glob('*.db3')
    crashed = tmp_path / 'crashed'
    crashed.mkdir()
    with closing(sqlite3.connect(file)) as bag:
        bag.execute('PRAGMA journal_mode=WAL')
        bag.execute(
            'INSERT INTO messages (topic_id, timestamp, data) '
            'SELECT topic_id, timestamp + 1, data FROM messages ORDER BY timestamp DESC LIMIT 1'
        )
        bag.commit()
        for part in (file, file.with_name(f'{file.name}-wal')):
            shutil.copyfile(part, crashed / part.name)
    assert values(crashed / file.name) == [*range(COUNT), COUNT - 1]
    assert len(list(crashed.iterdir())) == 2


def packed_mcap(folder: Path, *, name_packed: bool = True) -> Path:
    """Pack the file of a folder as `ros2 bag record --compression-mode file` does."""
    write_bag(folder, StoragePlugin.MCAP, CompressionMode.NONE)
    (file,) = folder.glob('*.mcap')
    file.with_name(f'{file.name}.zstd').write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    text = (folder / METADATA).read_text()
    text = text.replace("compression_format: ''", 'compression_format: zstd')
    text = text.replace("compression_mode: ''", 'compression_mode: FILE')
    if name_packed:
        text = text.replace(file.name, f'{file.name}.zstd')
    (folder / METADATA).write_text(text)
    return folder


@pytest.mark.parametrize('name_packed', [True, False])
def test_mcap_files_packed_as_a_whole(tmp_path, name_packed):
    folder = packed_mcap(tmp_path / 'bag', name_packed=name_packed)
    assert values(folder) == list(range(COUNT))
    (folder / METADATA).unlink()
    assert values(folder) == list(range(COUNT))


def test_mcap_messages_packed_one_by_one(tmp_path):
    path = tmp_path / 'r.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start('ros2')
        definition, _ = jazzy().generate_msgdef(TYPE, ros_version=2)
        channel = writer.register_channel(
            PRESSURE, 'cdr', writer.register_schema(TYPE, 'ros2msg', definition.encode())
        )
        for index in range(COUNT):
            raw = bytes(jazzy().serialize_cdr(pressure(STEP_NS, float(index)), TYPE))
            writer.add_message(channel, index + 1, zstandard.compress(raw), index + 1)
        writer.finish()
    assert values(path) == list(range(COUNT))


def test_parts_are_read_in_the_order_of_their_numbers(tmp_path):
    """Ten parts and more: 10 follows 9, whatever the alphabet says."""
    folder = tmp_path / 'day'
    folder.mkdir()
    for part in range(11):
        write_bag(tmp_path / 'one', StoragePlugin.MCAP, CompressionMode.NONE)
        (tmp_path / 'one' / 'one.mcap').rename(folder / f'day_{part}.mcap')
        (tmp_path / 'one' / METADATA).unlink()
        (tmp_path / 'one').rmdir()
    files = [file.path.name for file in open_recording(folder).files]
    assert files == [f'day_{part}.mcap' for part in range(11)]
    assert recordings_in(tmp_path) == [folder]


def test_missing_parts_are_said(tmp_path):
    folder = tmp_path / 'day'
    folder.mkdir()
    for part in range(3):
        write_bag(tmp_path / 'one', StoragePlugin.MCAP, CompressionMode.NONE)
        (tmp_path / 'one' / 'one.mcap').rename(folder / f'day_{part}.mcap')
        (tmp_path / 'one' / METADATA).rename(tmp_path / METADATA)
        (tmp_path / 'one').rmdir()
    assert open_recording(folder).sentences == ()
    packed = folder / 'day_1.mcap.zstd'  # as `zstd` leaves it beside the file
    packed.write_bytes(zstandard.compress((folder / 'day_1.mcap').read_bytes()))
    assert 'lost' not in reasons(open_recording(folder).sentences)
    packed.unlink()
    (folder / 'day_1.mcap').unlink()
    (note,) = open_recording(folder).sentences
    assert (note.reason, 'the parts 0, 2: ' in note) == ('lost', True)
    listed = (tmp_path / METADATA).read_text().replace('one.mcap', 'day_0.mcap')
    (folder / METADATA).write_text(listed)
    (note,) = open_recording(folder).sentences
    assert (note.reason, note.startswith('day_2.mcap was not read')) == ('not_supported', True)
    renamed = folder.rename(tmp_path / 'monday')
    (note,) = open_recording(renamed).sentences
    assert note.startswith('day_2.mcap was not read')
    renamed.rename(folder)
    (folder / 'day_2.mcap').unlink()
    assert open_recording(folder).sentences == ()
    (folder / METADATA).write_text(
        listed.replace(f'message_count: {COUNT}', f'message_count: {COUNT + 1}')
    )
    (note,) = open_recording(folder).sentences
    assert (note.reason, f'declares {COUNT + 1} messages' in note) == ('lost', True)


def test_recordings_that_only_share_a_folder_are_not_taken_for_one(tmp_path):
    folder = tmp_path / 'day'
    folder.mkdir()
    for name in ('run_0.mcap', 'run_1.mcap'):
        write_bag(tmp_path / name[:-5], StoragePlugin.MCAP, CompressionMode.NONE)
        (tmp_path / name[:-5] / name).rename(folder / name)
    with refused(RecordingError, 'wrong_kind'):
        open_recording(folder)
    assert [path.name for path in recordings_in(folder)] == ['run_0.mcap', 'run_1.mcap']


@pytest.mark.parametrize('name', ['a.db3', 'a.mcap.zstd', 'a.db3.zstd'])
@pytest.mark.parametrize(
    'content', [b'', b'SQLite format 3\0', zstandard.compress(b'x' * 100), b'(\xb5/\xfd' * 9]
)
def test_damaged_files_are_a_sentence(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        open_recording(tmp_path / name)
    assert caught.value.reason in ('empty', 'wrong_kind', 'damaged')


def copies() -> set[Path]:
    return set(Path(tempfile.gettempdir()).glob('pneunet-unpacked-*'))


def _open(path: Path) -> None:
    assert values(path)
    assert copies()


def test_a_copy_goes_with_its_process(tmp_path, monkeypatch):
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    folder = write_bag(tmp_path / 'bag', StoragePlugin.SQLITE3, CompressionMode.NONE)
    before = set(tmp_path.glob('pneunet-unpacked-*'))
    process = multiprocessing.get_context('spawn').Process(target=_open, args=(folder,))
    process.start()
    process.join()
    assert process.exitcode == 0
    assert set(tmp_path.glob('pneunet-unpacked-*')) == before

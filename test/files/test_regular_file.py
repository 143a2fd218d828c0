"""What is no file is refused before it is opened, by every verb that reads one."""

from __future__ import annotations

import os
from pathlib import Path

from pneunet_ros.cli.main import main
from pneunet_ros.core.share import share_path
from pneunet_ros.files.regular_file import open_regular
import pytest
from support.made_recordings import write_readings

NO_FILES = {
    'pipe': (os.mkfifo, 'it is a pipe, but a file is needed'),
    'device': (lambda path: path.symlink_to('/dev/zero'), 'it is a device, but a file is needed'),
    'folder': (Path.mkdir, 'it is a folder, but a file is needed'),
    'link to nothing': (lambda path: path.symlink_to('nowhere'), 'No such file'),
    'loop': (lambda path: path.symlink_to(path.name), 'oo many levels'),
}


@pytest.mark.parametrize('kind', NO_FILES)
def test_what_is_no_file_is_an_error_of_the_system(tmp_path, kind):
    make, sentence = NO_FILES[kind]
    path = tmp_path / 'input'
    make(path)
    with pytest.raises(OSError, match=sentence):
        open_regular(path)


@pytest.mark.parametrize('name', ['a\0b', '\ud800'])
def test_a_name_that_no_file_can_have_is_one_too(name):
    with pytest.raises(OSError, match='a character that is not allowed in file names'):
        open_regular(Path(name))


def test_standard_input_is_read_where_it_is_a_file(tmp_path):
    path = tmp_path / 'input'
    path.write_bytes(b'content')
    with path.open('rb') as stream, open_regular(Path(f'/dev/fd/{stream.fileno()}')) as again:
        assert again.read() == b'content'
    end, other = os.pipe()
    try:
        with pytest.raises(OSError, match='it is a pipe'):
            open_regular(Path(f'/dev/fd/{end}'))
    finally:
        os.close(end)
        os.close(other)


VERBS = {
    'check': ['check', 'no_file'],
    'export': ['export', 'no_file', '--output', 'out.csv'],
    'replay': ['replay', 'no_file', '--output', 'out.mcap'],
    'import': ['import', 'no_file', '--output', 'out.mcap'],
    'simulate': ['simulate', 'no_file.yaml', '--output', 'out.mcap'],
    'after': ['simulate', 'strings', '--after', 'no.mcap', '--output', 'out.mcap'],
    'predict': ['predict', '--model', 'no_file', '--pressure', '1e4'],
    'camera': ['track', 'images', '--camera-info', 'none', '--camera', 'no_file'],
    'lens': ['track', 'images', '--camera-info', 'no_file'],
    'film': ['track', 'no_file.mp4', '--camera-info', 'none'],
    'bag': ['check', 'bag'],
    'train': ['diagnose', '--model', 'model.yaml', '--train', 'no_file', '--output', 'out'],
    'unloaded': ['calibrate', '--unloaded', 'no_file', '--output', 'out.yaml'],
    'continue': ['calibrate', '--continue', 'model.yaml', '--output', 'out.yaml'],
}


@pytest.mark.parametrize('kind', ['pipe', 'device'])
@pytest.mark.parametrize('verb', VERBS)
def test_no_verb_waits_for_a_pipe_or_reads_a_device(tmp_path, monkeypatch, capsys, verb, kind):
    monkeypatch.chdir(tmp_path)
    make, _ = NO_FILES[kind]
    write_readings(Path('bag'))
    Path('bag/metadata.yaml').unlink()
    Path('images').mkdir()
    Path('model.yaml').write_bytes(share_path('config/paper_arm.yaml').read_bytes())
    inputs = ('no_file', 'no_file.yaml', 'no_file.mp4', 'no.truth.npz', 'model.knowledge.npz')
    for path in (*inputs, 'images/0.png', 'bag/metadata.yaml'):
        make(Path(path))
    before = sorted(tmp_path.rglob('*'))
    assert main(VERBS[verb]) == 2
    said = capsys.readouterr()
    assert said.out == ''
    assert said.err.count('\n') == 1
    assert sorted(tmp_path.rglob('*')) == before


def test_a_picture_that_is_no_file_is_a_frame_that_cannot_be_read(tmp_path, capsys):
    for index, kind in enumerate(('pipe', 'device')):
        NO_FILES[kind][0](tmp_path / f'{index}.png')
    assert main(['track', str(tmp_path), '--camera-info', 'none']) == 1
    told = ' '.join(capsys.readouterr().out.split())
    assert '2 unreadable' in told or 'unreadable' in told

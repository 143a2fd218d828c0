"""Outputs appear whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys
import tempfile

from pneunet_ros.core.errors import RecordingError
from pneunet_ros.files.atomic import (
    all_or_none,
    atomic_output,
    outputs_written,
    PARTIAL,
    REPLACED,
    SCRATCH,
)
import pytest
from support.refusals import refused


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_file_stands_under_its_name_only_at_the_end(tmp_path):
    place = tmp_path / 'table.csv'
    with atomic_output(place) as temporary:
        assert temporary.name == 'table.csv'  # what is written may depend on the suffix
        assert temporary.parent.parent == tmp_path  # on the same file system
        temporary.write_text('1')
        assert not place.exists()
        assert all(name.startswith('.') for name in names(tmp_path))
    assert place.read_text() == '1'
    assert names(tmp_path) == ['table.csv']


def test_a_folder_stands_under_its_name_only_at_the_end(tmp_path):
    with atomic_output(tmp_path / 'report') as temporary:
        temporary.mkdir()
        (temporary / 'index.html').write_text('1')
        assert not (tmp_path / 'report').exists()
    assert names(tmp_path) == ['report']
    assert names(tmp_path / 'report') == ['index.html']


def test_a_file_has_the_rights_of_any_new_file(tmp_path):
    (tmp_path / 'plain').write_text('')
    with atomic_output(tmp_path / 'output') as temporary:
        temporary.write_text('')
    assert (tmp_path / 'output').stat().st_mode == (tmp_path / 'plain').stat().st_mode


def test_missing_folders_above_are_made(tmp_path):
    with atomic_output(tmp_path / 'a' / 'b' / 'c.txt') as temporary:
        temporary.write_text('1')
    assert (tmp_path / 'a' / 'b' / 'c.txt').read_text() == '1'


@pytest.mark.parametrize('error', [ValueError, KeyboardInterrupt, SystemExit])
def test_after_an_exception_nothing_is_left(tmp_path, error):
    with pytest.raises(error), atomic_output(tmp_path / 'output') as temporary:
        temporary.write_text('1')
        raise error
    assert names(tmp_path) == []


def test_an_interrupted_run_knows_what_it_has_written(tmp_path):
    before = outputs_written()
    first, second = str(tmp_path / 'first'), tmp_path / 'second'
    with atomic_output(first) as temporary:
        temporary.write_text('1')
    with pytest.raises(KeyboardInterrupt), atomic_output(second) as temporary:
        temporary.write_text('2')
        raise KeyboardInterrupt
    assert outputs_written() == [*before, first]
    Path(first).unlink()
    second.write_text('of somebody else')
    assert outputs_written() == before


@pytest.mark.parametrize('instant', ['mkdtemp', 'rmtree', 'replace'])
def test_an_interrupt_at_any_instant_leaves_nothing_but_what_is_whole(
    tmp_path, monkeypatch, instant
):
    module = {'mkdtemp': tempfile, 'rmtree': shutil, 'replace': os}[instant]
    real = getattr(module, instant)

    def interrupted(*given, **named):
        first = real(*given, **named) if instant == 'mkdtemp' else None
        signal.raise_signal(signal.SIGINT)
        return first if instant == 'mkdtemp' else real(*given, **named)

    monkeypatch.setattr(module, instant, interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_output(tmp_path / 'table.csv') as temporary:
        temporary.write_text('1')
    assert names(tmp_path) == ([] if instant == 'mkdtemp' else ['table.csv'])


def test_an_existing_output_is_refused_before_any_work(tmp_path):
    place = tmp_path / 'output'
    place.write_text('old')
    with refused(RecordingError, 'exists'), atomic_output(place):
        pytest.fail('work was done')
    assert place.read_text() == 'old'
    assert names(tmp_path) == ['output']


def test_overwriting_replaces_at_the_end_only(tmp_path):
    place = tmp_path / 'output'
    place.write_text('old')
    with atomic_output(place, overwrite=True) as temporary:
        temporary.write_text('new')
        assert place.read_text() == 'old'
    assert place.read_text() == 'new'
    with pytest.raises(ValueError, match='stop'), atomic_output(place, overwrite=True):
        raise ValueError('stop')
    assert place.read_text() == 'new'


def test_an_output_that_appears_meanwhile_is_not_replaced(tmp_path):
    place = tmp_path / 'output'
    with refused(RecordingError, 'exists'), atomic_output(place) as temporary:
        temporary.write_text('mine')
        place.write_text('theirs')
    assert place.read_text() == 'theirs'
    assert names(tmp_path) == ['output']


def test_a_folder_that_appears_meanwhile_is_not_removed(tmp_path):
    place = tmp_path / 'output'
    with (
        refused(RecordingError, 'holds_other_files'),
        atomic_output(place, overwrite=True) as temporary,
    ):
        temporary.write_text('mine')
        place.mkdir()
        (place / 'thesis.tex').write_text('theirs')
    assert (place / 'thesis.tex').read_text() == 'theirs'
    assert names(tmp_path) == ['output']


def test_a_folder_of_known_files_is_replaced(tmp_path):
    place = tmp_path / 'bag'
    place.mkdir()
    (place / 'old.mcap').write_text('old')
    with atomic_output(place, overwrite=True, replaceable=['*.mcap']) as temporary:
        temporary.mkdir()
        (temporary / 'new.mcap').write_text('new')
        assert names(place) == ['old.mcap']
    assert names(place) == ['new.mcap']
    assert names(tmp_path) == ['bag']


def test_a_folder_that_cannot_be_replaced_stays(tmp_path, monkeypatch):
    place = tmp_path / 'bag'
    place.mkdir()
    rename = os.rename

    def failing(source, target):
        if Path(target) == place and 'replaced' not in str(source):
            raise OSError(errno.EIO, 'Input/output error')
        rename(source, target)

    with (
        pytest.raises(OSError, match='Input/output'),
        atomic_output(place, overwrite=True, replaceable=['*']) as temporary,
    ):
        temporary.mkdir()
        (temporary / 'new').write_text('')
        monkeypatch.setattr(os, 'rename', failing)
    assert names(tmp_path) == ['bag']
    assert names(place) == []


@pytest.mark.parametrize('overwrite', [False, True])
def test_a_folder_of_other_things_is_never_replaced(tmp_path, overwrite):
    place = tmp_path / 'home'
    place.mkdir()
    (place / 'thesis.tex').write_text('')
    with (
        refused(RecordingError, 'holds_other_files'),
        atomic_output(place, overwrite=overwrite, replaceable=['*.mcap']),
    ):
        pytest.fail('work was done')
    assert names(place) == ['thesis.tex']


def test_a_file_is_not_replaced_by_a_folder(tmp_path):
    (tmp_path / 'file').write_text('')
    with (
        refused(RecordingError, 'wrong_kind'),
        atomic_output(tmp_path / 'file', overwrite=True, replaceable=['*.mcap']),
    ):
        pytest.fail('work was done')


def test_a_device_is_never_replaced():
    with refused(RecordingError, 'wrong_kind'), atomic_output('/dev/null', overwrite=True):
        pytest.fail('work was done')


def test_a_link_is_followed(tmp_path):
    (tmp_path / 'target').write_text('old')
    (tmp_path / 'link').symlink_to(tmp_path / 'target')
    with atomic_output(tmp_path / 'link', overwrite=True) as temporary:
        temporary.write_text('new')
    assert (tmp_path / 'link').is_symlink()
    assert (tmp_path / 'target').read_text() == 'new'


@pytest.mark.parametrize('output', ['in', 'in/new', '.', '../{folder}/in'])
def test_the_input_is_never_overwritten(tmp_path, monkeypatch, output):
    monkeypatch.chdir(tmp_path)
    Path('in').mkdir()
    Path('in/0.mcap').write_text('data')
    with (
        refused(RecordingError, 'overwrites_input'),
        atomic_output(
            output.format(folder=tmp_path.name), overwrite=True, inputs=['in'], replaceable='*'
        ),
    ):
        pytest.fail('work was done')
    assert Path('in/0.mcap').read_text() == 'data'


def test_a_place_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with refused(RecordingError, 'unwritable'), atomic_output(tmp_path / 'file' / 'inside'):
        pytest.fail('work was done')


@pytest.mark.parametrize('code', [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_no_room_is_a_sentence_and_leaves_nothing(tmp_path, code):
    with refused(RecordingError, 'unwritable'), atomic_output(tmp_path / 'output') as temporary:
        temporary.write_text('1')
        raise OSError(code, os.strerror(code))
    assert names(tmp_path) == []


def test_other_errors_of_the_system_pass(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_output(tmp_path / 'output'):
        Path(tmp_path / 'missing').read_text()


def test_writing_nothing_is_an_error(tmp_path):
    with refused(RecordingError, 'nothing_written'), atomic_output(tmp_path / 'output'):
        pass


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('/', 'unwritable'),
        ('a' * 300, 'unwritable'),
        ('\u00e4' * 130, 'unwritable'),
        ('no\0name', 'not_found'),
        ('dangling', 'unwritable'),
        ('loop', 'loop'),
        ('.', 'holds_other_files'),
    ],
)
def test_a_name_that_no_output_can_have_is_a_sentence(tmp_path, monkeypatch, name, reason):
    monkeypatch.chdir(tmp_path)
    Path('dangling').symlink_to('nowhere')
    Path('loop').symlink_to('loop')
    with refused(RecordingError, reason), atomic_output(name):
        pytest.fail('work was done')
    assert names(tmp_path) == ['dangling', 'loop']


def test_the_longest_name_that_a_file_can_have_is_possible(tmp_path):
    with atomic_output(tmp_path / ('a' * 255)) as temporary:
        temporary.write_text('1')
    assert names(tmp_path) == ['a' * 255]


def test_after_a_kill_nothing_stands_under_the_name(tmp_path, foreign_environment):
    place = tmp_path / 'output'
    code = (
        'import sys, time\n'
        'from pneunet_ros.files.atomic import atomic_output\n'
        'with atomic_output(sys.argv[1]) as temporary:\n'
        '    temporary.write_text("half")\n'
        '    print("ready", flush=True)\n'
        '    time.sleep(60)\n'
    )
    root = Path(__file__).resolve().parents[2]
    process = subprocess.Popen(
        [sys.executable, '-c', code, str(place)],
        stdout=subprocess.PIPE,
        env={**foreign_environment, 'PYTHONPATH': str(root)},
    )
    with process:
        assert process.stdout.readline() == b'ready\n'
        process.send_signal(signal.SIGKILL)
    assert not place.exists()
    assert all(name.startswith('.') for name in names(tmp_path))
    # What the killed run left is gone after the next one, and what a live one needs is not.
    live = place.with_name('live')
    with atomic_output(live) as temporary:
        temporary.write_text('whole')
        with atomic_output(place) as other:
            other.write_text('whole')
        assert names(tmp_path) == sorted([temporary.parent.name, 'output'])
    assert names(tmp_path) == ['live', 'output']


def test_what_others_named_alike_is_left_alone(tmp_path):
    (tmp_path / '.pneunet-notes.partial').write_text('mine')
    (tmp_path / 'elsewhere').mkdir()
    (tmp_path / '.pneunet-link.partial').symlink_to(tmp_path / 'elsewhere')
    with atomic_output(tmp_path / 'output') as temporary:
        temporary.write_text('1')
    assert names(tmp_path) == [
        '.pneunet-link.partial', '.pneunet-notes.partial', 'elsewhere', 'output',
    ]  # fmt: skip


def test_outputs_that_belong_together_stand_together_or_not_at_all(tmp_path):
    def write(name: str) -> None:
        with atomic_output(tmp_path / name) as temporary:
            temporary.write_text(name)

    with all_or_none():
        write('model')
        write('knowledge')
        assert all(name.startswith('.') for name in names(tmp_path))
    assert names(tmp_path) == ['knowledge', 'model']
    with pytest.raises(ValueError, match='no report'), all_or_none():
        write('other')
        raise ValueError('no report')
    with refused(RecordingError, 'exists'), all_or_none():
        write('other')
        write('report')
        (tmp_path / 'report').write_text('theirs')
    assert names(tmp_path) == ['knowledge', 'model', 'report']


def test_a_folder_that_was_to_be_replaced_is_not_removed_with_what_a_killed_run_left(tmp_path):
    old = tmp_path / f'{SCRATCH}1234{PARTIAL}' / REPLACED
    old.mkdir(parents=True)
    with atomic_output(tmp_path / 'output') as temporary:
        temporary.write_text('1')
    assert old.exists()

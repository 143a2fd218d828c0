"""Fleets on the disk: layouts, what is kept, and workers that die on the way."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
import os
from pathlib import Path
import signal
import time

from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.executor import open_executor
from pneunet_ros.offline.survey import (
    arm_key,
    FleetArm,
    folders_left_out,
    read_fleet,
    sentence_of,
    SurveyFolder,
    work_on_fleet,
)
import pytest
from support.refusals import refused

DEFAULT = Path('default.yaml')
PAGES = ('survey.html', 'survey.json', 'figure_*.png')


def touch(path: Path, content: str = '') -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def named(paths: tuple[Path, ...], below: Path) -> list[str]:
    return [path.relative_to(below).as_posix() for path in paths]


def test_a_folder_per_arm(tmp_path):
    for name in (
        'one/unloaded_ramp.mcap',
        'one/loaded.mcap',
        'one/heldout_1.mcap',
        'one/heldout_1.truth.npz',
        'one/strings.mcap',
        'one/arm.yaml',
        'two/Unloaded/a.mcap',
        'two/Unloaded/b/metadata.yaml',
        'two/Unloaded/notes.txt',
        'photos/finger.png',
        '.hidden/unloaded.mcap',
        'README.md',
    ):
        touch(tmp_path / name)
    one, two = read_fleet(tmp_path, DEFAULT)
    assert folders_left_out(tmp_path, [one, two]) == ('photos',)
    assert (one.name, two.name) == ('one', 'two')
    assert named(one.roles['unloaded'], tmp_path) == ['one/unloaded_ramp.mcap']
    assert named(one.roles['heldout'], tmp_path) == ['one/heldout_1.mcap']
    assert one.ignored == ('strings.mcap',)
    assert (one.arm, two.arm) == (tmp_path / 'one/arm.yaml', DEFAULT)
    assert named(two.roles['unloaded'], tmp_path) == ['two/Unloaded/a.mcap', 'two/Unloaded/b']
    assert two.roles['loaded'] == ()
    shared = touch(tmp_path / 'arm.yaml')
    assert [item.arm for item in read_fleet(tmp_path, DEFAULT)] == [one.arm, shared]


def test_a_table_with_a_row_per_arm(tmp_path):
    for name in ('day1/a1.mcap', 'day1/a2.mcap', 'with blank.mcap', 'b.yaml'):
        touch(tmp_path / name)
    table = touch(
        tmp_path / 'arms.csv',
        'name,arm,unloaded,loaded,heldout\n'
        'a,,day1/a*.mcap,"""with blank.mcap"" gone.mcap",\n'
        'b,b.yaml,day1/a1.mcap,,\n',
    )
    a, b = read_fleet(table, DEFAULT)
    assert named(a.roles['unloaded'], tmp_path) == ['day1/a1.mcap', 'day1/a2.mcap']
    assert named(a.roles['loaded'], tmp_path) == ['with blank.mcap', 'gone.mcap']
    assert (a.arm, b.arm) == (DEFAULT, tmp_path / 'b.yaml')
    with refused(RecordingError, 'not_found'):
        arm_key(a, {})


def test_patterns_of_a_table_do_not_touch_the_name_of_its_folder(tmp_path):
    folder = tmp_path / 'arms [2]'
    touch(folder / 'a1.mcap')
    (arm,) = read_fleet(touch(folder / 'arms.csv', 'name,unloaded\na,a*.mcap\n'), DEFAULT)
    assert named(arm.roles['unloaded'], folder) == ['a1.mcap']


def test_a_table_of_arms_as_a_spreadsheet_writes_it(tmp_path):
    text = '\ufeff# arms of March\n\nName;Unloaded;Loaded\na;u.mcap;l.mcap\n'
    (arm,) = read_fleet(touch(tmp_path / 'arms.csv', text), DEFAULT)
    assert named(arm.roles['loaded'], tmp_path) == ['l.mcap']
    with refused(RequestError, 'wrong_shape'):
        read_fleet(touch(tmp_path / 'cut.csv', text + 'b;u.mcap\n'), DEFAULT)


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('name,unloaded\na,x\na,y\n', 'line 3: there are two arms with the name a'),
        ('name,unloaded\n../a,x\n', 'cannot be the name of a folder'),
        ('name,unloaded\na,x\n#b,y\n', "line 3: '#b' looks like a comment"),
        ('arm,unloaded\na,x\n', 'the columns of a table of arms are name'),
        ('name,pressure\na,x\n', 'this table has name, pressure'),
        ('name,unloaded\na\n', 'line 2: the number of cells is not that of the columns'),
        ('name,unloaded\na,"""x"\n', 'line 2: No closing quotation'),
        ('# arms\n"name,unloaded\na,x\n', 'line 2: unexpected end of data'),
        ('name\n', 'contains no arm'),
        ('', 'this table has none'),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(tmp_path, text, sentence):
    with pytest.raises(RequestError, match=sentence):
        read_fleet(touch(tmp_path / 'arms.csv', text), DEFAULT)


def test_no_fleet_is_said(tmp_path):
    with refused(RequestError, 'not_found'):
        read_fleet(tmp_path / 'gone', DEFAULT)
    with refused(RequestError, 'no_arm'):
        read_fleet(tmp_path, DEFAULT)
    (tmp_path / 'photo.png').write_bytes(b'\x89PNG')
    with refused(RequestError, 'unreadable'):
        read_fleet(tmp_path / 'photo.png', DEFAULT)


def arm_of(folder: Path, name: str) -> FleetArm:
    recording = touch(folder / name / 'unloaded.mcap', name)
    return FleetArm(
        name=name,
        arm=touch(folder / 'arm.yaml', 'x'),
        roles={'unloaded': (recording,), 'loaded': (), 'heldout': ()},
    )


def test_what_is_done_is_kept_until_something_changes(tmp_path):
    arm = arm_of(tmp_path, 'a')
    key, inputs = arm_key(arm, {'static': True})
    assert inputs[0]['role'] == 'unloaded'
    assert arm_key(arm, {'static': False})[0] != key
    out = SurveyFolder(path=tmp_path / 'out', overwrite=False)
    out.check(PAGES)
    assert out.finished_row('a', key) is None
    out.write('a', {'model.yaml': b'm'}, {'key': key, 'failed': ''})
    assert out.finished_row('a', key) == {'key': key, 'failed': ''}
    out.check(PAGES)
    touch(tmp_path / 'a/unloaded.mcap', 'another')
    other, _ = arm_key(arm, {'static': True})
    assert other != key
    with refused(RecordingError, 'other_inputs'):
        out.finished_row('a', other)
    assert SurveyFolder(path=out.path, overwrite=True).finished_row('a', other) is None
    out.write('a', {'other.yaml': b'm'}, {'key': other, 'failed': 'no frame'})
    assert sorted(file.name for file in out.folder('a').iterdir()) == ['arm.json', 'other.yaml']
    assert out.finished_row('a', other)['failed'] == 'no frame'
    assert out.finished_row('a', key) is None  # what failed is simply tried again
    touch(out.folder('a') / 'arm.json', '[')
    with refused(RecordingError, 'damaged'):
        out.finished_row('a', key)


def test_a_folder_of_other_things_is_refused(tmp_path):
    touch(tmp_path / 'thesis.tex')
    with refused(RecordingError, 'holds_other_files'):
        SurveyFolder(path=tmp_path, overwrite=True).check(PAGES)


def work(arm: FleetArm) -> dict[str, bytes]:
    """Do what the name says: die, each time or the first time, fail, or be done."""
    (marker,) = arm.roles['unloaded']
    kind = arm.name.rsplit('_', 1)[-1]
    if kind == 'fails':
        raise RecordingError('no frame is left')
    if kind == 'dies' or (kind == 'once' and not marker.exists()):
        marker.write_text('')
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return {'pid': str(os.getpid()).encode()}


def fleet_of(folder: Path, *kinds: str) -> list[FleetArm]:
    return [
        FleetArm(
            name=f'{place}_{kind}',
            arm=DEFAULT,
            roles={'unloaded': (folder / str(place),), 'loaded': (), 'heldout': ()},
        )
        for place, kind in enumerate(kinds)
    ]


def test_a_process_that_dies_is_a_row_and_not_the_end(tmp_path):
    arms = fleet_of(tmp_path, 'done', 'dies', 'fails', 'once', 'done')
    opened = []

    @contextmanager
    def two_workers() -> Iterator[Executor]:
        with open_executor(workers=2) as executor:
            opened.append(executor)
            yield executor

    outcomes = {arm.name: outcome for arm, outcome in work_on_fleet(arms, work, two_workers, 2)}
    assert sorted(outcomes) == [arm.name for arm in arms]
    assert 'pid' in outcomes['0_done']
    assert 'pid' in outcomes['4_done']
    assert 'pid' in outcomes['3_once']
    assert 'died' in sentence_of(outcomes['1_dies'])
    assert sentence_of(outcomes['2_fails']) == 'no frame is left'
    assert len(opened) > 1


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_costs_nothing_but_time(tmp_path):
    distributed = pytest.importorskip('distributed')
    arms = fleet_of(tmp_path, *('done', 'once', 'fails') * 3)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host='127.0.0.1'
    ) as local:
        outcomes = {
            arm.name: outcome
            for arm, outcome in work_on_fleet(
                arms, work, lambda: open_executor(scheduler=local.scheduler_address), len(arms)
            )
        }
    assert len(outcomes) == 9
    assert sum(isinstance(item, RecordingError) for item in outcomes.values()) == 3
    assert sum(isinstance(item, dict) for item in outcomes.values()) == 6


def test_an_error_of_another_kind_says_its_kind():
    assert sentence_of(ValueError('a\nb')) == 'ValueError: a b'

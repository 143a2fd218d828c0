"""Every command on every page is run as it stands there, and prints what stands below it.

`pytest test/package/test_page_commands.py -m '' --rewrite` puts what was printed into the pages.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import re
import shutil

import pytest
from support.cantilever import Cantilever
from support.films import pictures, write_camera_info, write_folder, write_video
from support.page_commands import (
    agree,
    blocks_of,
    folder_after,
    PAGES,
    rewrite,
    ROOT,
    run_block,
    started_node,
)

# What no package index has, what needs a display, and arms of the reader's own; everything else
# can be run, and is.
NOT_TO_BE_HAD = (
    'pneunet survey fleet/',
    'ros2 ',
    'git clone ',
    'docker ',
    'pip install rerun-sdk',
    "pip install 'pneunet_ros[mujoco]'",
    'python examples/look_in_rerun.py',
)
BLOCKS = {page: blocks_of(page) for page in PAGES}


def given_for_calibration(folder):
    """Write a static bench of clamp and tip, and a strip under weights, with model files."""
    paper = (ROOT / 'config/paper_arm.yaml').read_text(encoding='utf-8')
    two = re.sub(
        r'target_arclength:\n(.*\[.*\n)?( +[-\d\[].*\n)+',
        'target_arclength: [0.0, 0.135]\n',
        paper,
    )
    two = two.replace('length: 0.112 ', 'length: 0.135 ')
    (folder / 'bench_arm.yaml').write_text(two, encoding='utf-8')
    (folder / 'beam.yaml').write_text(two, encoding='utf-8')
    columns = 'x0_mm,y0_mm,x1_mm,y1_mm'
    rows = [f'pressure_kpa,{columns}']
    for pressure in range(0, 45, 5):
        arc = Cantilever(length=0.135, stiffness=0.02, curvature=0.25 * pressure)
        x, y, _ = 1000 * arc.shape((0.0, 0.0))[:, 0]
        rows.append(f'{pressure},0,0,{x},{y}')
    (folder / 'bench.csv').write_text('\n'.join(rows), encoding='utf-8')
    rows = [f'time_s,force_y_n,{columns}']
    strip = Cantilever(length=0.135, stiffness=0.02, curvature=0.4)
    for index, weight in enumerate((0.1, 0.3, 0.6, 1.0, 1.5)):
        x, y, _ = 1000 * strip.shape((0.0, -weight))[:, 0]
        rows.append(f'{index + 1},{-weight},0,0,{x},{y}')
    (folder / 'weights.csv').write_text('\n'.join(rows), encoding='utf-8')


def given_for_recordings(folder):
    """Write a table of several arms."""
    rows = ['actuator,pressure_as_recorded,tip_dx_mm,tip_dy_mm']
    rows += [
        f'DS10-DS10-0-{arm},{100 * row},{-row},{7 * row}' for arm in (1, 2) for row in range(6)
    ]
    (folder / 'modular_stiffness.csv').write_text('\n'.join(rows), encoding='utf-8')


def given_for_track(folder):
    """Write a film, its frames, and the lens."""
    shown = pictures()
    write_video(folder / 'film.mp4', shown)
    write_folder(folder / 'frames', shown)
    write_camera_info(folder / 'camera_info.yaml')


# Files that the reader of a page has, and a clone has not.
GIVEN: dict[str, Callable[[Path], None]] = {
    'calibration': given_for_calibration,
    'recordings': given_for_recordings,
    'track': given_for_track,
}


def written_by(command):
    """Names of the files that a command writes."""
    return set(re.findall(r'--(?:output|preview|table) (\S+)', command))


def not_yet_run(blocks, known):
    """Yield blocks without the commands that ran before and whose files no later one reads.

    known: commands that ran; those of these blocks are added.
    """
    for place, block in enumerate(blocks):
        commands = [started_node(line) or line for line in block.commands]
        alone = all(line.startswith('pneunet') and not line.endswith('&') for line in commands)
        if block.kind != 'sh' or not alone:
            yield block
            continue
        later = [line for other in blocks[place + 1 :] for line in other.commands]
        new = []
        for index, command in enumerate(commands, 1):
            others = [set(line.split()) - written_by(line) for line in commands[index:] + later]
            if command not in known or written_by(command) & set().union(*others):
                new.append(command)
            known.add(command)
        if new:
            yield replace(block, content='\n'.join(new) + '\n')


def sessions():
    """One test a page: its blocks go on from one another. What takes long is in a second one.

    A command that stands on several pages runs with the first of them.
    """
    known = set()
    for page, blocks in BLOCKS.items():
        name = page.relative_to(ROOT).as_posix()
        to_run = [block for block in blocks if block.is_run]
        quick = [block for block in to_run if not block.remark.startswith('slow')]
        is_all = quick == to_run
        quick = list(not_yet_run(quick, known))
        starts_nodes = any(started_node(line) for block in to_run for line in block.commands)
        marks = [pytest.mark.ros] if starts_nodes else []
        if quick:
            yield pytest.param(page, quick, id=name, marks=marks)
        if not is_all:
            yield pytest.param(page, to_run, id=f'{name}, slow', marks=[*marks, pytest.mark.slow])


@pytest.mark.parametrize(('page', 'blocks'), list(sessions()))
def test_a_page_runs_as_it_stands(page, blocks, tmp_path, request):
    folder = clone(tmp_path)
    GIVEN.get(page.stem, lambda folder: None)(folder)
    for block in blocks:
        for before, shown, printed in run_block(block, folder):
            if agree(shown, printed):
                continue
            if request.config.getoption('rewrite', False):
                rewrite(page, before, shown, printed)
            else:
                assert shown == printed, f'{block.page}:{block.line}'
        folder = folder_after(block, folder)


def clone(folder: Path) -> Path:
    """Return a folder with all that a fresh clone has; recordings may be made anew in it."""
    shutil.copytree(ROOT / 'bags', folder / 'bags')
    for name in (
        'Makefile',
        'config',
        'docs',
        'examples',
        'pneunet_ros',
        'scenarios',
        'setup.py',
        'test',
    ):
        (folder / name).symlink_to(ROOT / name)
    return folder


def not_run():
    return [block for blocks in BLOCKS.values() for block in blocks if block.reason_not_run]


@pytest.mark.parametrize('block', not_run(), ids=lambda block: f'{block.page}:{block.line}')
def test_only_what_is_not_to_be_had_is_not_run(block):
    assert block.commands
    for command in block.commands:
        assert command.startswith(NOT_TO_BE_HAD), command


@pytest.mark.parametrize(
    'block',
    [block for blocks in BLOCKS.values() for block in blocks if block.whole],
    ids=lambda block: f'{block.page}:{block.line}',
)
def test_an_extract_stands_in_its_file(block):
    """Parts are joined by a line of three dots; a block of the pages on extending is a change."""
    whole = (ROOT / block.whole).read_text(encoding='utf-8')
    for part in re.split(r'\n *# \.\.\.\n', block.content.strip('\n')):
        assert part.strip('\n') in whole

"""Make the pictures of the gallery that the commands draw themselves, with fewer colors.

python docs/images/make_gallery.py [NAME ...]     # by default all of PICTURES
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import sys
import tempfile
from types import SimpleNamespace
from typing import Any

import matplotlib

matplotlib.use('Agg')
from matplotlib import pyplot as plt
import numpy as np
from PIL import Image
from pneunet_ros import Fusion, FusionState, load_model, PressureReading
from pneunet_ros.cli.main import main as pneunet
from pneunet_ros.files.scenario_file import load_lab
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.lab.live import LiveLab, Load
from pneunet_ros.messages.estimate import OUTPUTS
from pneunet_ros.messages.fusion import FUSION_OUTPUTS
from pneunet_ros.messages.readings import END_WRENCH, PRESSURE, TARGETS
from pneunet_ros.messages.tracker import TRACKER_INPUTS, TRACKER_OUTPUTS
from pneunet_ros.recordings.dataset_reader import read_run

FOLDER = Path(__file__).resolve().parent
BAGS = FOLDER.parents[1] / 'bags/lab_day'
ARM, SCENARIOS = FOLDER.parents[1] / 'config/lab_arm.yaml', FOLDER.parents[1] / 'scenarios'
COLORS, WIDTH = 128, 1000  # px


def keep(drawn: Path, name: str) -> None:
    """Keep a picture, no wider than WIDTH."""
    with Image.open(drawn) as picture:
        picture.thumbnail((WIDTH, 10 * WIDTH))
        palette = picture.convert('RGB').quantize(COLORS, dither=Image.Dither.NONE)
    palette.save(FOLDER / f'{name}.png', optimize=True)


def run(*words: object) -> None:
    """Run a command; the answer may be negative."""
    if pneunet([str(word) for word in words]) > 1:
        raise SystemExit(f'pneunet {words[0]} failed')


def lab_day(scratch: Path) -> None:
    """Draw shapes of the lab day, measured and fitted; then estimates against the truth."""
    model = scratch / 'model.yaml'
    run(
        *('calibrate', '--unloaded', BAGS / 'unloaded.mcap', '--loaded', BAGS / 'loaded.mcap'),
        *('--no-compare', '--output', model, '--report', scratch / 'report'),
    )
    keep(next((scratch / 'report').glob('figure_06*.png')), 'gallery_calibrate')
    run('replay', BAGS / 'heldout.mcap', '--model', model, '--output', scratch / 'replayed.mcap')
    picture = scratch / 'errors.png'
    run('compare', scratch / 'replayed.mcap', BAGS / 'heldout.truth.npz', '--plot', picture)
    keep(picture, 'gallery_compare')


def explore(scratch: Path) -> None:
    """Draw the model error of an exploration round by round, and what is still possible."""
    hidden = ('--effect', 'load_offset.offset=0.004')
    run('explore', '--simulated', 'random_mix', *hidden, '--output', scratch / 'found')
    (drawn,) = (scratch / 'found').glob('figure_*.png')
    keep(drawn, 'gallery_explore')


def motion(scratch: Path) -> None:
    """Draw the tip after steps of pressure: true, and predicted with and without motion."""
    recording = scratch / 'ringing.mcap'
    run('simulate', SCENARIOS / 'ringing.yaml', '--output', recording)
    moving = scratch / 'moving.yaml'
    moving.write_text(ARM.read_text() + 'motion: {damping_time: 0.03}\n')
    figure, axes = plt.subplots(figsize=(8.6, 3.0), dpi=110)
    with np.load(recording.with_name('ringing.truth.npz')) as truth:
        begin, end, y = truth['stamp_ns'][0], truth['stamp_ns'][-1], truth['y'][:, -1]
        axes.plot(1e-9 * (truth['stamp_ns'] - begin), 1e3 * y, color='0.2', lw=3.0, label='true')
    for model, label, color in (
        (ARM, 'predicted at rest', 'tab:orange'),
        (moving, 'predicted with motion', 'tab:blue'),
    ):
        output = scratch / f'{model.stem}.mcap'
        run('replay', recording, '--model', model, '--no-wrench-required', '--output', output)
        run('export', output, '--output', output.with_suffix('.npz'))
        with np.load(output.with_suffix('.npz')) as table:
            tip = table['estimate_tip_y_m']
            when = 1e-9 * (table['stamp_ns'][np.isfinite(tip)] - begin)
        axes.plot(when, 1e3 * tip[np.isfinite(tip)], color=color, lw=1.2, label=label)
    axes.set(xlim=(0.0, 1e-9 * float(end - begin)), ylim=(-60.0, 95.0))
    axes.set(xlabel='time, s', ylabel='tip y, mm')
    axes.legend(frameon=False, fontsize=8, ncols=3, loc='lower right')
    axes.spines[['top', 'right']].set_visible(False)
    figure.tight_layout()
    figure.savefig(scratch / 'motion.png')
    keep(scratch / 'motion.png', 'gallery_motion')


def control(scratch: Path) -> None:
    """Draw the controller of examples/ on the virtual arm, with a soft wall in the way."""
    sys.path[:0] = [str(FOLDER.parents[1] / name) for name in ('acceptance', 'examples')]
    from rigs import sightings_of
    from soft_wall import FOLLOWS
    from tip_controller import TipController

    lab = LiveLab(scenario=load_lab(SCENARIOS / 'lab_arm.yaml'))
    fusion, known, random = Fusion(arm=load_model(ARM)), FusionState(), np.random.default_rng(1)
    driver = TipController(path=[(0.1038, 0.0363), (0.0896, 0.0572), (0.0462, 0.0812)])
    along, state, push, rows = np.array([np.cos(-0.82), np.sin(-0.82)]), lab.begin(), 0.0, []
    for count in range(1, 1500):
        now = 0.01 * count
        load = Load(force_x=push * along[0], force_y=push * along[1]) if push > 1e-6 else Load()
        state, shape = lab.shape(lab.step(state, now, driver.command, load))
        tip = np.array([part[0, -1] for part in shape.points(np.array([0.112]))[:2]])
        depth = max(0.0, float((np.array([0.0896, 0.0572]) - tip) @ along))
        push += FOLLOWS * (2.0 * depth - push)
        stamp = round(1e9 * now)
        if count % 10 == 0:
            x, y = lab.tracked_points(shape, random).T
            known, _ = fusion.step(known, sightings_of(stamp, x, y))
        pressure = lab.reading(state, random).pressure
        known, told = fusion.step(known, PressureReading(stamp_ns=stamp, pressure=pressure))
        known = fusion.settle(known)
        if isinstance(told, FusedEstimate):
            x, y = told.estimate.jacobian[:2].tolist()
            place = told.estimate.shape.tip[:2]
            driver.take_state(place, (x[0], y[0]), ((x[1], x[2]), (y[1], y[2])), now)
            driver.take_force(*told.force.tolist(), now)
        driver.step(now)
        rows.append((now, *tip, push, driver.resistance))
    time, x, y, pushed, felt = np.array(rows).T
    figure, (place, force) = plt.subplots(1, 2, figsize=(8.6, 3.0), dpi=110)
    place.plot(1e3 * x, 1e3 * y, color='tab:blue', label='tip')
    place.plot(*1e3 * np.array(driver.path).T, 'o', color='tab:orange', label='targets')
    ends = np.array([0.0896, 0.0572]) + np.outer([-0.02, 0.02], [-along[1], along[0]])
    place.plot(*1e3 * ends.T, color='0.6', lw=3, label='soft wall')
    place.set(xlabel='x, mm', ylabel='y, mm')
    force.plot(time, 1e3 * pushed, color='0.2', lw=3, label='true')
    force.plot(time, 1e3 * felt, color='tab:blue', lw=1, label='estimated')
    force.axhline(1e3 * driver.press, color='tab:orange', ls='--', label='wanted')
    force.set(xlabel='time, s', ylabel='force on the wall, mN')
    for axes in (place, force):
        axes.legend(frameon=False, fontsize=8)
        axes.spines[['top', 'right']].set_visible(False)
    figure.tight_layout()
    figure.savefig(scratch / 'control.png')
    keep(scratch / 'control.png', 'gallery_control')


def survey(scratch: Path) -> None:
    """Draw the numbers of 27 real actuators side by side."""
    sys.path.insert(0, str(FOLDER.parents[1] / 'acceptance'))
    from real_data_fit import DATA, read_actuators
    from survey_real_data import write_fleet

    write_fleet(read_actuators(DATA), scratch / 'fleet', 0.3)
    run('survey', scratch / 'fleet', '--static', '--output', scratch / 'out')
    keep(next((scratch / 'out').glob('figure_01*.png')), 'gallery_survey')


def launch(scratch: Path) -> None:
    """Draw the nodes of the demo launch with their topics, by the tables of the messages."""
    boxes = {
        'virtual_arm\n(or your arm)': (0.08, 0.5),
        'tracker': (0.34, 0.86),
        'estimator': (0.53, 0.5),
        'fusion': (0.53, 0.08),
        'controller,\ndisplays': (0.93, 0.5),
    }
    arm, tracker, estimator, fusion, user = boxes
    images = [item.name for item in TRACKER_INPUTS if 'compressed' not in item.name]
    edges = [
        (arm, tracker, images),
        (arm, estimator, [PRESSURE.name, END_WRENCH.name]),
        (arm, fusion, [PRESSURE.name, END_WRENCH.name]),
        (tracker, estimator, [TARGETS.name]),
        (tracker, fusion, []),
        (tracker, user, [item.name for item in TRACKER_OUTPUTS[1:]]),
        (estimator, user, [item.name for item in OUTPUTS]),
        (fusion, user, [item.name for item in FUSION_OUTPUTS]),
    ]
    figure, axes = plt.subplots(figsize=(9.6, 5.2), dpi=110)
    axes.set(xlim=(0.0, 1.0), ylim=(-0.05, 1.0))
    axes.set_axis_off()
    arrow = {'arrowstyle': '->', 'color': '0.55', 'shrinkA': 34, 'shrinkB': 34}
    for begin, end, topics in edges:
        (x, y), (to_x, to_y) = boxes[begin], boxes[end]
        axes.annotate('', (to_x, to_y), (x, y), arrowprops=arrow)
        lines = '\n'.join(', '.join(topics[at : at + 2]) for at in range(0, len(topics), 2))
        middle = 0.5 * (x + to_x), 0.5 * (y + to_y)
        white = {'facecolor': 'white', 'edgecolor': 'none', 'pad': 1.5}
        axes.text(*middle, lines, fontsize=7.5, ha='center', va='center', bbox=white)
    for name, place in boxes.items():
        box = {'boxstyle': 'round,pad=0.5', 'facecolor': '#dce9f5', 'edgecolor': '#1f5a96'}
        axes.text(*place, name, ha='center', va='center', bbox=box)
    figure.tight_layout()
    figure.savefig(scratch / 'launch.png')
    keep(scratch / 'launch.png', 'gallery_launch')


def extending(scratch: Path) -> None:
    """Draw the report figure that the page on extending adds, of the lab day."""
    page = (FOLDER.parent / 'extending.md').read_text(encoding='utf-8')
    (code,) = re.findall(r'```python\n(# \S+/pressure_figures.py\n.*?)```', page, re.DOTALL)
    names: dict[str, Any] = {}
    exec(code, names)  # the page is ours, and its test runs it as well
    run_of_day, _ = read_run(BAGS / 'loaded.mcap', load_model(ARM).target_arclength.size)
    drawn = names['pressures'](SimpleNamespace(loaded=[SimpleNamespace(run=run_of_day)]))
    (scratch / drawn.file).write_bytes(drawn.png)
    keep(scratch / drawn.file, 'gallery_extending')


PICTURES: dict[str, Callable[[Path], None]] = {
    'lab_day': lab_day,
    'explore': explore,
    'motion': motion,
    'control': control,
    'survey': survey,
    'launch': launch,
    'extending': extending,
}


def main() -> None:
    """Make those that are named, or all."""
    for name in sys.argv[1:] or PICTURES:
        with tempfile.TemporaryDirectory() as scratch:
            PICTURES[name](Path(scratch))


if __name__ == '__main__':
    main()

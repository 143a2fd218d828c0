"""Make films and tables of docs/my_finger.md, as a camera and a logger would, and its pictures.

python docs/images/make_my_finger.py FOLDER               films and tables alone, for the page
python docs/images/make_my_finger.py FOLDER --pictures    then pictures, of what the page's
                                                          commands wrote in the same folder

The finger is that of the virtual lab, `scenarios/lab_arm.yaml` with twelve dots. The camera runs
first by some seconds; nobody knows how many. A weight on a string pulls the tip along the arm.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
import sys
from typing import ClassVar

import cv2
from matplotlib.figure import Figure
import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.core.share import share_path
from pneunet_ros.core.units import kilopascals
from pneunet_ros.files.scenario_file import load_lab
from pneunet_ros.lab.protocols import newtons, Protocol
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.lab.timeline import Leg, Timeline, timeline
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.reports.target_template import template_page

# The films are made as those of the tests.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'test'))
from support.finger_film import Bench, write_film, write_table

PICTURES = Path(__file__).resolve().parent
TARGETS = np.arange(12) * 0.01  # m
LEVELS = (10e3, 30e3, 20e3, 50e3, 40e3, 60e3, 25e3, 45e3, 15e3, 55e3, 35e3, 5e3, 0.0)  # Pa
HOLDS = (1.2, 2.0, 0.9, 1.6, 1.1, 2.2, 1.3, 0.8, 1.7, 1.0, 1.9, 1.4, 1.5)  # s
QUICK = 0.25  # s, from hold to hold
REST = 2.0  # s


@dataclass(frozen=True, slots=True, kw_only=True)
class QuickSteps(Protocol):
    """Quick steps at no regular times, a weight on the string from the beginning to the end."""

    kind: ClassVar[str] = 'quick_steps'
    pull: float = newtons(0.0, 'of the string, along the arm')

    def timeline(self) -> Timeline:
        """Return the steps."""
        force = (self.pull, 0.0)
        legs = [Leg(REST, 0.0, force)]
        for level, hold in zip(LEVELS, HOLDS, strict=True):
            legs += [Leg(QUICK, level, force), Leg(hold, level, force)]
        return timeline(legs, loaded=self.pull > 0.0, start=Leg(0.0, 0.0, force))


@dataclass(frozen=True, slots=True, kw_only=True)
class Filmed:
    """A film and its table: name, weight on the string (N), how long the camera ran before (s)."""

    name: str
    pull: float
    camera_first: float
    hidden: tuple[int, ...] = ()


FILMS = (
    Filmed(name='free', pull=0.0, camera_first=1.37),
    Filmed(name='pull_100mN', pull=0.1, camera_first=0.52),
    Filmed(name='pull_200mN', pull=0.2, camera_first=-0.81),
    Filmed(name='test', pull=0.15, camera_first=0.9),
)
LOST = Filmed(name='lost', pull=0.15, camera_first=0.9, hidden=(4, 7))
SHOWN = (30, 75, 128, 150, 200)  # frames of the test film, whose shapes are drawn
WIDTH = 1100  # px of a picture


def make_films(folder: Path, films: tuple[Filmed, ...]) -> dict[str, float]:
    """Write films and tables; returns the true delays (s) by name."""
    folder.mkdir(parents=True, exist_ok=True)
    lab = replace(load_lab(share_path('scenarios/lab_arm.yaml')).arm, targets=TARGETS)
    delays = {}
    for number, film in enumerate(films):
        scenario = Scenario(
            name=film.name,
            arm=lab,
            protocol=QuickSteps(pull=film.pull),
            rates=Rates(pressure=100.0, wrench=100.0, frames=12.0),
            seed=number,
            start=600.0 * (1 + number),
        )
        recording = simulate(scenario)
        bench = Bench(camera_first=film.camera_first, hidden=film.hidden, seed=number)
        delays[film.name] = write_film(recording, folder / f'{film.name}.mp4', bench)
        write_table(recording, folder / f'{film.name}.csv', bench, forces=False)
    return delays


def sheet_picture(folder: Path) -> Figure:
    """Draw the sheet of dots as `new-arm` makes it."""
    arm = load_model(folder / 'finger.yaml')
    return template_page('A4', arm.name, arm.target_arclength, 0.003)


def delay_picture(folder: Path) -> Figure:
    """Draw pressure and motion of the tip, each on its own clock and then on one."""
    lines = (folder / 'free.csv').read_text(encoding='utf-8').splitlines()[1:]
    table = np.array([line.replace(',', '.').split(';') for line in lines], float)
    run, _ = read_run(folder / 'free.mcap', TARGETS.size)
    start = run.reading_stamp_ns[0]
    seconds = (run.stamp_ns - start) * 1e-9
    figure = Figure(figsize=(9.2, 4.6), layout='constrained')
    panels = figure.subplots(2, 1, sharex=True)
    for axes, shift, title in (
        (panels[0], FILMS[0].camera_first, 'each on its own clock'),
        (panels[1], 0.0, 'on the clock of the table, as track found it'),
    ):
        axes.plot(table[:, 0], table[:, 1], color='#1f5a96', label='pressure (kPa)')
        axes.plot(
            seconds + shift,
            1e3 * run.y[:, -1],
            '.',
            color='#d1603d',
            markersize=3,
            label='height of the tip (mm)',
        )
        axes.set(title=title, xlim=(0.0, 12.0))
    panels[1].set_xlabel('time (s)')
    panels[0].legend(loc='lower right', fontsize=8)
    return figure


def model_picture(folder: Path) -> Figure:
    """Draw measured targets of a film that calibration has not seen, and what the model says."""
    arm = load_model(folder / 'model.yaml')
    run, _ = read_run(folder / 'test.mcap', TARGETS.size)
    figure = Figure(figsize=(8.0, 2.8), layout='constrained')
    axes = figure.subplots()
    for frame in SHOWN:
        pressure, (force_x, force_y) = float(run.frame_pressure[frame]), run.force[frame].tolist()
        shape = solve(arm, pressure, force=(force_x, force_y))
        (line,) = axes.plot(1e3 * shape.x, 1e3 * shape.y, label=f'{kilopascals(pressure):.0f} kPa')
        axes.plot(1e3 * run.x[frame], 1e3 * run.y[frame], 'o', color=line.get_color(), ms=3.5)
    axes.set(
        xlabel='x (mm)', ylabel='y (mm)', title='0.15 N along the arm: lines predicted, dots seen'
    )
    axes.set_aspect('equal')
    axes.legend(fontsize=8)
    return figure


def make_pictures(folder: Path) -> None:
    """Draw all pictures of the page."""
    for name, figure in (
        ('sheet', sheet_picture(folder)),
        ('delay', delay_picture(folder)),
        ('model', model_picture(folder)),
    ):
        figure.savefig(PICTURES / f'my_finger_{name}.png', dpi=100, metadata={'Software': None})
    preview = cv2.imread(str(folder / 'free.png'))
    height = round(preview.shape[0] * WIDTH / preview.shape[1])
    small = cv2.resize(preview, (WIDTH, height), interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(PICTURES / 'my_finger_film.png'), small, [cv2.IMWRITE_PNG_COMPRESSION, 9])


def main() -> None:
    """Make what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--pictures', action='store_true')
    arguments = parser.parse_args()
    if arguments.pictures:
        make_pictures(arguments.folder)
        return
    for name, delay in make_films(arguments.folder, (*FILMS, LOST)).items():
        print(f'{name}: the film is {delay:.4f} s ahead of its table')


if __name__ == '__main__':
    main()

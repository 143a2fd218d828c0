"""Make films and tables of docs/my_finger.md, as a camera and a logger would, and its pictures.

python docs/images/make_my_finger.py FOLDER               films and tables alone, for the page
python docs/images/make_my_finger.py FOLDER --pictures    then pictures, of what the page's
                                                          commands wrote in the same folder

The finger is that of the virtual lab, `scenarios/lab_arm.yaml` with twelve dots. The camera runs
first by some seconds; nobody knows how many. A weight on a string pulls the tip along the arm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from finger_film import Bench, write_film, write_table
import numpy as np
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_lab
from pneunet_ros.lab.protocols import newtons, Protocol
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.lab.timeline import Leg, Timeline, timeline

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
LOST = Filmed(name='lost', pull=0.0, camera_first=1.37, hidden=(4, 11))


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

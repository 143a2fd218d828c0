"""Prediction errors of `calibrate` at left-out pressures, on public data of real soft arms.

    python acceptance/real_sets.py FOLDER [--json] [--noise PERCENT]

FOLDER holds tables that are not part of this project; those that are not there are passed by:

- `modular_stiffness.csv`: 27 actuators (`acceptance/real_data.py`);
- `vertAutoTest.csv`, `noGsTest.csv` and `1D Pressure vs Pos.csv` (the sheet of that name, saved
  as CSV): one chamber of a hanging arm, its tip by an electromagnetic tracker, at 21 to 35
  pressures, of the repository christopher-gonzalez-millan/Medtronic-Soft-Robotics-, folder
  `Data_Storage/Pressure vs Position Curves`;
- `New_Step_dataset_0_60_10.csv` and others of `ANGLES`: pressure and the angle of the tip of a
  pneu-net at 20 Hz, of the repository Jonasjcmh/PneuNet_Controller, folder `Dataset`. The unit of
  the pressure is not stated; kPa is inferred.

The tracker's frame is turned anyhow: the tip counts from where it was first, in the plane of its
motion, across the arm in the direction in which it began to move, and along it towards the base.
Errors are rms of the tip in % of the length, of an angle in degrees, beside a constant curvature
interpolated over pressure and plain interpolation.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
import json
import math
from pathlib import Path

from left_out_real import AS_WELL, count_sentence, fitted_row, measured
import numpy as np
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.units import SI_PER_UNIT
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.starting_arm import starting_arm
from real_data_diagnosis import NOISE
from real_data_fit import Actuator, LENGTH, read_actuators
from rich.console import Console
from rich.progress import track

MODULAR = 'modular_stiffness.csv'
PSI = SI_PER_UNIT['pressure']['psi']


@dataclass(frozen=True, slots=True, kw_only=True)
class RealSet:
    """A table of pressures (psi) and places (mm) by the names of its columns.

    length (m): inferred of the arc that the tip describes.
    """

    file: str
    pressure: str
    place: tuple[str, ...]
    length: float = 0.16


TRACKED = ('X Position', 'Y Position', 'Z Position')
SETS = (
    RealSet(file='vertAutoTest.csv', pressure='Actual PSI', place=TRACKED),
    RealSet(file='noGsTest.csv', pressure='Actual PSI', place=TRACKED),
    RealSet(
        file='1D Pressure vs Pos.csv', pressure='Sensor Pressure (psi)', place=('x (mm)', 'y (mm)')
    ),
)


ANGLES = (
    'New_Step_dataset_0_60_10.csv',
    'New_Step_dataset_0_60_11.csv',
    'New_Step_dataset_0_60_13.csv',
    'New_Ramp_dataset_10_17.csv',
)


def read_angles(path: Path) -> RecordingData:
    """Return a table of time (s), angle (degrees) and pressure (kPa) as a recording."""
    with path.open(newline=None, encoding='utf-8-sig') as lines:
        rows = list(csv.DictReader(lines, delimiter=';'))
    time, angle, pressure = (
        np.array([float(row[name]) for row in rows]) for name in ('time', 'angle', 'pressure')
    )
    stamps = (1e9 * (1.0 + time)).astype(np.int64)
    nothing = np.full((time.size, 2), np.nan)
    return RecordingData(
        name=path.stem,
        reading_stamp_ns=stamps,
        pressure=1e3 * pressure,
        stamp_ns=stamps,
        reading=np.arange(time.size),
        loaded=False,
        force=np.zeros((time.size, 2)),
        moment=np.zeros(time.size),
        x=nothing,
        y=nothing,
        tip_pose=np.column_stack([nothing, np.radians(angle)]),
    )


def measured_angles(runs: list[RecordingData]) -> list[dict]:
    """Return a row per recording of angles; errors are rms, degrees."""
    rows = []
    for run in runs:
        # Of an angle alone neither length nor weight matters.
        arm = starting_arm(
            name=run.name,
            length=LENGTH,
            weight=0.3,
            largest_pressure=float(run.pressure.max()),
            places=np.array([0.0, 0.5 * LENGTH]),
        )
        row = fitted_row(run, arm, math.degrees(1.0))
        rows.append({'actuator': run.name, 'pressures': 0, 'unit': 'degrees'} | row)
    return rows


def read_set(path: Path, real: RealSet) -> Actuator:
    """Return a set as an actuator of the length that all fits here have, tips by that scale."""
    with path.open(newline='', encoding='utf-8-sig') as lines:
        rows = list(csv.DictReader(lines))
    pressure = PSI * np.array([float(row[real.pressure]) for row in rows])
    place = 1e-3 * np.array([[float(row[name]) for name in real.place] for row in rows])
    levels, which = np.unique(pressure, return_inverse=True)
    place = np.stack([place[which == level].mean(axis=0) for level in range(levels.size)])
    return Actuator(
        name=path.stem,
        pressure=levels - levels[0],
        tip=in_plane(place) * LENGTH / real.length + [LENGTH, 0.0],
    )


def in_plane(place: np.ndarray) -> np.ndarray:
    """Return displacements (n, 2) along the arm and across it, from places (n, 2 or 3)."""
    moved = place - place[0]
    _, _, axes = np.linalg.svd(moved - moved.mean(axis=0), full_matrices=False)
    across, along = moved @ axes[0], moved @ axes[1]
    # A straight arm begins to move across itself: there the path has no slope.
    _, slope, _ = np.polyfit(across, along, 2)
    turn = np.exp(-1j * np.arctan(slope))
    path = (across + 1j * along) * turn
    across, along = path.real, path.imag
    return np.column_stack([-along * np.sign(along[-1]), across * np.sign(across[-1])])


def actuators_in(folder: Path) -> list[Actuator]:
    """Return all sets that the folder holds."""
    found = [read_set(folder / one.file, one) for one in SETS if (folder / one.file).exists()]
    if (folder / MODULAR).exists():
        found += read_actuators(folder / MODULAR)
    return found


def main() -> int:
    """Run and print; exit code 1 where an answer is missing, and 0 where there is no data."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('folder', type=Path, help='folder of the tables')
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument(
        '--noise', type=float, default=NOISE, help='noise of a tip, %% of the length'
    )
    arguments = command.parse_args()
    try:
        actuators = actuators_in(arguments.folder)
        paths = [arguments.folder / name for name in ANGLES]
        angles = [read_angles(path) for path in paths if path.exists()]
    except (PneunetError, OSError, KeyError, ValueError) as error:
        command.exit(2, f'{error}\n')
    shown = track(actuators, 'fitting', console=Console(stderr=True), transient=True)
    rows = measured(shown, arguments.noise, diagnosed=False) + measured_angles(angles)
    if arguments.json:
        print(json.dumps({'bench': 'real_sets', 'as_well': AS_WELL, 'rows': rows}))
    else:
        print('| set | pressures | model | constant curvature | interpolation | says |')
        print('|---|---|---|---|---|---|')
        for row in rows:
            numbers = [row.get(name, math.nan) for name in ('model', 'arc', 'interpolation')]
            shown = [f'{number:.2f}' for number in numbers]
            cells = [row['actuator'], str(row['pressures']), *shown, row.get('says') or '-']
            print(f'| {" | ".join(cells)} |')
        print(count_sentence(rows))
    return int(not all(row['answered'] for row in rows))


if __name__ == '__main__':
    raise SystemExit(main())

"""False alarms and detection rate of outliers by `pneunet survey`, in simulated fleets.

    python acceptance/outlier_arms.py [--fleets N] [--arms N ...] [--json]

Fleets are drawn: four numbers that go together (correlation 0.9), scatter 1, error bars of a
tenth, once and three times the scatter in turn, every other fleet with two numbers missing in a
quarter of its arms. One arm is moved in one number by so many standard deviations of scatter and
error bar together.

Of fleets of alike arms whose numbers do not go together, 30 November 2026, an arm is called odd in
8 of 110 with 16 arms, one number, and error bars as large as the scatter; in 6 of 100 with 16
arms, four numbers, and error bars of 0.4 scatters; in 3 of 60 with 12 to 27 arms and one to four
numbers: more than the 1 % of the simulated fleets, whose scatter is the estimated one. Fleets
whose scatter is as uncertain as a covariance of n - 1 degrees of freedom give 1 to 3 of 110 and 4
of 100, but find an arm that is 7 standard deviations off in one of four numbers in 46 to 48
instead of 54 of 60 fleets.
"""

from __future__ import annotations

import argparse
import json

import numpy as np
from pneunet_ros.calibration.fleet import ArmNumber, ArmNumbers, compare_arms
from rich.console import Console
from rich.progress import track
from rich.table import Table

NUMBERS = tuple(ArmNumber(name=name, meaning=name, unit='-') for name in 'abcd')
CORRELATED = np.linalg.cholesky(0.9 + 0.1 * np.eye(len(NUMBERS)))
ERRORS = (0.1, 1.0, 3.0)  # error bars, in scatters
MOVES = (0.0, 4.0, 6.0, 10.0)
ARMS = (12, 27, 50)
MOVED = 3  # which arm: one that knows all numbers
FLEETS = 60


def fleet(seed: int, arms: int, move: float) -> dict[str, ArmNumbers]:
    """Return the numbers of a fleet."""
    random = np.random.default_rng([seed, arms])
    found = {}
    for which in range(arms):
        std = ERRORS[seed % len(ERRORS)] * random.uniform(0.5, 1.5, len(NUMBERS))
        values = CORRELATED @ random.standard_normal(std.size) + std * random.standard_normal(4)
        if which == MOVED:
            values[1] += move * np.hypot(1.0, std[1])
        known = [0, 2] if seed % 2 and which % 4 == 0 else [0, 1, 2, 3]
        found[str(which)] = ArmNumbers(
            values={NUMBERS[place]: float(values[place]) for place in known},
            covariance=np.diag(std[known] ** 2),
        )
    return found


def tried(arms: int, move: float, fleets: int) -> dict:
    """Return in how many fleets the moved arm is called odd, and another one is."""
    right = wrong = 0
    for seed in range(fleets):
        found = compare_arms(fleet(seed, arms, move), 1.0)
        right += bool(move) and MOVED in found.odd
        wrong += any(place != MOVED or not move for place in found.odd)
    return {'arms': arms, 'moved': move, 'fleets': fleets, 'right': right, 'wrong': wrong}


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--fleets', type=int, default=FLEETS)
    command.add_argument('--arms', type=int, nargs='+', default=ARMS)
    command.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = command.parse_args()
    todo = [(arms, move) for arms in arguments.arms for move in MOVES]
    shown = track(todo, 'drawing', console=Console(stderr=True), transient=True)
    rows = [tried(arms, move, arguments.fleets) for arms, move in shown]
    if arguments.json:
        print(json.dumps({'bench': 'outlier_arms', 'rows': rows}))
        return
    table = Table()
    for head in ('arms', 'moved by', 'fleets', 'moved arm is odd', 'another is odd'):
        table.add_column(head, justify='right')
    for row in rows:
        table.add_row(*(str(row[key]) for key in ('arms', 'moved', 'fleets', 'right', 'wrong')))
    Console(width=100, highlight=False).print(table)


if __name__ == '__main__':
    main()

"""Coverage of model and fusion for arms with few dots, or none at the clamp.

    python acceptance/other_dots.py [--quick] [--json] [--rigs N] [--recordings N] [--first N]
                                    [--keep FOLDER] [--workers N]

A rig is that of `acceptance/fusion.py`, of which only some of the 23 dots are painted: `calibrate`
sees no others, and neither do the recordings that are fused. Where the camera stands, and how
exactly the dots are painted, such recordings can hardly tell. Exit code 1 where a goal is missed.
"""

from __future__ import annotations

import dataclasses
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from fusion import fuse, numbers_of, recording_of, WAYS
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.fusion.fusion import Fusion
from rich.console import Console
from rich.table import Table
from rigs import ANSWERED, missed_goals, model_of, rig_command, run_bench

DOTS = {
    'eight': [0, 3, 6, 9, 13, 16, 19, 22],
    'six': [0, 4, 9, 13, 18, 22],
    'eleven, none at the clamp': list(range(2, 23, 2)),
    'five, none at the clamp': [4, 9, 13, 17, 21],
}
SENSORS = ('no wrench', 'wrench')
GOALS = {
    (f'{dots}, {sensors}', what): (low, 1.0)
    for dots in DOTS
    for sensors in SENSORS
    for what, low in (('tip_covered', 0.93), ('force_covered', 0.93), ('estimates', ANSWERED))
}


def try_dots(seed: int, recordings: int) -> dict[str, Array]:
    """Fuse recordings of a rig that has some of its dots, by a model that saw no others."""
    rows: dict[str, Array] = {}
    whole = [recording_of(seed, which) for which in range(recordings)]
    for name, dots in DOTS.items():
        fusion = Fusion(arm=model_of(seed, dots))
        seen = [dataclasses.replace(one, x=one.x[:, dots], y=one.y[:, dots]) for one in whole]
        for sensors in SENSORS:
            found = [
                fuse(fusion, one, WAYS[sensors], 100 * seed + which)
                for which, one in enumerate(seen)
            ]
            rows[f'{name}, {sensors}'] = np.array(found)
    return rows


def summary_of(rigs: list[dict[str, Array]]) -> dict:
    """Return what each choice of dots came to, and which goals are missed."""
    names = [f'{dots}, {sensors}' for dots in DOTS for sensors in SENSORS]
    ways = {way: numbers_of(np.concatenate([rig[way] for rig in rigs])) for way in names}
    return {'ways': ways, 'missed': missed_goals(ways, GOALS)}


def show(summary: dict, title: str) -> None:
    """Print for people."""
    table = Table(title=title)
    shown = (
        ('dots', '', ''),
        ('tip: rms mm', 'tip_rms', '.3f'),
        ('covered', 'tip_covered', '.3f'),
        ('worst recording', 'worst_tip', '.3f'),
        ('NEES', 'tip_nees', '.2f'),
        ('force: rms where sigma < 5 %', 'sure_rms', '.2%'),
        ('covered', 'force_covered', '.3f'),
        ('worst recording', 'worst_force', '.3f'),
        ('NEES', 'force_nees', '.2f'),
    )
    for heading, _, _ in shown:
        table.add_column(heading)
    for way, numbers in summary['ways'].items():
        cells = [
            format(numbers[name] * (1e3 if name == 'tip_rms' else 1.0), form)
            for _, name, form in shown[1:]
        ]
        table.add_row(way, *cells)
    console = Console(width=150)
    console.print(table)
    console.print('\n'.join(summary['missed'] or ['all goals reached']))


def main() -> int:
    """Run and print."""
    arguments = rig_command(__doc__.splitlines()[0], recordings=4).parse_args()
    return run_bench('other_dots', arguments, try_dots, summary_of, show)


if __name__ == '__main__':
    sys.exit(main())

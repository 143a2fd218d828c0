"""Coverage of the fusion at other rates, with late frames, coarse sensors and a late start.

    python acceptance/fusion_rates.py [--quick] [--json] [--rigs N] [--recordings N] [--first N]
                                      [--keep FOLDER] [--workers N]

A rig is that of `acceptance/fusion.py`, its model the same: it was calibrated at 50 readings and
10 frames a second and by finer sensors. The lab keeps the truth at 50 instants a second; what
sensors and camera give of it is chosen here, and the estimates at all readings of the pressure are
compared with it, between frames too. `swing`: pressure and load go to and fro in 5 and 3 s, and
never rest. Exit code 1 where a goal is missed.
"""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
from dataclasses import dataclass
import math
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from fusion import BEYOND, covered, known, rms, row_of
import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Event, Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.protocols import Corners, Protocol, RandomMix
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from rich.console import Console
from rich.table import Table
from rigs import (
    ANSWERED,
    force_error,
    missed_goals,
    model_of,
    read_sensors,
    rig_command,
    run_bench,
    sightings_of,
    wrench_of,
)

RATE = 50  # Hz, of the truth; all others are parts of it
DURATION = 40.0  # s
SWING_PRESSURE, SWING_FORCE = 5.0, 3.0  # s
COLUMNS = ('tip', 'tip_nees', 'force', 'force_nees')


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """What sensors and camera give.

    pressure, wrench, frames: every how many instants; late (s): how long after its stamp a frame
    comes; pressure_step (Pa), force_step (N): in which readings are rounded; begins (s): before
    which nothing was heard; swing: the motion.
    """

    pressure: int = 1
    wrench: int = 1
    frames: int = 5
    late: float = 0.0
    pressure_step: float = 0.0
    force_step: float = 0.0
    begins: float = 0.0
    swing: bool = False


WAYS = {
    'as calibrated': Way(),
    'frames at 1 Hz': Way(frames=50),
    'frames at 0.2 Hz': Way(frames=250),
    'frames at 50 Hz, readings at 5 Hz': Way(frames=1, pressure=10, wrench=10),
    'pressure at 1 Hz': Way(pressure=50),
    'wrench at 3 Hz': Way(wrench=17),
    'frames 0.2 s late': Way(late=0.2),
    'frames 0.4 s late': Way(late=0.4),
    'frames at 50 Hz, 0.15 s late': Way(frames=1, late=0.15),
    'begins pressed and loaded': Way(begins=15.0),
    'pressure in steps of 0.3 kPa': Way(pressure_step=300.0),
    'force in steps of 5 mN': Way(force_step=5e-3),
    'swing': Way(swing=True),
    'swing, frames 0.2 s late': Way(late=0.2, swing=True),
    'swing, frames 0.4 s late': Way(late=0.4, swing=True),
    'swing, frames at 50 Hz, 0.15 s late': Way(frames=1, late=0.15, swing=True),
}
SENSORS = ('no wrench', 'wrench')
# Frames so late, and no wrench: the force at a reading is then withheld.
WITHHELD = {'frames 0.4 s late', 'swing, frames 0.2 s late', 'swing, frames 0.4 s late'}
GOALS = {
    (f'{name}, {sensors}', what): (low, 1.0)
    for name, way in WAYS.items()
    for sensors in SENSORS
    for what, low in (
        ('tip_covered', 0.93),
        ('force_covered', 0.93),
        # Of the readings that have a frame within `target_timeout`.
        ('estimates', ANSWERED * min(FUSION.target_timeout * RATE / way.frames, 1.0)),
    )
}


def recording_of(seed: int, which: int, *, swing: bool) -> LabRecording:
    """Return one of the recordings of a rig, at all instants."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    protocol: Protocol = RandomMix(duration=DURATION, seed=float(100 * seed + which), top=62e3)
    if swing:
        protocol = swinging(which)
    return simulate(
        dataclasses.replace(
            scenario,
            name=f'rates {which}',
            seed=100 * seed + which,
            arm=vary_arm(scenario.arm, seed),
            protocol=protocol,
            noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
            rates=Rates(pressure=RATE, wrench=RATE, frames=RATE),
        )
    )


def swinging(which: int) -> Corners:
    """Return pressure and load that go to and fro, each recording from another phase."""
    time = np.linspace(0.0, DURATION, int(10 * DURATION) + 1)
    begun = np.clip(0.5 * time, 0.0, 1.0)

    def swing(period: float) -> Array:
        return begun * 0.5 * (1.0 - np.cos(2.0 * math.pi * (time / period + 0.3 * which)))

    return Corners(
        duration=DURATION,
        share=tuple(time / DURATION),
        pressure=tuple(4e3 * begun + 42e3 * swing(SWING_PRESSURE)),
        force_x=tuple(0.25 * swing(SWING_FORCE)),
        force_y=tuple(0.12 * swing(1.3 * SWING_FORCE)),
    )


def events_of(
    recording: LabRecording, way: Way, seed: int, *, wrench: bool
) -> Iterator[tuple[int, Event]]:
    """Yield what is heard, in the order of its coming, with the instant that it is of."""
    read = read_sensors(recording, np.random.default_rng([seed, 17]))
    for columns, step in ((slice(0, 2), way.force_step), (slice(3, 4), way.pressure_step)):
        if step:
            read[:, columns] = step * np.round(read[:, columns] / step)
    late = round(way.late * RATE)
    for instant in range(round(way.begins * RATE), len(recording.stamp_ns)):
        stamp_ns, shown = int(recording.stamp_ns[instant]), instant - late
        if wrench and instant % way.wrench == 0:
            yield instant, wrench_of(stamp_ns, read[instant])
        if shown >= 0 and shown % way.frames == 0:
            places = recording.x[shown], recording.y[shown]
            yield shown, sightings_of(int(recording.stamp_ns[shown]), *places)
        if instant % way.pressure == 0:
            yield instant, PressureReading(stamp_ns=stamp_ns, pressure=float(read[instant, 3]))


def fuse(fusion: Fusion, recording: LabRecording, way: Way, seed: int, *, wrench: bool) -> Array:
    """Fuse what is heard, and compare with the truth: COLUMNS, a row for each pressure reading."""
    truth, state, rows = recording.truth, FusionState(), []
    for instant, event in events_of(recording, way, seed, wrench=wrench):
        state, fused = fusion.step(state, event)
        if not isinstance(event, PressureReading):
            continue
        row = [math.nan] * len(COLUMNS)
        if isinstance(fused, FusedEstimate):
            tip, force = np.array([truth.x[instant, -1], truth.y[instant, -1]]), truth.force
            missed, tip_nees, *_ = row_of(fused, tip, force[instant], 0.0)
            off, force_nees, _ = force_error(fused, force[instant])
            row = [missed, tip_nees, off, force_nees]
        rows.append(row)
    return np.array(rows)


def try_rates(seed: int, recordings: int) -> dict[str, Array]:
    """Fuse recordings of a rig in all ways, by a model of it."""
    fusion, rows = Fusion(arm=model_of(seed)), {}
    whole = {
        swing: [recording_of(seed, which, swing=swing) for which in range(recordings)]
        for swing in (False, True)
    }
    for name, way in WAYS.items():
        for sensors in SENSORS:
            rows[f'{name}, {sensors}'] = np.array(
                [
                    fuse(fusion, one, way, 100 * seed + which, wrench=sensors == 'wrench')
                    for which, one in enumerate(whole[way.swing])
                ]
            )
    return rows


def summary_of(rigs: list[dict[str, Array]]) -> dict:
    """Return what each way came to, and which goals are missed."""
    names = [f'{name}, {sensors}' for name in WAYS for sensors in SENSORS]
    ways = {way: numbers_of(np.concatenate([rig[way] for rig in rigs])) for way in names}
    withheld = {
        (f'{way}, no wrench', 'force_covered')
        for way in WITHHELD
        if not ways[f'{way}, no wrench']['determined']
    }
    goals = {what: limits for what, limits in GOALS.items() if what not in withheld}
    return {'ways': ways, 'missed': missed_goals(ways, goals)}


def numbers_of(rows: Array) -> dict[str, float]:
    """Return the numbers of a way: rows (recordings, readings, COLUMNS)."""
    tip, tip_nees, force, force_nees = np.moveaxis(rows, 2, 0)
    estimated, determined = known(tip), known(force_nees)
    return {
        'estimates': float(estimated.mean()),
        'tip_rms': rms(tip[estimated]),
        'tip_covered': covered(tip_nees),
        'tip_beyond': float(np.mean(tip_nees[estimated] > BEYOND)) if estimated.any() else 0.0,
        'determined': float(determined[estimated].mean()) if estimated.any() else 0.0,
        'force_rms': rms(force[determined]),
        'force_covered': covered(force_nees),
    }


def show(summary: dict, title: str) -> None:
    """Print for people."""
    table = Table(title=title)
    shown = (
        ('what is there', '', '', 1.0),
        ('estimates', 'estimates', '.0%', 1.0),
        ('tip: rms mm', 'tip_rms', '.2f', 1e3),
        ('covered', 'tip_covered', '.3f', 1.0),
        ('of 1000 beyond 4 sigma', 'tip_beyond', '.1f', 1e3),
        ('force: determined', 'determined', '.0%', 1.0),
        ('rms mN', 'force_rms', '.1f', 1e3),
        ('covered', 'force_covered', '.3f', 1.0),
    )
    for heading, *_ in shown:
        table.add_column(heading)
    for way, numbers in summary['ways'].items():
        cells = [format(numbers[name] * unit, form) for _, name, form, unit in shown[1:]]
        table.add_row(way, *cells)
    console = Console(width=150)
    console.print(table)
    console.print('\n'.join(summary['missed'] or ['all goals reached']))


def main() -> int:
    """Run and print."""
    arguments = rig_command(__doc__.splitlines()[0], recordings=2).parse_args()
    return run_bench('fusion_rates', arguments, try_rates, summary_of, show)


if __name__ == '__main__':
    sys.exit(main())

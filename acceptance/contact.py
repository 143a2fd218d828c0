"""Detection rate, accuracy and false alarms of contacts along the arm.

    python acceptance/contact.py [--quick] [--json] [--rigs N] [--recordings N] [--first N]
                                 [--keep FOLDER] [--workers N]

A rig is an arm of the virtual lab, its model calibrated from six recordings (`rigs.py`). In
each recording something pushes at one place, along the normal, from one moment to another, while
pressure and tip force go through random mixes; the truth is that of the lab. Ways: with a force
sensor at the tip, with nothing at the tip and the fusion knowing that (`free_tip`), and with an
unknown tip force. False alarms are counted in recordings without a push: with those three ways,
and with creep that the model lacks. Two more things that the model lacks are tried without a goal:
its weight, and a weak chamber. Exit code 1 where a goal is missed.
"""

from __future__ import annotations

import dataclasses
import math
import sys
import time

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import PressureReading
from pneunet_ros.core.share import share_path
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.fusion.estimate import FusedEstimate
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.fusion.settings import FUSION
from pneunet_ros.fusion.state import FusionState
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.lab_recording import LabRecording
from pneunet_ros.lab.outside_effects import LabPush
from pneunet_ros.lab.protocols import RandomMix
from pneunet_ros.lab.scenario import Changes
from pneunet_ros.lab.sensors import Rates
from pneunet_ros.lab.simulation import simulate
from rich.console import Console
from rich.table import Table
from rigs import (
    ANSWERED,
    missed_goals,
    model_of,
    read_sensors,
    rig_command,
    run_bench,
    sightings_of,
    wrench_of,
)

RATE = 10.0  # Hz, of frames and readings
FORCES = 8e-3, 60e-3  # N, of pushes, evenly in their logarithm
PLACES = 0.3, 0.9  # s / l
RAMP = 0.2  # s, in which a push comes and goes
WAYS = ('wrench', 'free tip', 'no wrench')
LACKING: dict[str, Changes] = {
    'clean': {},
    'creep': {'creep': {'amplitude': 0.15, 'time_constant': 8.0}},
    'weight': {'gravity': {'weight_y': -0.2}},
    'weak chamber': {'weak_chamber': {'rigidity_loss': 0.15, 'curvature_dip': 2.0}},
}
FOR_ALL = ('push', 'clean', 'creep')
CASES = (
    *((way, what) for what in FOR_ALL for way in WAYS),
    *(('wrench', what) for what in LACKING if what not in FOR_ALL),
)
# One row per frame: the push that there is (N along the normal, m along the arm), what is found
# of it with its std, NaN where nothing is, log odds, whether ambiguous, CPU time of the frame (s).
COLUMNS = (
    'true_force',
    'true_place',
    'force',
    'std_force',
    'place',
    'std_place',
    'log_odds',
    'ambiguous',
    'seconds',
)
Z_95 = 1.959964
FOUND = 0.9  # of the frames with a push, at least, as of one recording in the test of this bench
GOALS = {
    **{(f'{way} {what}', 'estimates'): (ANSWERED, 1.0) for way in WAYS for what in FOR_ALL},
    **{(f'{way} push', 'found'): (FOUND, 1.0) for way in ('wrench', 'free tip')},
    ('wrench push', 'size'): (0.0, 0.04),
    ('wrench push', 'place'): (0.0, 2.5e-3),
    ('free tip push', 'size'): (0.0, 0.04),
    ('free tip push', 'place'): (0.0, 2.5e-3),
    **{
        (f'{way} {what}', 'false_alarms'): (0.0, 1e-3)
        for what in ('clean', 'creep')
        for way in WAYS
    },
}


def recording_of(seed: int, which: int, way: str, what: str) -> LabRecording:
    """Return one of the recordings of a rig, with a camera of its own."""
    scenario = load_scenario(share_path('scenarios/random_mix.yaml'))
    random = np.random.default_rng([seed, which, 17])
    tip = {'force_x': (0.0, 0.0), 'force_y': (0.0, 0.0)} if way == 'free tip' else {}
    protocol = RandomMix(seed=float(100 * seed + which), lowest=12e3, top=62e3, **tip)
    changes = LACKING.get(what, {})
    if what == 'push':
        low, high = np.log(FORCES)
        size = float(np.exp(random.uniform(low, high)) * random.choice([-1.0, 1.0]))
        begins, lasts = random.uniform(4.0, 12.0), random.uniform(8.0, 20.0)
        push = {
            'force': size,
            'place': float(random.uniform(*PLACES)),
            'begins': float(begins),
            'ends': float(begins + lasts),
            'ramp': RAMP,
        }
        changes = {'push': push}
    return simulate(
        dataclasses.replace(
            scenario,
            name=f'contact {way} {what} {which}',
            seed=seed,
            arm=vary_arm(scenario.arm, seed),
            protocol=protocol,
            noise=dataclasses.replace(scenario.noise, jitter_std=0.0),
            rates=Rates(pressure=RATE, wrench=RATE, frames=RATE),
        ).with_effects(changes)
    )


def fuse(fusion: Fusion, recording: LabRecording, way: str, seed: int) -> Array:
    """Fuse a recording in one way, and set it beside the truth: COLUMNS, a row per frame."""
    truth, read = recording.truth, read_sensors(recording, np.random.default_rng([seed, 13]))
    state, rows = FusionState(), np.full((truth.time.size, len(COLUMNS)), np.nan)
    pushes = [item for item in recording.scenario.effects if isinstance(item, LabPush)]
    rows[:, 0] = sum((push.force_at(truth.time) for push in pushes), np.zeros(truth.time.size))
    rows[:, 1] = sum(push.place for push in pushes) * recording.scenario.arm.length
    for instant, stamp in enumerate(recording.stamp_ns.tolist()):
        if way == 'wrench':
            state, _ = fusion.step(state, wrench_of(stamp, read[instant]))
        seen = sightings_of(stamp, recording.x[instant], recording.y[instant])
        begun = time.process_time()
        state, _ = fusion.step(state, seen)
        state, fused = fusion.step(
            state, PressureReading(stamp_ns=stamp, pressure=float(read[instant, 3]))
        )
        rows[instant, -1] = time.process_time() - begun
        if isinstance(fused, FusedEstimate):
            rows[instant, 2:-1] = row_of(fused)
    return rows


def row_of(fused: FusedEstimate) -> list[float]:
    """Return what an estimate says of a contact, from `force` to `ambiguous` of COLUMNS."""
    contact = fused.contact
    if contact is None:
        return [math.nan] * 5 + [0.0]
    return [
        contact.force,
        contact.std_force,
        contact.arclength,
        contact.std_arclength,
        contact.log_odds,
        float(contact.ambiguous),
    ]


def try_model(seed: int, recordings: int) -> dict[str, Array]:
    """Fuse recordings of a rig by a model of it: (recordings, frames, COLUMNS) by case."""
    arm = model_of(seed)
    usual = Fusion(arm=arm)
    free_tip = Fusion(arm=arm, settings=dataclasses.replace(FUSION, free_tip=True))
    rows: dict[str, Array] = {}
    for way, what in CASES:
        fusion = free_tip if way == 'free tip' else usual
        found = [
            fuse(fusion, recording_of(seed, which, way, what), way, 100 * seed + which)
            for which in range(recordings)
        ]
        rows[f'{way} {what}'] = np.stack(found)
    return rows


def summary_of(rigs: list[dict[str, Array]]) -> dict:
    """Return what each case came to, and which goals are missed."""
    cases = {
        name: numbers_of(np.concatenate([rig[name] for rig in rigs]))
        for name in (f'{way} {what}' for way, what in CASES)
    }
    return {'cases': cases, 'missed': missed_goals(cases, GOALS)}


def numbers_of(recordings: Array) -> dict:
    """Return the numbers of one case, (recordings, frames, COLUMNS)."""
    rows = np.concatenate(recordings)
    column = {name: rows[:, place] for place, name in enumerate(COLUMNS)}
    named = is_named(rows)
    there = np.abs(column['true_force']) >= FORCES[0] * (1.0 - 1e-9)
    none = column['true_force'] == 0.0
    found = there & named
    size = np.abs(column['force'] - column['true_force'])[found]
    place = np.abs(column['place'] - column['true_place'])[found]
    delays = [delays_of(one) for one in recordings]
    return {
        'frames': len(rows),
        'found': share(named[there]),
        'ambiguous': share(column['ambiguous'][there] > 0.0),
        'estimates': share(~np.isnan(column['ambiguous'])),
        'size': median(size / np.abs(column['true_force'][found])),
        'size_covered': share(size <= Z_95 * column['std_force'][found]),
        'place': median(place),
        'place_covered': share(place <= Z_95 * column['std_place'][found]),
        'false_alarms': share(named[none]),
        'ambiguous_in_vain': share(column['ambiguous'][none] > 0.0),
        'onset': median([onset for onset, _ in delays]),
        'release': median([release for _, release in delays]),
        'milliseconds': 1e3 * float(column['seconds'].mean()),
    }


def is_named(rows: Array) -> Array:
    """Whether a contact is named, and not ambiguous, in each of rows (frames, COLUMNS)."""
    force, ambiguous = (rows[:, COLUMNS.index(name)] for name in ('force', 'ambiguous'))
    return np.isfinite(force) & ~(ambiguous > 0.0)


def delays_of(rows: Array) -> tuple[float, float]:
    """Return frames from the onset of a push to when it is named, from its end to when it is not.

    An ambiguous contact is not named. NaN without a push, and of its end where it is not named in
    the last frame with it; infinite where it is never named, or always after.
    """
    pushed = np.flatnonzero(rows[:, 0] != 0.0)
    if not pushed.size:
        return math.nan, math.nan
    named = is_named(rows)
    after = np.flatnonzero(named[pushed[0] :])
    onset = float(after[0]) if after.size else math.inf
    if not named[pushed[-1]]:
        return onset, math.nan
    gone = np.flatnonzero(~named[pushed[-1] + 1 :])
    return onset, float(gone[0]) if gone.size else math.inf


def share(values: Array) -> float:
    """Return the share of what is true; NaN of nothing."""
    return float(np.mean(values)) if len(values) else math.nan


def median(values: Array | list[float]) -> float:
    """Return the median of what is known; NaN of nothing."""
    known = np.asarray(values, dtype=np.float64)
    known = known[~np.isnan(known)]
    return float(np.median(known)) if known.size else math.nan


def show(summary: dict, title: str) -> None:
    """Print for people."""
    table = Table(title=title)
    shown = (
        ('case', None, ''),
        ('frames', 'frames', 'd'),
        ('estimates', 'estimates', '.3f'),
        ('found', 'found', '.3f'),
        ('ambiguous', 'ambiguous', '.3f'),
        ('size, median', 'size', '.2%'),
        ('covered', 'size_covered', '.3f'),
        ('place, median mm', 'place', '.2f'),
        ('covered', 'place_covered', '.3f'),
        ('false alarms', 'false_alarms', '.4f'),
        ('ambiguous in vain', 'ambiguous_in_vain', '.3f'),
        ('onset, frames', 'onset', '.1f'),
        ('release', 'release', '.1f'),
        ('ms a frame', 'milliseconds', '.2f'),
    )
    for heading, _, _ in shown:
        table.add_column(heading, no_wrap=heading == 'case')
    for case, numbers in summary['cases'].items():
        cells = [case]
        for _, name, form in shown[1:]:
            value = numbers[name] * (1e3 if name == 'place' else 1)
            cells.append('-' if math.isnan(value) else format(value, form))
        table.add_row(*cells)
    console = Console(width=180)
    console.print(table)
    for sentence in summary['missed'] or ['all goals reached']:
        console.print(sentence)


def main() -> int:
    """Run and print."""
    arguments = rig_command(__doc__.splitlines()[0], recordings=8).parse_args()
    return run_bench('contact', arguments, try_model, summary_of, show)


if __name__ == '__main__':
    sys.exit(main())

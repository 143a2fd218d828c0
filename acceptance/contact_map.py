"""Map of the observability of contacts along the arm: Fisher information of a frame.

    python acceptance/contact_map.py [--model FILE] [--picture PNG] [--json]

One frame of all targets, noise as in the model (white, painted places, camera, pressure) and the
columns of its covariance; nothing is simulated. A contact of 20 mN presses at a place, under some
pressures and tip forces; the tip force is not known at all, read by a sensor, or known to be none.
Without `--model` a rig of the virtual lab is calibrated, as in `contact.py`.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.files.json_text import plain
from pneunet_ros.fusion.belief import Belief, first_belief
from pneunet_ros.fusion.contact import with_any_contact
from pneunet_ros.fusion.frame_fit import FrameProblem
from pneunet_ros.fusion.fusion import Fusion
from pneunet_ros.measurement.blocks.block import FrameInputs
from pneunet_ros.measurement.blocks.contact import Push
from pneunet_ros.measurement.blocks.pressure_error import PressureError
from pneunet_ros.measurement.blocks.tip_force import TipForce
from pneunet_ros.measurement.blocks.unknowns import Unknowns
from pneunet_ros.measurement.inference.gaussian import take_measurement
from pneunet_ros.model.arm import Arm
from rich.console import Console
from rich.table import Table
from rigs import FIRST_SEED, model_of

PUSH = 0.02  # N
PLACES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)  # s / l
PRESSURES = (5e3, 20e3, 40e3, 60e3)  # Pa
FORCES = ((0.0, 0.0), (0.12, 0.05), (0.25, 0.2))  # N, at the tip
WAYS = ('not known', 'read')  # of the tip force
# Of the contact: one sigma of its force (N) and of its place (m), the multiple correlation of its
# force with the tip force, and its correlation with the pressure bias.
COLUMNS = ('std_force', 'std_place', 'with_tip', 'with_bias')


def posterior(
    fusion: Fusion, place: float, pressure: float, force: tuple[float, float], way: str
) -> Belief | None:
    """Return what one frame tells around the truth; None where there is no stable shape."""
    arm, unknowns = fusion.arm, fusion.model.unknowns
    prior = with_any_contact(unknowns, first_belief(unknowns, 0))
    tip, push = unknowns.at(TipForce), unknowns.at(Push)
    if way == 'read':
        response = np.zeros((2, prior.mean.size))
        response[:, tip] = np.eye(2)
        std = np.full(2, arm.sensors.force_std)
        prior = take_measurement(prior, response, np.zeros(2), std)
    mean = np.zeros(prior.mean.size)
    mean[tip], mean[push] = force, (PUSH, place * arm.length)
    count = arm.target_arclength.size
    nothing = np.full(count, np.nan)
    names = ('std', 'u', 'v', 'area', 'major', 'minor', 'angle')
    problem = FrameProblem(
        table=fusion.model.table,
        unknowns=unknowns,
        settings=fusion.settings,
        prior=dataclasses.replace(prior, mean=freeze(mean)),
        growth=None,
        inputs=FrameInputs(
            chamber=pressure,
            chamber_std=arm.sensors.pressure_std,
            history=arm.initial_history(pressure),
            moment=0.0,
            moment_std=0.0,
            by_column=np.zeros(unknowns.law_columns),
            lag_offsets=np.zeros(len(fusion.model.discrepancy.lag_times) + 1),
        ),
        sightings=TargetSightings(
            stamp_ns=0, x=np.zeros(count), y=np.zeros(count), **dict.fromkeys(names, nothing)
        ),
        used=np.ones(count, dtype=bool),
    )
    truth = np.zeros(prior.root.shape[1])
    trial = problem.try_at(truth, None)
    if trial is None:
        return None
    x, y = arm.see(trial.bent.shape.x, trial.bent.shape.y)
    problem = dataclasses.replace(
        problem, sightings=dataclasses.replace(problem.sightings, x=x, y=y)
    )
    trial = problem.try_at(truth, trial.bent.solution)
    known = None if trial is None else problem.linearize(trial)
    return None if known is None else problem.posterior(known)


def correlation_with_tip(unknowns: Unknowns, belief: Belief) -> float:
    """Return the multiple correlation of the contact force with the tip force."""
    root = belief.root
    force, contact = root[unknowns.at(TipForce)], root[unknowns.at(Push).start]
    along = force @ contact
    explained = along @ np.linalg.lstsq(force @ force.T, along, rcond=None)[0]
    return math.sqrt(min(max(float(explained / (contact @ contact)), 0.0), 1.0))


def numbers_of(unknowns: Unknowns, belief: Belief) -> list[float]:
    """Return COLUMNS of a belief."""
    force, place = unknowns.at(Push).start, unknowns.at(Push).stop - 1
    root, which = belief.root, unknowns.at(PressureError).start
    bias = float(root[force] @ root[which]) / (belief.std(force) * belief.std(which))
    alike = correlation_with_tip(unknowns, belief)
    return [belief.std(force), belief.std(place), alike, abs(bias)]


def map_of(arm: Arm) -> Array:
    """Return COLUMNS by way, pressure, tip force and place; NaN where there is no shape."""
    fusion = Fusion(arm=arm)
    shape = len(WAYS), len(PRESSURES), len(FORCES), len(PLACES), len(COLUMNS)
    found = np.full(shape, np.nan)
    for index in np.ndindex(*shape[:-1]):
        way, pressure, force, place = index
        belief = posterior(fusion, PLACES[place], PRESSURES[pressure], FORCES[force], WAYS[way])
        if belief is not None:
            found[index] = numbers_of(fusion.model.unknowns, belief)
    return found


def show(found: Array) -> None:
    """Print for people: ranges over pressures and tip forces."""
    table = Table(title=f'A contact of {1e3 * PUSH:g} mN: one frame of all targets')
    table.add_column('s / l')
    for way in WAYS:
        for what in ('sigma of force mN', 'of place mm', 'correlation with tip', 'with bias'):
            table.add_column(f'tip force {way}: {what}')
    for place, where in enumerate(PLACES):
        cells = [f'{where:g}']
        for way in range(len(WAYS)):
            values = found[way, :, :, place].reshape(-1, len(COLUMNS)) * [1e3, 1e3, 1.0, 1.0]
            low, high = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
            forms = ('.2g', '.2g', '.3f', '.2f')
            cells += [f'{a:{f}} to {b:{f}}' for a, b, f in zip(low, high, forms, strict=True)]
        table.add_row(*cells)
    Console(width=150).print(table)


def draw(found: Array, path: str) -> None:
    """Draw it: a row for each quantity, a column for each pressure."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(
        3, len(PRESSURES), figsize=(11.0, 7.0), sharex=True, sharey='row', layout='constrained'
    )
    rows = (
        (0, 1e3, 'sigma of its force, mN'),
        (1, 1e3, 'sigma of its place, mm'),
        (2, 1.0, 'correlation with\nthe tip force'),
    )
    for row, (column, scale, label) in enumerate(rows):
        axes[row, 0].set_ylabel(label)
        for number, pressure in enumerate(PRESSURES):
            axis = axes[row, number]
            for force, style in zip(range(len(FORCES)), ('-', '--', ':'), strict=True):
                for way, color in enumerate(('C3', 'C0')):
                    values = scale * found[way, number, force, :, column]
                    size = f'({1e3 * FORCES[force][0]:g}, {1e3 * FORCES[force][1]:g}) mN'
                    label = f'tip force {size}, {WAYS[way]}'
                    axis.plot(PLACES, values, style, color=color, label=label)
            if row < 2:
                axis.set_yscale('log')
            else:
                axis.axhline(0.95, color='gray', linewidth=0.8)
                axis.set_ylim(0.0, 1.02)
                axis.set_xlabel('place of the contact, s / l')
            if row == 0:
                axis.set_title(f'{1e-3 * pressure:g} kPa')
            axis.grid(alpha=0.3)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=3, fontsize='small')
    figure.savefig(path, dpi=110)


def main() -> int:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--model', help='a model file (default: a calibrated rig)')
    command.add_argument('--picture', help='write the figure to this file')
    command.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = command.parse_args()
    found = map_of(load_model(arguments.model) if arguments.model else model_of(FIRST_SEED))
    if arguments.picture:
        draw(found, arguments.picture)
    if arguments.json:
        axes = {'ways': WAYS, 'pressures': PRESSURES, 'forces': FORCES, 'places': PLACES}
        result = {'bench': 'contact_map', **axes, 'columns': COLUMNS, 'found': found}
        print(json.dumps(plain(result), allow_nan=False))
    else:
        show(found)
    return 0


if __name__ == '__main__':
    sys.exit(main())

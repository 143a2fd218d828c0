"""Accuracy of calibration on arms of the virtual lab, and calibration of its error bars.

    python acceptance/calibration.py [--json] [--seeds N] [--first N] [--workers N]

Every seed is another arm (parameters up to 15 % off, dots painted anew) with six recordings of 400
frames: two unloaded, four loaded, and a seventh that is held out. The lab shares no solver with
the model. Errors of rigidity, l1 and kappa0 against the truth; how often the 95 % intervals
cover it; the score on the held-out recording over that of the true arm on the same noisy readings;
the end force from all targets and from the tip alone. Exit code 1 where a goal is missed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
import dataclasses
import json
import multiprocessing
import os
from pathlib import Path
import platform
import sys
import time

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.calibration.checks.held_out import score
from pneunet_ros.calibration.tip_force import end_forces
from pneunet_ros.core.share import share_path
from pneunet_ros.files.json_text import plain
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.protocols import RandomMix
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.lab.simulation import simulate
from pneunet_ros.model.arm import Arm
from rich.console import Console
from rich.progress import track
from rich.table import Table

# What the tests share knows the truth of the virtual lab as a model.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from support.lab_run import run_of, true_model

UNLOADED = ('unloaded_ramp', 'unloaded_staircase')
LOADED = ('dead_weights', 'force_sweeps', 'strings', 'random_mix')
STATIONS = np.linspace(0.1, 0.9, 9)  # s / l, where kappa0 counts
LAW_PRESSURES = np.linspace(10e3, 62e3, 5)  # Pa, where there were loads
CURVATURE_PRESSURES = np.linspace(5e3, 65e3, 5)
TRUSTED = 0.025  # of the force: predicted sigma of an end force that must be right within 5 %
Z_95 = 1.959964
FIRST_SEED = 1000
GOALS = {
    ('held_out_over_true', 'median'): (0.0, 1.1),
    ('alpha1_error', 'median'): (0.0, 0.05),
    ('alpha2_error', 'median'): (0.0, 0.05),
    ('split_error', 'median'): (0.0, 0.01),
    ('curvature_error', 'median'): (0.0, 0.02),
    ('covered', 'pooled'): (0.93, 0.97),
    ('covered', 'least_of_one'): (0.87, 1.0),
}


def record(
    seed: int, change: Callable[[Scenario], Scenario] = lambda scenario: scenario
) -> tuple[dict, Scenario]:
    """Return the runs of one seed by name, with the true end force of the one held out.

    change: of each scenario before it is recorded.
    """
    runs = {}
    for place, name in enumerate((*UNLOADED, *LOADED, 'held_out')):
        file = 'random_mix' if name == 'held_out' else name
        scenario = load_scenario(share_path(f'scenarios/{file}.yaml'))
        changes = {'arm': vary_arm(scenario.arm, seed), 'seed': 100 * seed + place}
        if name == 'held_out':
            assert isinstance(scenario.protocol, RandomMix)
            changes['protocol'] = dataclasses.replace(scenario.protocol, seed=float(seed))
        recording = simulate(change(dataclasses.replace(scenario, **changes)))
        runs[name] = run_of(recording)
    kept = np.isfinite(recording.x).any(axis=1)
    runs['true_force'] = recording.truth.force[kept]
    return runs, recording.scenario


def law_values(arm: Arm) -> np.ndarray:
    """Return alpha1, alpha2 and l1 / l at LAW_PRESSURES, (3, pressures)."""
    sections = arm.moment_law.sections(LAW_PRESSURES, arm.length, arm.weight)
    alpha = sections[:, :, 1] / (arm.weight * arm.length**2)
    return np.stack([alpha[:, 0], alpha[:, 1], sections[:, 1, 0] / arm.length])


def curvature_values(arm: Arm) -> np.ndarray:
    """Return kappa0 (1/m) at CURVATURE_PRESSURES and STATIONS."""
    return np.array([arm.intrinsic_curvature.at(p, STATIONS) for p in CURVATURE_PRESSURES])


def standard_errors(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard errors of `law_values` and `curvature_values`, by linear propagation."""
    fit = calibration.joint
    factor = np.linalg.cholesky(fit.covariance)
    law, curvature = [], []
    for column in factor.T:
        sides = [fit.parameters.arm(fit.values + sign * 0.1 * column) for sign in (-1.0, 1.0)]
        law.append((law_values(sides[1]) - law_values(sides[0])) / 0.2)
        curvature.append((curvature_values(sides[1]) - curvature_values(sides[0])) / 0.2)
    return tuple(np.sqrt(np.sum(np.square(moved), axis=0)) for moved in (law, curvature))


def one_seed(seed: int) -> dict:
    """Calibrate one arm and compare with the truth."""
    runs, scenario = record(seed)
    frame = load_model(share_path('config/paper_arm.yaml'))
    frame = dataclasses.replace(frame, target_arclength=scenario.arm.targets)
    started = time.perf_counter()
    calibration = calibrate(
        [runs[name] for name in UNLOADED], [runs[name] for name in LOADED], frame, compare=False
    )
    seconds = time.perf_counter() - started
    true, arm = true_model(scenario), calibration.arm
    law_error = law_values(arm) - law_values(true)
    curvature_error = curvature_values(arm) - curvature_values(true)
    law_std, curvature_std = standard_errors(calibration)
    held = runs['held_out']
    forces = {}
    size = np.hypot(*runs['true_force'].T)
    loaded = size > 0.02
    for name, tip_only in (('all_targets', False), ('tip', True)):
        found = end_forces(arm, held, tip_only=tip_only)
        error = (found.force - runs['true_force'])[loaded]
        sigma = found.sigma[loaded]
        usable = np.isfinite(error[:, 0])
        relative = sigma[usable] / size[loaded][usable, None]
        trusted = relative < TRUSTED
        share = np.abs(error[usable]) / size[loaded][usable, None]
        forces[name] = {
            'found': float(usable.mean()),
            'covered': (np.abs(error[usable]) <= Z_95 * sigma[usable]).mean(axis=0),
            'median_sigma': np.median(relative, axis=0),
            'trusted': float(trusted.mean()),
            'trusted_within_5': float((share[trusted] <= 0.05).mean()) if trusted.any() else None,
            'trusted_worst': float(share[trusted].max()) if trusted.any() else None,
        }
    fit = calibration.joint
    return {
        'seed': seed,
        'seconds': seconds,
        'converged': fit.converged,
        'chi_squared_per_coordinate': fit.chi_squared / fit.dof,
        'held_out_rms': score(arm, held).rms,
        'true_rms': score(true, held).rms,
        'alpha_error': np.abs(law_error[:2] / law_values(true)[:2]).max(axis=1),
        'split_error': float(np.abs(law_error[2]).max()),
        'curvature_error': float(np.abs(curvature_error).max() / curvature_values(true).max()),
        'law_covered': np.abs(law_error) <= Z_95 * law_std,
        'curvature_covered': np.abs(curvature_error) <= Z_95 * curvature_std,
        'forces': forces,
    }


def summary_of(rows: list[dict]) -> dict:
    """Return what all seeds came to."""
    law = np.array([row['law_covered'] for row in rows])
    curvature = np.array([row['curvature_covered'] for row in rows])
    ratio = np.array([row['held_out_rms'] / row['true_rms'] for row in rows])
    alpha = np.array([row['alpha_error'] for row in rows])
    pooled = np.concatenate([law.ravel(), curvature.ravel()])
    quantities = {
        'alpha1': law[:, 0], 'alpha2': law[:, 1], 'l1': law[:, 2], 'kappa0': curvature,
    }  # fmt: skip
    single = np.concatenate([law.reshape(len(rows), -1), curvature.reshape(len(rows), -1)], axis=1)
    forces = {}
    for name in ('all_targets', 'tip'):
        found = [row['forces'][name] for row in rows]
        within = [
            item['trusted_within_5'] for item in found if item['trusted_within_5'] is not None
        ]
        forces[name] = {
            'found': np.mean([item['found'] for item in found]),
            'covered': np.mean([item['covered'] for item in found], axis=0),
            'median_sigma': np.median([item['median_sigma'] for item in found], axis=0),
            'trusted': np.mean([item['trusted'] for item in found]),
            'trusted_within_5': np.mean(within) if within else None,
            'trusted_worst': max((item['trusted_worst'] or 0.0 for item in found), default=None),
        }
    summary = {
        'converged': np.mean([row['converged'] for row in rows]),
        'median_seconds': np.median([row['seconds'] for row in rows]),
        'chi_squared_per_coordinate': np.mean([row['chi_squared_per_coordinate'] for row in rows]),
        'held_out_over_true': {'median': np.median(ratio), 'worst': ratio.max()},
        'alpha1_error': {'median': np.median(alpha[:, 0]), 'worst': alpha[:, 0].max()},
        'alpha2_error': {'median': np.median(alpha[:, 1]), 'worst': alpha[:, 1].max()},
        'split_error': {
            'median': np.median([row['split_error'] for row in rows]),
            'worst': max(row['split_error'] for row in rows),
        },
        'curvature_error': {
            'median': np.median([row['curvature_error'] for row in rows]),
            'worst': max(row['curvature_error'] for row in rows),
        },
        'covered': {
            'pooled': pooled.mean(),
            'least_of_one': single.mean(axis=0).min(),
            **{name: values.mean() for name, values in quantities.items()},
        },
        'forces': forces,
    }
    return summary | {'missed': missed_goals(summary)}


def show(summary: dict) -> None:
    """Print for people."""
    table = Table(title='Calibration in the virtual lab')
    table.add_column('what')
    table.add_column('reached')
    table.add_column('wanted')
    words = (
        'held-out rms / that of the true arm, median',
        'alpha1, worst error over pressure, median',
        'alpha2',
        'l1 / l',
        'kappa0 / largest, s/l 0.1 to 0.9',
        '95 % intervals cover, pooled',
        'least of one quantity',
    )
    for what, ((name, number), (low, high)) in zip(words, GOALS.items(), strict=True):
        table.add_row(what, f'{summary[name][number]:.4f}', f'{low:g} to {high:g}')
    for name, item in summary['forces'].items():
        covered = ', '.join(f'{value:.3f}' for value in item['covered'])
        table.add_row(f'F1, F2 from {name}: 95 % intervals cover', covered, '0.95')
        sigma = ', '.join(f'{value:.4f}' for value in item['median_sigma'])
        table.add_row('    median sigma / force', sigma, '')
        if item['trusted_within_5'] is not None:
            table.add_row(
                '    within 5 % where sigma < 2.5 %', f'{item["trusted_within_5"]:.4f}', '1'
            )
    console = Console()
    console.print(table)
    console.print('\n'.join(summary['missed'] or ['all goals reached']))


def missed_goals(summary: dict) -> list[str]:
    """Return a sentence for every goal that is missed."""
    return [
        f'{name}, {number} = {summary[name][number]:.4g}, wanted {low:g} to {high:g}'
        for (name, number), (low, high) in GOALS.items()
        if not low <= summary[name][number] <= high
    ]


def seed_command(about: str, *, seeds: int, first: int) -> argparse.ArgumentParser:
    """Return the command of a bench over seeds, each an arm of its own."""
    command = argparse.ArgumentParser(description=about)
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument(
        '--seeds', type=int, default=seeds, help=f'number of arms (default: {seeds})'
    )
    command.add_argument('--first', type=int, default=first, help=f'first seed (default: {first})')
    command.add_argument(
        '--workers', type=int, default=max(1, (os.cpu_count() or 1)), help='processes'
    )
    return command


def run_seeds(run_seed: Callable[[int], dict], arguments: argparse.Namespace) -> list[dict]:
    """Return the rows of all seeds, each made in a process."""
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    context = multiprocessing.get_context('spawn')
    with ProcessPoolExecutor(arguments.workers, mp_context=context) as pool:
        return list(
            track(
                pool.map(run_seed, seeds),
                total=len(seeds),
                console=Console(stderr=True),
                disable=arguments.json,
            )
        )


def main() -> int:
    """Run and print."""
    arguments = seed_command(__doc__.splitlines()[0], seeds=20, first=FIRST_SEED).parse_args()
    rows = run_seeds(one_seed, arguments)
    summary = summary_of(rows)
    if arguments.json:
        machine = {'machine': platform.machine(), 'python': platform.python_version()}
        result = {'bench': 'calibration', **machine, 'seeds': len(rows), 'summary': summary}
        print(json.dumps(plain(result | {'rows': rows}), allow_nan=False))
    else:
        show(summary)
    return 1 if summary['missed'] else 0


if __name__ == '__main__':
    sys.exit(main())

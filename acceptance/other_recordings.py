"""Calibration on recordings with sensors and cameras unlike the virtual lab's defaults.

    python acceptance/other_recordings.py [--json] [--seeds N] [--first N] [--workers N]

Every seed is another arm, as in `calibration.py`, up to ten times as stiff or half as stiff, its
clamp pointing anywhere, and is recorded by other sensors: noise of every kind, rates of camera and
readings (also readings that are rarer than frames), jitter, occlusions, and which dots are
painted are drawn anew. The calibration is told nothing of it. Errors of the moment law and of
kappa0 are in standard errors: 1 rms where these are honest. Exit code 1 where a goal is missed.
"""

from __future__ import annotations

import dataclasses
import json
import math
import sys

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from calibration import (
    curvature_values,
    law_values,
    LOADED,
    record,
    run_seeds,
    seed_command,
    standard_errors,
    UNLOADED,
)
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.calibration.checks.held_out import score
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.share import share_path
from pneunet_ros.files.json_text import plain
from pneunet_ros.lab.scenario import Scenario
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from rich.console import Console
from rich.table import Table
from support.lab_run import true_model

FIRST_SEED = 8000
# Smallest and largest of what is drawn, alike on a scale of decades.
NOISE = {
    'pressure_std': (20.0, 1000.0),
    'force_std': (3e-4, 8e-3),
    'moment_std': (1e-6, 1e-4),
    'target_std': (2e-5, 1e-3),
    'placement_std': (2e-5, 5e-4),
    'registration_std': (3e-5, 2e-3),
    'drift_std': (1e-5, 5e-4),
    'occlusions': (0.01, 0.5),
    'jitter_std': (1e-4, 1e-2),
}
FRAME_RATES = 1.0, 2.0, 5.0, 10.0, 30.0  # Hz
READING_RATES = 2.0, 10.0, 50.0, 200.0  # Hz
FEWEST_DOTS = 5
STIFFER = 0.5, 10.0
CLAMP_ANGLES = 0.0, 0.0, -0.5 * math.pi, 0.5 * math.pi, 0.7  # rad
GOALS = {
    'settled': (0.95, 1.0),
    'with_law': (0.95, 1.0),
    'law_error': (0.0, 1.5),
    'curvature_error': (0.0, 1.5),
    'held_out_over_true': (0.0, 1.1),
}


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """What a seed is recorded by: noise by name, rates (Hz), dots, and the arm's own."""

    noise: dict[str, float]
    frames: float
    readings: float
    dots: list[int]
    stiffer: float
    clamp_angle: float

    def change(self, scenario: Scenario) -> Scenario:
        """Return a scenario with these."""
        arm, rates = scenario.arm, scenario.rates
        return dataclasses.replace(
            scenario,
            noise=dataclasses.replace(scenario.noise, **self.noise),
            rates=dataclasses.replace(
                rates, frames=self.frames, pressure=self.readings, wrench=self.readings
            ),
            arm=dataclasses.replace(
                arm,
                targets=arm.targets[self.dots],
                rigidity=arm.rigidity * self.stiffer,
                clamp_angle=self.clamp_angle,
            ),
        )


def draw_recording(seed: int, dots: int) -> Drawn:
    """Draw what a seed is recorded by; dots: on the arm of the lab."""
    random = np.random.default_rng([seed, 99])

    def decades(limits: tuple[float, float]) -> float:
        return float(np.exp(random.uniform(*np.log(limits))))

    return Drawn(
        noise={name: decades(limits) for name, limits in NOISE.items()},
        frames=float(random.choice(FRAME_RATES)),
        readings=float(random.choice(READING_RATES)),
        dots=np.unique(
            random.choice(dots, size=int(random.integers(FEWEST_DOTS, dots + 1)), replace=False)
        ).tolist(),
        stiffer=decades(STIFFER),
        clamp_angle=float(random.choice(CLAMP_ANGLES)),
    )


def one_seed(seed: int) -> dict:
    """Calibrate from the recordings of a seed and compare with the truth."""
    frame = load_model(share_path('config/paper_arm.yaml'))
    other = draw_recording(seed, frame.target_arclength.size)
    runs, scenario = record(seed, other.change)
    frame = dataclasses.replace(
        frame, target_arclength=scenario.arm.targets, clamp_angle=other.clamp_angle
    )
    row = {'seed': seed, **dataclasses.asdict(other), 'refused': '', 'settled': False}
    unloaded, loaded = ([runs[name] for name in names] for names in (UNLOADED, LOADED))
    try:
        calibration = calibrate(unloaded, loaded, frame, compare=False)
    except PneunetError as error:
        return row | {'refused': str(error)}
    true, arm, fit = true_model(scenario), calibration.arm, calibration.joint
    row |= {
        'settled': fit.converged,
        'chi_squared': fit.chi_squared / fit.dof,
        'held_out_over_true': score(arm, runs['held_out']).rms / score(true, runs['held_out']).rms,
        'notes': list(calibration.notes),
    }
    if not isinstance(arm.moment_law, PiecewiseLinearLaw):
        return row
    law_std, curvature_std = standard_errors(calibration)
    return row | {
        'law_error': (law_values(arm) - law_values(true)) / law_std,
        'curvature_error': (curvature_values(arm) - curvature_values(true)) / curvature_std,
    }


def summary_of(rows: list[dict]) -> dict:
    """Return what all seeds came to, also those with readings rarer than frames alone."""
    found = numbers_of(rows)
    rare = [row for row in rows if row['readings'] < row['frames']]
    missed = [
        f'{name} = {found[name]:.4g}, wanted {low:g} to {high:g}'
        for name, (low, high) in GOALS.items()
        if not low <= found[name] <= high
    ]
    return {'all': found, 'rare readings': numbers_of(rare) if rare else {}, 'missed': missed}


def numbers_of(rows: list[dict]) -> dict[str, float]:
    """Return shares, and errors in standard errors: rms, and the largest of all."""
    numbers: dict[str, float] = {
        'arms': len(rows),
        'refused': float(np.mean([bool(row['refused']) for row in rows])),
        'settled': float(np.mean([row['settled'] for row in rows])),
        'with_law': float(np.mean(['law_error' in row for row in rows])),
        'held_out_over_true': float(
            np.median([row.get('held_out_over_true', math.inf) for row in rows])
        ),
    }
    for name in ('law_error', 'curvature_error'):
        errors = [row[name].ravel() for row in rows if name in row]
        every = np.concatenate(errors) if errors else np.full(1, np.nan)
        numbers |= {
            name: float(np.sqrt(np.mean(every**2))),
            f'{name}_largest': np.abs(every).max(),
        }
    return numbers


def show(summary: dict) -> None:
    """Print for people."""
    table = Table(title='Calibration by other sensors')
    for heading in ('what', 'all', 'rare readings'):
        table.add_column(heading)
    for name, value in summary['all'].items():
        rare = summary['rare readings'].get(name)
        table.add_row(name, f'{value:.3g}', '' if rare is None else f'{rare:.3g}')
    console = Console()
    console.print(table)
    console.print('\n'.join(summary['missed'] or ['all goals reached']))


def main() -> int:
    """Run and print."""
    arguments = seed_command(__doc__.splitlines()[0], seeds=40, first=FIRST_SEED).parse_args()
    rows = run_seeds(one_seed, arguments)
    summary = summary_of(rows)
    if arguments.json:
        result = {'bench': 'other_recordings', 'summary': summary, 'rows': rows}
        print(json.dumps(plain(result), allow_nan=False))
    else:
        show(summary)
    return 1 if summary['missed'] else 0


if __name__ == '__main__':
    sys.exit(main())

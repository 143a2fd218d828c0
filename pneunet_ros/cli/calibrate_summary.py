"""The results of a calibration, as numbers and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.checks.left_out_levels import LeftOutLevels
from pneunet_ros.calibration.checks.stiffness_variation import StiffnessVariation
from pneunet_ros.calibration.target_row import target_row
from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.core.arrays import root_mean_square
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from pneunet_ros.reports.calibration.tables import curvature_table, law_rows, number_rows, Row
from pneunet_ros.reports.calibration.verdict import (
    bending_stiffness,
    Files,
    last_target_rms,
    verdict_of,
)
from rich.console import Console
from rich.text import Text


def numbers_of(calibration: Calibration, files: Files) -> dict[str, Any]:
    """Return the summary for programs; files: for the next command."""
    joint = calibration.joint
    return {
        'status': joint.status,
        'converged': joint.converged,
        'verdict': asdict(verdict_of(calibration, files=files)),
        'bending_stiffness': [asdict(item) for item in bending_stiffness(joint)],
        'quantities': [
            {'name': row.name, 'value': row.value, 'std': row.std, 'prior_std': row.prior_std}
            for row in number_rows(calibration)
        ],
        'noise': {
            name: {'std': getattr(calibration.noise.noise, name), 'source': text}
            for name, text in calibration.noise.sources.items()
        },
        'recordings': [
            {
                'name': fitted.run.name,
                'loaded': fitted.run.loaded,
                'frames': len(fitted.solved),
                'unsolved': int(np.count_nonzero(~fitted.solved)),
                'rms': root_mean_square(fitted.residual),
                'tip_rms': last_target_rms([fitted]),
                'chi_squared_per_coordinate': float(
                    fitted.whitened.sum() / max(int(fitted.dof.sum()), 1)
                ),
            }
            for fitted in joint.runs
        ],
        'target_row': asdict(target_row(joint)),
        'laws': [
            {
                'kind': law.kind,
                'rms': law.rms,
                'left_out': {item.name: item.rms for item in law.scores},
            }
            for law in calibration.laws
        ],
        'left_out_levels': left_out_numbers(calibration.left_out),
        'stiffness_variation': variation_numbers(calibration.variation),
        'in_motion': None if calibration.motion is None else calibration.motion.summary,
        'covariance_share': calibration.explained_variance,
        'notes': list(calibration.notes),
    }


def left_out_numbers(left_out: LeftOutLevels | None) -> dict[str, Any] | None:
    """Return the results of left-out pressures without the columns; None if none was left out."""
    if left_out is None:
        return None
    return {
        name: getattr(left_out, name)
        for name in ('levels', 'model', 'arc', 'interpolation', 'changed', 'is_angle', 'better')
    }


def variation_numbers(variation: StiffnessVariation | None) -> dict[str, Any] | None:
    """Return the summary of a stiffness that varies along the arm; None if it was not tested."""
    if variation is None:
        return None
    return {
        'matters': variation.matters,
        'chi_squared': variation.statistic,
        'tip_rms': variation.tips.rms,
        'tip_nees': variation.tips.nees(),
        'factors': variation.factors.tolist(),
    }


def show(
    calibration: Calibration, summary: dict[str, Any], sentences: Sequence[str], console: Console
) -> None:
    """Print the summary for users, starting with the verdict; sentences: notes on recordings."""
    verdict = summary['verdict']
    console.print(Text(verdict['fit'], style='bold'))
    console.print(Text(verdict['certainty']))
    motion = calibration.motion
    if motion is not None:
        console.print(motion.left_out)
    console.print(target_row(calibration.joint).sentence)
    columns = ('recording', 'load', 'frames', 'rms (mm)', 'tip (mm)', 'chi2 per coordinate')
    recordings = [
        (
            row['name'],
            'loaded' if row['loaded'] else 'none',
            str(row['frames']),
            f'{millimeters(row["rms"]):.3f}',
            f'{millimeters(row["tip_rms"]):.3f}',
            f'{row["chi_squared_per_coordinate"]:.2f}',
        )
        for row in summary['recordings']
    ]
    print_rows(console, 'Recordings', columns, recordings, numbers=range(2, 6))
    rows = number_rows(calibration)
    print_curvature(console, calibration, rows)
    law = law_rows(rows)
    if law:
        print_law(console, calibration, law)
    if summary['laws']:
        title = 'Moment laws on left-out loaded recordings'
        laws = [(item['kind'], f'{millimeters(item["rms"]):.3f}') for item in summary['laws']]
        print_rows(console, title, ('law', 'rms (mm)'), laws, numbers=[1])
    verb.print_notes(console, (*sentences, *summary['notes'][motion is not None :]))
    if calibration.arm.domain is not None:
        console.print(
            f'The model is calibrated for {calibration.arm.domain.words}, and not beyond.'
        )
    if summary['output'] is None:
        console.print(f'no model was written: {summary["status"]}')
    else:
        console.print(f'wrote {summary["output"]}')
        console.print(f'wrote {summary["knowledge"]}, from which --continue resumes')
    if summary['report'] is not None:
        console.print(f'wrote {summary["report"]}/index.html')
    console.print(Text(f'{verdict["next_step"]} {verdict["command"]}'))


def print_law(console: Console, calibration: Calibration, law: tuple[Row, ...]) -> None:
    """Print the constants of the moment law: by pressure if it has rows, else by name."""
    fitted = calibration.arm.moment_law
    texts = {row.name: f'{row.value:.4g} ± {row.std:.1g}' for row in law}
    title = f'Moment law, {fitted.kind}'
    if not isinstance(fitted, PiecewiseLinearLaw):
        print_rows(console, title, ('quantity', 'value'), texts.items())
        return
    texts |= {
        f'EI of {row.name}': f'{unit * row.value:.2e} ± {unit * row.std:.0e}'
        for row in law
        if (unit := row.unit_stiffness)
    }
    columns = ('pressure (kPa)', 'alpha1', 'EI1 (N m^2)', 'alpha2', 'EI2 (N m^2)', 'l1 / l')
    rows = []
    for level, pressure in enumerate(fitted.pressure.tolist()):
        alphas = [f'moment_law.rigidity.{level}.{section}' for section in (0, 1)]
        names = [name for alpha in alphas for name in (alpha, f'EI of {alpha}')]
        shown = [texts[name] for name in (*names, f'moment_law.split.{level}')]
        rows.append((f'{kilopascals(pressure):z.1f}', *shown))
    print_rows(console, title, columns, rows, numbers=range(6))


def print_curvature(console: Console, calibration: Calibration, rows: tuple[Row, ...]) -> None:
    """Print kappa_p0 at mid-arm for every pressure, and its largest standard error."""
    fitted = curvature_table(calibration, rows)
    columns = ('pressure (kPa)', 'clamp', 'middle', 'tip', 'standard error, middle and worst')
    shown = []
    middle = len(fitted.rows) // 2
    for row, pressure in enumerate(fitted.pressures):
        values, errors, _ = zip(*(cells[row] for _, cells in fitted.rows), strict=True)
        knots = (f'{values[knot]:.2f}' for knot in (0, middle, -1))
        worst = f'{errors[middle]:.2f}, {max(errors):.2f}'
        shown.append((f'{pressure:z.1f}', *knots, worst))
    title = 'Intrinsic curvature kappa_p0 (1/m)'
    print_rows(console, title, columns, shown, numbers=range(5))

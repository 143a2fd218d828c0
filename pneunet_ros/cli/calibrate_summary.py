"""What a calibration came to, as numbers and for people."""

from __future__ import annotations

from typing import Any

import numpy as np
from pneunet_ros.calibration.calibration import Calibration
from pneunet_ros.calibration.result import Fit
from pneunet_ros.core.units import kilopascals, millimeters
from pneunet_ros.model.moment_law import PiecewiseLinearLaw
from rich.console import Console
from rich.table import Table


def quantities_of(fit: Fit) -> list[dict[str, Any]]:
    """Return every number of the model that was fitted: value, standard error, width before."""
    names, change = fit.parameters.quantities()
    values = change @ fit.values
    after = np.sqrt(np.einsum('ij,jk,ik->i', change, fit.covariance, change))
    before = np.sqrt(np.einsum('ij,jk,ik->i', change, fit.parameters.prior, change))
    return [
        {'name': name, 'value': float(value), 'std': float(std), 'prior_std': float(wide)}
        for name, value, std, wide in zip(names, values, after, before, strict=True)
    ]


def numbers_of(calibration: Calibration) -> dict[str, Any]:
    """Return the summary for programs."""
    joint = calibration.joint
    return {
        'status': joint.status,
        'converged': joint.converged,
        'quantities': quantities_of(joint),
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
                'rms': float(np.sqrt(np.nanmean(fitted.residual**2))),
                'chi_squared_per_coordinate': float(
                    fitted.whitened.sum() / max(int(fitted.dof.sum()), 1)
                ),
            }
            for fitted in joint.runs
        ],
        'laws': [
            {
                'kind': law.kind,
                'rms': law.rms,
                'left_out': {item.name: item.rms for item in law.scores},
            }
            for law in calibration.laws
        ],
        'covariance_share': calibration.explained_variance,
        'notes': list(calibration.notes),
    }


def show(calibration: Calibration, summary: dict[str, Any], console: Console) -> None:
    """Print the summary for people."""
    table = Table(title='Recordings')
    for column in ('recording', 'load', 'frames', 'rms (mm)', 'chi2 per coordinate'):
        table.add_column(column, justify='left' if column in ('recording', 'load') else 'right')
    for row in summary['recordings']:
        table.add_row(
            row['name'],
            'loaded' if row['loaded'] else 'none',
            str(row['frames']),
            f'{millimeters(row["rms"]):.3f}',
            f'{row["chi_squared_per_coordinate"]:.2f}',
        )
    console.print(table)
    console.print(curvature_table(calibration))
    law = [row for row in summary['quantities'] if row['name'].startswith('moment_law.')]
    if law:
        console.print(law_table(calibration, law))
    if summary['laws']:
        table = Table(title='Moment laws on loaded recordings that were left out')
        table.add_column('law')
        table.add_column('rms (mm)', justify='right')
        for item in summary['laws']:
            table.add_row(item['kind'], f'{millimeters(item["rms"]):.3f}')
        console.print(table)
    for sentence in (*summary['left_out'], *summary['notes']):
        console.print(f'note: {sentence}')
    if summary['output'] is None:
        console.print(f'no model was written: {summary["status"]}')
    else:
        console.print(f'wrote {summary["output"]}')
    if summary['report'] is not None:
        console.print(f'wrote {summary["report"]}/index.html')


def law_table(calibration: Calibration, law: list[dict[str, Any]]) -> Table:
    """Return the constants of the moment law: over pressure where it has rows, else by name."""
    fitted = calibration.arm.moment_law
    found = {row['name']: f'{row["value"]:.4g} +- {row["std"]:.1g}' for row in law}
    table = Table(title=f'Moment law, {fitted.kind}')
    if not isinstance(fitted, PiecewiseLinearLaw):
        for column in ('quantity', 'value'):
            table.add_column(column)
        for name, text in found.items():
            table.add_row(name, text)
        return table
    for column in ('pressure (kPa)', 'alpha1', 'alpha2', 'l1 / l'):
        table.add_column(column, justify='right')
    for row, pressure in enumerate(fitted.pressure.tolist()):
        names = (f'rigidity.{row}.0', f'rigidity.{row}.1', f'split.{row}')
        texts = (found[f'moment_law.{name}'] for name in names)
        table.add_row(f'{kilopascals(pressure):.1f}', *texts)
    return table


def curvature_table(calibration: Calibration) -> Table:
    """Return kappa_p0 at every pressure in the middle and its largest standard error."""
    fit = calibration.joint
    rows, knots = fit.parameters.pressure, fit.parameters.arclength
    cells = fit.parameters.cells
    values = fit.values[:cells].reshape(rows.size, knots.size)
    std = np.sqrt(np.diag(fit.covariance)[:cells]).reshape(rows.size, knots.size)
    table = Table(title='Intrinsic curvature kappa_p0 (1/m)')
    for column in ('pressure (kPa)', 'clamp', 'middle', 'tip', 'standard error, middle and worst'):
        table.add_column(column, justify='right')
    middle = knots.size // 2
    for pressure, row, error in zip(rows.tolist(), values, std, strict=True):
        table.add_row(
            f'{kilopascals(pressure):.1f}',
            *(f'{row[place]:.2f}' for place in (0, middle, -1)),
            f'{error[middle]:.2f}, {error.max():.2f}',
        )
    return table

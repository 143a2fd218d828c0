"""Effect of elongation under pressure in measurements of 27 pneumatic bending actuators.

    python acceptance/real_data.py [--json] [--data TABLE.csv] [--picture FILE.png] [--overwrite]

The table (`../shared/data/modular_stiffness.csv` beside the checkout, not part of the project)
holds the tip of every actuator at up to nine pressures, without end force. Each is fitted by an
`Arm` of curvature uniform in s, with and without the effect `pressure_elongation`, and predicts
the tips at the pressures between the first and the last, each left out of the fit in turn.

A tip that bends along a circle at constant length has one curve to be on, whatever the pressure.
What it misses of the measured tips even with the best curvature at each of them is the error that
no calibration of curvature can remove: 10.9 % of the length. This is the score before; the one
after must be at most 0.6 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
import json
from pathlib import Path
import platform

import numpy as np
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.files.atomic import atomic_output
from real_data_fit import (
    Actuator,
    ASSUMED,
    DATA,
    LENGTH,
    MODELS,
    pressure_errors,
    PRESSURE_UNIT,
    read_actuators,
    Score,
    scored,
)
from real_data_picture import draw
from rich.console import Console
from rich.progress import track
from rich.table import Table

BEFORE, AFTER = 10.9, 0.6  # % of the length: known without elongation; at most, with it


def measured(actuators: Iterable[Actuator]) -> tuple[list[dict[str, Score]], dict]:
    """Scores per actuator and model, and all of it as numbers."""
    scores, rows = [], []
    for actuator in actuators:
        score = {model: scored(actuator, model) for model in MODELS}
        errors, share = pressure_errors(actuator, score['quadratic'])
        scores.append(score)
        rows.append(
            {
                'actuator': actuator.name,
                'pressures': actuator.pressure.size,
                'models': {model: item.numbers() for model, item in score.items()},
                'pressure_errors_pa': errors.tolist(),
                'pressure_error_rms_pa': float(np.sqrt(np.mean(errors**2))),
                'share_of_pressure_error': share,
            }
        )
    return scores, {'actuators': rows, 'summary': summary(rows)}


def summary(rows: Sequence[dict]) -> dict[str, dict[str, float]]:
    """Mean, median and largest over the actuators, of every number of every model."""
    lists = {
        f'{model}.{name}': [row['models'][model][name] for row in rows]
        for model in MODELS
        for name in rows[0]['models'][model]
    }
    for name in ('pressure_error_rms_pa', 'share_of_pressure_error'):
        lists[name] = [row[name] for row in rows]
    functions = {'mean': np.mean, 'median': np.median, 'largest': np.max}
    return {
        name: {key: float(function(values)) for key, function in functions.items()}
        for name, values in lists.items()
    }


def show(result: dict) -> None:
    """Print a table and what it comes to."""
    table = Table(title='error of the tip, % of the length: mean, rms', caption=ASSUMED)
    table.add_column('actuator')
    table.add_column('rows', justify='right')
    heads = {
        'best_curvature.fitted': 'best curvature\nat each p',
        'without.left_out': 'without\nleft out',
        'linear.fitted': 'linear\nfitted',
        'linear.left_out': 'linear\nleft out',
        'quadratic.fitted': 'quadratic\nfitted',
        'quadratic.left_out': 'quadratic\nleft out',
    }
    for head in heads.values():
        table.add_column(head, justify='right')
    for row in result['actuators']:
        cells = []
        for key in heads:
            model, kind = key.split('.')
            numbers = row['models'][model]
            cells.append(f'{numbers[f"{kind}_mean"]:.2f} {numbers[f"{kind}_rms"]:5.2f}')
        table.add_row(row['actuator'], str(row['pressures']), *cells)
    found = result['summary']
    table.add_section()
    for what in ('mean', 'median', 'largest'):
        cells = [f'{found[f"{k}_mean"][what]:.2f} {found[f"{k}_rms"][what]:5.2f}' for k in heads]
        table.add_row(what, '', *cells)
    console = Console(width=110, highlight=False)
    console.print(table)
    console.print(
        f'Without elongation, the best constant curvature at each pressure misses the tip by '
        f'{found["best_curvature.fitted_mean"]["mean"]:.1f} % of the length ({BEFORE} known). '
        f'With elongation linear in p, a pressure left out is predicted to '
        f'{found["linear.left_out_mean"]["mean"]:.2f} % (at most {AFTER} wanted), quadratic to '
        f'{found["quadratic.left_out_mean"]["mean"]:.2f} %. Errors of the recorded pressure of '
        f'{found["pressure_error_rms_pa"]["mean"]:.0f} Pa would explain '
        f'{found["share_of_pressure_error"]["mean"]:.0%} of what the quadratic fit leaves.'
    )


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--data', type=Path, default=DATA, help=f'the table (default: {DATA})')
    command.add_argument('--picture', type=Path, help='write a figure, such as FILE.png')
    command.add_argument('--overwrite', action='store_true', help='overwrite an existing figure')
    arguments = command.parse_args()
    try:
        actuators = read_actuators(arguments.data)
        shown = track(actuators, 'fitting', console=Console(stderr=True), transient=True)
        if arguments.picture is None:
            _, result = measured(shown)
        else:
            path, inputs = arguments.picture, [arguments.data]
            with atomic_output(path, overwrite=arguments.overwrite, inputs=inputs) as temporary:
                scores, result = measured(shown)
                draw(actuators, scores, temporary, (BEFORE, AFTER), ASSUMED)
    except PneunetError as error:
        command.exit(2, f'{error}\n')
    if arguments.json:
        machine = {'machine': platform.machine(), 'python': platform.python_version()}
        assumed = {'pascal_per_unit': PRESSURE_UNIT, 'length_m': LENGTH, 'note': ASSUMED}
        wanted = {'best_curvature.fitted_mean': BEFORE, 'linear.left_out_mean': AFTER}
        notes = {'assumed': assumed, 'errors': '% of the length', 'wanted': wanted}
        print(json.dumps({'bench': 'real_data', **machine, **notes, **result}))
    else:
        show(result)


if __name__ == '__main__':
    main()

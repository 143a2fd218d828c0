"""Cross-validation over pressures of real actuators, calibrated from the tip alone.

    python acceptance/left_out_real.py [--json] [--data TABLE.csv] [--noise PERCENT]

Every actuator of `acceptance/real_data.py` is one static recording of its tip. What `calibrate`
prints of pressures that it left out is compared with its baselines, and so is the model that
`diagnose` makes of it, told nothing, fitted again without each of these pressures.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
import json
from pathlib import Path

import numpy as np
from pneunet_ros.calibration.calibration import calibrate, Calibration
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from real_data_diagnosis import model, NOISE, recorded
from real_data_fit import Actuator, DATA, LENGTH, missed, read_actuators, tips
from rich.console import Console
from rich.progress import track

AS_WELL = 1.1  # times the better baseline


def diagnosed_error(actuator: Actuator, noise: float) -> float:
    """Return the rms error (% of the length) of diagnosed models at pressures left out of them."""
    every, errors = np.arange(actuator.pressure.size), []
    for row in every[1:-1].tolist():
        run = replace(recorded(actuator, np.delete(every, row)), static=True)
        found = diagnose(calibrate([run], [], model(actuator, noise)).arm, [run], [])
        if isinstance(found, Diagnosis):
            predicted = tips(found.after.arm, actuator.pressure[[row]])
            errors.append(float(missed(actuator, predicted, np.array([row]))[0]))
    return float(np.sqrt(np.mean(np.square(errors)))) if errors else float('nan')


def fitted_row(run: RecordingData, arm: Arm, scale: float) -> dict:
    """Return the row of a recording, also of one that cannot be calibrated."""
    try:
        return row_of(calibrate([run], [], arm), scale)
    except PneunetError as error:
        return {'answered': False, 'beaten': False, 'says': str(error)}


def row_of(calibration: Calibration, scale: float) -> dict:
    """Return the errors at pressures left out, times a scale, and whether that is an answer.

    It is one if the model does as well as the better baseline, or a note says that it does not.
    """
    found, notes = calibration.left_out, {note.reason for note in calibration.notes}
    if found is None:
        return {'answered': False, 'beaten': False}
    beaten = found.model > AS_WELL * min(found.arc, found.interpolation)
    return {
        'pressures': found.levels + 2,
        'model': scale * found.model,
        'arc': scale * found.arc,
        'interpolation': scale * found.interpolation,
        'says': found.better,
        'beaten': beaten,
        'answered': not beaten or 'better_without_model' in notes,
    }


def count_sentence(rows: list[dict]) -> str:
    """Say how many rows are answered, and by how many of them a baseline is better."""
    answered, beaten = (sum(row[name] for row in rows) for name in ('answered', 'beaten'))
    return (
        f'{answered} of {len(rows)} answered; in {beaten} a baseline is better by more than '
        f'{100.0 * (AS_WELL - 1.0):.0f} %'
    )


def measured(actuators: Iterable[Actuator], noise: float, *, diagnosed: bool) -> list[dict]:
    """Return a row per actuator; errors are rms, % of the length."""
    rows = []
    for actuator in actuators:
        run = replace(recorded(actuator, np.arange(actuator.pressure.size)), static=True)
        row = fitted_row(run, model(actuator, noise), 100.0 / LENGTH)
        row |= {'actuator': actuator.name, 'pressures': int(actuator.pressure.size)}
        if diagnosed:
            row['diagnosed'] = diagnosed_error(actuator, noise)
        rows.append(row)
    return rows


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--data', type=Path, default=DATA, help=f'the table (default: {DATA})')
    command.add_argument(
        '--noise', type=float, default=NOISE, help='noise of a tip, %% of the length'
    )
    command.add_argument('--diagnose', action='store_true', help='also run a diagnosis (minutes)')
    arguments = command.parse_args()
    try:
        actuators = read_actuators(arguments.data)
    except PneunetError as error:
        command.exit(2, f'{error}\n')
    shown = track(actuators, 'fitting', console=Console(stderr=True), transient=True)
    rows = measured(shown, arguments.noise, diagnosed=arguments.diagnose)
    if arguments.json:
        print(json.dumps({'bench': 'left_out_real', 'rows': rows}))
        return
    for row in rows:
        print(row)
    known = [row for row in rows if 'model' in row]
    for name in ('model', 'arc', 'interpolation', 'diagnosed'):
        values = [row[name] for row in known if name in row]
        if values:
            print(f'{name}: mean {np.mean(values):.2f}, largest {np.max(values):.2f} % of length')
    print(count_sentence(rows))


if __name__ == '__main__':
    main()

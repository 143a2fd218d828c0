"""Convergence and accuracy of calibration from 3 to 9 frames of clamp and tip.

    python acceptance/few_frames.py [--json] [--data TABLE.csv] [--noise PERCENT] [--actuators N]

From every actuator of `acceptance/real_data.py` so many of its pressures are taken, evenly, the
first and the last among them: a recording of two targets, static and without a load, which
`calibrate` turns into a model of constant curvature. What that model lacks is what `diagnose`
finds, told nothing; the model that it gives predicts the tips at the pressures that were left out.
There are no holds or repeats in the table, so the noise of a tip is given by the user.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
import json
from pathlib import Path

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
from pneunet_ros.calibration.calibration import calibrate
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.files.json_text import plain
from real_data_diagnosis import model, NOISE, recorded, WANTED
from real_data_fit import Actuator, ASSUMED, DATA, missed, read_actuators, tips
from rich.console import Console
from rich.progress import track
from rich.table import Table

SIZES = range(3, 10)  # frames


@dataclass(frozen=True, slots=True, kw_only=True)
class FewFrames:
    """A calibration from a few frames, and the diagnosis of it.

    constant: whether the curvature is the same all along the arm. Errors are mean distances of
    predicted from measured tips, % of the length, at the pressures that were left out; NaN where
    none was: of the calibrated model, and of the one that the diagnosis gives.
    """

    actuator: str
    frames: int
    converged: bool
    constant: bool
    answer: str
    effects: tuple[str, ...]
    calibrated: float
    diagnosed: float

    @property
    def right(self) -> bool:
        """Whether elongation under pressure is named, and nothing else."""
        return self.effects == (WANTED,)


def chosen_rows(actuator: Actuator, count: int) -> np.ndarray:
    """Return so many of the pressures, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, actuator.pressure.size - 1, count).round().astype(int))


def tried(actuator: Actuator, count: int, noise: float) -> FewFrames:
    """Calibrate from so many frames, diagnose, and predict the pressures left out."""
    rows = chosen_rows(actuator, count)
    run = replace(recorded(actuator, rows), static=True)
    calibration = calibrate([run], [], model(actuator, noise))
    found = diagnose(calibration.arm, [run], [])
    left_out = np.setdiff1d(np.arange(actuator.pressure.size), rows)
    settled = isinstance(found, Diagnosis)
    arms = [calibration.arm, *([found.after.arm] if settled else [])]
    errors = [np.nan, np.nan]
    for place, arm in enumerate(arms if left_out.size else []):
        predicted = tips(arm, actuator.pressure[left_out])
        errors[place] = float(np.mean(missed(actuator, predicted, left_out)))
    table = calibration.arm.intrinsic_curvature.curvature
    return FewFrames(
        actuator=actuator.name,
        frames=count,
        converged=calibration.joint.converged,
        constant=bool(np.all(np.ptp(table, axis=1) == 0.0)),
        answer=found.answer,
        effects=tuple(item.name for item in found.effects) if settled else (),
        calibrated=errors[0],
        diagnosed=errors[1],
    )


def measured(actuators: Iterable[Actuator], noise: float) -> list[FewFrames]:
    """Try all sizes that an actuator has pressures for."""
    return [
        tried(actuator, count, noise)
        for actuator in actuators
        for count in SIZES
        if count <= actuator.pressure.size
    ]


def summary(results: Sequence[FewFrames]) -> list[dict]:
    """Return a row per number of frames."""
    rows = []
    for count in SIZES:
        those = [item for item in results if item.frames == count]
        if not those:
            continue
        row = {
            'frames': count,
            'sets': len(those),
            'converged': sum(item.converged and item.constant for item in those),
            'right': sum(item.right for item in those),
        }
        for name in ('calibrated', 'diagnosed'):
            values = [getattr(item, name) for item in those]
            known = [value for value in values if np.isfinite(value)]
            row[name] = float(np.mean(known)) if known else None
            row[f'{name}_largest'] = max(known) if known else None
        rows.append(row)
    return rows


def show(results: Sequence[FewFrames], noise: float) -> None:
    """Print a table and what it comes to."""
    note = f'{ASSUMED}; given: noise of a tip {noise:g} % of the length'
    table = Table(title='left-out pressures, mean (largest), % of the length', caption=note)
    heads = ('frames', 'settled', 'elongation alone', 'calibrated', 'after diagnosis')
    for head in heads:
        table.add_column(head, justify='right')
    for row in summary(results):
        errors = [
            '-' if row[name] is None else f'{row[name]:.2f} ({row[f"{name}_largest"]:.2f})'
            for name in ('calibrated', 'diagnosed')
        ]
        counts = [f'{row[name]} of {row["sets"]}' for name in ('converged', 'right')]
        table.add_row(str(row['frames']), *counts, *errors)
    console = Console(width=110, highlight=False)
    console.print(table)
    others = sorted({item.effects for item in results if not item.right})
    if others:
        said = ', '.join(' + '.join(names) or 'nothing' for names in others)
        console.print(f'Other answers: {said}.')


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--data', type=Path, default=DATA, help=f'the table (default: {DATA})')
    command.add_argument(
        '--noise', type=float, default=NOISE, help='noise of a tip, %% of the length (%(default)s)'
    )
    command.add_argument('--actuators', type=int, help='number of actuators (default: all)')
    arguments = command.parse_args()
    try:
        actuators = read_actuators(arguments.data)[: arguments.actuators]
        shown = track(actuators, 'calibrating', console=Console(stderr=True), transient=True)
        results = measured(shown, arguments.noise)
    except PneunetError as error:
        command.exit(2, f'{error}\n')
    if arguments.json:
        rows = [{**asdict(item), 'right': item.right} for item in results]
        result = {'assumed': ASSUMED, 'noise_percent': arguments.noise, 'sets': rows}
        print(json.dumps(plain(result | {'summary': summary(results)})))
    else:
        show(results, arguments.noise)


if __name__ == '__main__':
    main()

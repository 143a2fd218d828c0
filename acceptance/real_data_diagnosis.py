"""Diagnosis of 27 real actuators with a model of curvature only.

    python acceptance/real_data_diagnosis.py [--json] [--data TABLE.csv] [--noise PERCENT]

Every actuator of `acceptance/real_data.py` is one recording of two targets, the clamp and the tip,
without a load, and its model an arm of constant curvature whose dependence on pressure is free.
`diagnose` is not told what to look for: all effects of the library compete. Printed are the
answer, the gap of the tips before and after, and the same where every third pressure is held out
of all fits. There are no holds or repeats in the table, so the noise is given by the user.

The table tells nothing of time: frames are put 10 s apart, which is invented.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
import json
from pathlib import Path
import platform

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

import numpy as np
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.exploration.proposal import diagnose
from pneunet_ros.files.json_text import plain
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import SensorNoise
from real_data_fit import Actuator, arm_of, ASSUMED, DATA, LENGTH, missed, read_actuators, tips
from rich.console import Console
from rich.progress import track
from rich.table import Table

NOISE = 0.3  # % of the length, of a tip, per coordinate; given, not measured
PERIOD = 10_000_000_000  # ns between frames; invented, slow enough for an arm at rest
KEPT_OUT = slice(2, -1, 3)  # of the pressures: every third between the first and the last
WANTED = 'pressure_elongation'
BEFORE, AFTER = 10.9, 0.6  # % of the length: known without elongation; at most, with it


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """Mean distance of predicted from measured tips, % of the length, before and after."""

    before: float
    after: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What was found in one actuator: from all its pressures, and with some held out.

    fitted: gap at all pressures above zero; held_out: at those held out of a second diagnosis,
    which gave the answer `answer_of_rest` and the effects `effects_of_rest`.
    """

    actuator: str
    pressures: int
    answer: str
    effects: tuple[str, ...]
    alternatives: tuple[str, ...]
    strain_per_pascal: float | None
    strain_per_pascal_std: float | None
    fitted: Gap
    answer_of_rest: str
    effects_of_rest: tuple[str, ...]
    held_out: Gap

    @property
    def right(self) -> bool:
        """Whether elongation under pressure is the answer, or in the set of answers."""
        return self.answer in ('named', 'inseparable') and WANTED in (
            *self.effects,
            *self.alternatives,
        )


def model(actuator: Actuator, noise: float) -> Arm:
    """Return the arm to diagnose: constant curvature; noise of a tip in % of the length."""
    sensors = SensorNoise(
        pressure_std=0.0, force_std=0.0, moment_std=0.0, target_std=0.01 * noise * LENGTH
    )
    straight = arm_of(actuator, 'without', np.zeros(2))
    return replace(straight, target_arclength=np.array([0.0, LENGTH]), sensors=sensors)


def recorded(actuator: Actuator, rows: np.ndarray) -> RecordingData:
    """Return the recording of some of the rows: clamp and tip, nothing attached."""
    stamps, zeros = PERIOD * (1 + rows), np.zeros(rows.size)
    return RecordingData(
        name=actuator.name,
        reading_stamp_ns=stamps,
        pressure=actuator.pressure[rows],
        stamp_ns=stamps,
        reading=np.arange(rows.size),
        loaded=False,
        force=np.zeros((rows.size, 2)),
        moment=zeros,
        x=np.stack([zeros, actuator.tip[rows, 0]], axis=1),
        y=np.stack([zeros, actuator.tip[rows, 1]], axis=1),
    )


def diagnosed(actuator: Actuator, noise: float) -> Found:
    """Diagnose one actuator, from all of its pressures and with some held out."""
    every = np.arange(actuator.pressure.size)
    kept_out = every[KEPT_OUT]
    frame = model(actuator, noise)
    whole = diagnose(frame, [recorded(actuator, every)], [])
    rest = diagnose(
        frame, [recorded(actuator, np.setdiff1d(every, kept_out))], [recorded(actuator, kept_out)]
    )
    numbers = {item.name: item.parameters for item in whole.effects}.get(WANTED)
    strain = None if numbers is None else numbers['strain_per_pascal']
    return Found(
        actuator=actuator.name,
        pressures=every.size,
        answer=whole.answer,
        effects=tuple(item.name for item in whole.effects),
        alternatives=whole.alternatives,
        strain_per_pascal=None if strain is None else strain.value,
        strain_per_pascal_std=None if strain is None else strain.std,
        fitted=gap(actuator, whole, every[1:]),
        answer_of_rest=rest.answer,
        effects_of_rest=tuple(item.name for item in rest.effects),
        held_out=gap(actuator, rest, kept_out),
    )


def gap(actuator: Actuator, found: Diagnosis, rows: np.ndarray) -> Gap:
    """Return how far the tips at some pressures are from the models before and after."""
    errors = []
    for side in (found.before, found.after):
        predicted = tips(side.arm, actuator.pressure[rows])
        errors.append(float(np.mean(missed(actuator, predicted, rows))))
    return Gap(before=errors[0], after=errors[1])


def summary(found: list[Found]) -> dict:
    """Return counts of answers, and mean and largest gap over the actuators."""
    out = {
        'answers': dict(Counter(item.answer for item in found)),
        'effects': dict(Counter(' + '.join(item.effects) or '-' for item in found)),
        'right': sum(item.right for item in found),
        'actuators': len(found),
    }
    for name in ('fitted', 'held_out'):
        gaps = [getattr(item, name) for item in found]
        for end in ('before', 'after'):
            values = [getattr(item, end) for item in gaps]
            out[f'{name}_{end}'] = {'mean': np.mean(values), 'largest': np.max(values)}
    return out


def show(found: list[Found], noise: float) -> None:
    """Print a table and what it comes to."""
    note = f'{ASSUMED}; given: noise of a tip {noise:g} % of the length'
    table = Table(title='gap of the tips, mean, % of the length', caption=note)
    for head in ('actuator', 'rows', 'answer', 'strain\n1e-6/Pa', 'fitted\nbefore', 'after'):
        table.add_column(head, justify='left' if head in ('actuator', 'answer') else 'right')
    for head in ('held out\nbefore', 'after'):
        table.add_column(head, justify='right')
    for item in found:
        size = '-'
        if item.strain_per_pascal is not None:
            size = f'{1e6 * item.strain_per_pascal:.2f} ± {1e6 * item.strain_per_pascal_std:.2f}'
        said = ' or '.join([' + '.join(item.effects), *item.alternatives]) or item.answer
        gaps = [
            f'{value:.2f}'
            for one in (item.fitted, item.held_out)
            for value in asdict(one).values()
        ]
        table.add_row(item.actuator, str(item.pressures), said, size, *gaps)
    result = summary(found)
    console = Console(width=110, highlight=False)
    console.print(table)
    answers = ', '.join(f'{name} {count}' for name, count in result['answers'].items())
    fitted = [result[f'fitted_{end}'] for end in ('before', 'after')]
    held_out = [result[f'held_out_{end}'] for end in ('before', 'after')]
    console.print(
        f'Answers: {answers}; {WANTED} in {result["right"]} of {result["actuators"]}. '
        f'The gap falls from {fitted[0]["mean"]:.1f} % ({BEFORE} known) to '
        f'{fitted[1]["mean"]:.2f} % (at most {AFTER} wanted; largest {fitted[1]["largest"]:.2f}), '
        f'and at pressures held out from {held_out[0]["mean"]:.1f} to {held_out[1]["mean"]:.2f} % '
        f'(largest {held_out[1]["largest"]:.2f}).'
    )


def measured(actuators: Iterable[Actuator], noise: float) -> list[Found]:
    """Diagnose actuators one after the other."""
    return [diagnosed(item, noise) for item in actuators]


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--json', action='store_true', help='print one JSON object')
    command.add_argument('--data', type=Path, default=DATA, help=f'the table (default: {DATA})')
    command.add_argument(
        '--noise',
        type=float,
        default=NOISE,
        help='noise of a tip, %% of the length (default: %(default)s)',
    )
    arguments = command.parse_args()
    try:
        actuators = read_actuators(arguments.data)
        shown = track(actuators, 'diagnosing', console=Console(stderr=True), transient=True)
        found = measured(shown, arguments.noise)
    except PneunetError as error:
        command.exit(2, f'{error}\n')
    if arguments.json:
        machine = {'machine': platform.machine(), 'python': platform.python_version()}
        notes = {'assumed': ASSUMED, 'noise_percent': arguments.noise, 'gaps': '% of the length'}
        rows = [{**asdict(item), 'right': item.right} for item in found]
        result = {'actuators': rows, 'summary': summary(found)}
        print(json.dumps(plain({'bench': 'real_data_diagnosis', **machine, **notes, **result})))
    else:
        show(found, arguments.noise)


if __name__ == '__main__':
    main()

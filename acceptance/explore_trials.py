"""Number of recordings that `pneunet explore` needs to find the right name, in blind trials.

    python acceptance/explore_trials.py FILE.jsonl [--trials 60] [--first SEED] [--fixed]

Every trial hides one effect of the library, of one of the three largest of six sizes, in an arm of
the virtual lab whose parameters differ by up to 15 %; 0.3 % of departure from any law is always
there, and effects are richer than their plain laws. The arm is asked recording by recording, 8 at
most. `--fixed` takes the experiments in the order of their list instead of choosing. Trials that
stand in the file are not made again. Truth and answer go into one line, but the search sees
recordings alone.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory
import time
import zlib

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

from dataclasses import replace

from blind.designs import NOISE, RATES
from blind.hidden import hidden_effect, HIDEABLE, MISMATCH
import numpy as np
from pneunet_ros import load_model
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.share import share_path
from pneunet_ros.exploration.experiment_design import Experiment
from pneunet_ros.exploration.exploration import explore
from pneunet_ros.exploration.safe_set import SafeSet
from pneunet_ros.exploration.settings import EXPLORATION, ExplorationSettings
from pneunet_ros.files.scenario_file import load_scenario
from pneunet_ros.lab.lab_arm import vary_arm
from pneunet_ros.lab.scenario import Detail, Scenario
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.offline.simulated_arm import SimulatedArm
from pneunet_ros.recordings.dataset_reader import read_run
from rich.console import Console
from rich.table import Table

SAFE = SafeSet(low=0.0, high=55e3, force=0.25)


def hidden_arm(seed: int) -> tuple[str, Scenario]:
    """Return the name of what is hidden, and the arm as a scenario."""
    random = np.random.default_rng([zlib.crc32(b'explore'), seed])
    names = list(HIDEABLE)
    name = names[seed % len(names)]
    shipped = load_scenario(share_path('scenarios/random_mix.yaml'))
    scenario = replace(
        shipped,
        seed=seed,
        arm=vary_arm(shipped.arm, int(random.integers(1, 2**31))),
        noise=NOISE,
        rates=RATES,
        detail=Detail(elements=200.0),
    )
    hidden = {
        name: hidden_effect(name, int(random.integers(3, 6)), random),
        'harmless_mismatch': {'size': MISMATCH, 'phase': random.uniform(-3.0, 3.0)},
    }
    return name, scenario.with_effects(hidden)


def tried(seed: int, fixed: bool, settings: ExplorationSettings) -> dict:
    """Make one trial; return its row."""
    name, scenario = hidden_arm(seed)
    arm = SimulatedArm(scenario=scenario)
    frame = replace(
        load_model(share_path('config/paper_arm.yaml')), target_arclength=scenario.arm.targets
    )
    started = time.process_time()
    rounds, failed = [], ''
    with TemporaryDirectory() as place:

        def record(experiment: Experiment, safe: SafeSet, number: int) -> RecordingData:
            path = Path(place) / f'recording_{number + 1:02d}.mcap'
            arm.record(experiment, safe, path)
            return read_run(path, frame.target_arclength.size)[0]

        try:
            for step in explore(frame, record, SAFE, in_order=fixed, settings=settings):
                found = step.investigation.diagnosis
                diagnosis = step.diagnosis
                rounds.append(
                    {
                        'words': step.choice.experiment.words,
                        'answer': found.answer,
                        'effects': [item.name for item in getattr(found, 'effects', ())],
                        'alternatives': list(getattr(found, 'alternatives', ())),
                        'rms': None
                        if diagnosis is None
                        else [diagnosis.before.rms, diagnosis.after.rms],
                    }
                )
        except PneunetError as error:
            failed = str(error)
    return {
        'key': f'{seed}{"/fixed" if fixed else ""}',
        'seed': seed,
        'fixed': fixed,
        'hidden': name,
        'rounds': rounds,
        'failed': failed,
        'cpu_s': round(time.process_time() - started, 1),
    }


def verdict(row: dict) -> str:
    """Return what became of a trial."""
    last = row['rounds'][-1] if row['rounds'] else {'answer': 'failed', 'effects': []}
    if row['failed']:
        return 'failed'
    if last['answer'] == 'named':
        right = row['hidden'] in last['effects']
        return ('right' if len(last['effects']) == 1 else 'with another') if right else 'wrong'
    return last['answer']


def show(rows: list[dict]) -> None:
    """Print what they come to."""
    table = Table()
    for head in ('protocol', 'verdict', 'trials', 'recordings: median', 'largest'):
        table.add_column(head, justify='left' if head in ('protocol', 'verdict') else 'right')
    for fixed in (False, True):
        those = [row for row in rows if row['fixed'] == fixed]
        verdicts = [verdict(row) for row in those]
        for kind in sorted(set(verdicts)):
            counts = [
                len(row['rounds'])
                for row, said in zip(those, verdicts, strict=True)
                if said == kind
            ]
            table.add_row(
                'in order' if fixed else 'chosen',
                kind,
                str(len(counts)),
                f'{np.median(counts):g}',
                str(max(counts)),
            )
        if those:
            # A trial without the right name needed more than there were.
            needed = [
                len(row['rounds']) if said == 'right' else np.inf
                for row, said in zip(those, verdicts, strict=True)
            ]
            cpu = np.mean([row['cpu_s'] for row in those])
            table.add_row('', f'until the right name (cpu {cpu:.0f} s a trial)', str(len(those)),
                          f'{np.median(needed):g}', '')  # fmt: skip
    Console(width=100, highlight=False).print(table)


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('file', type=Path)
    command.add_argument('--trials', type=int, default=60)
    command.add_argument('--first', type=int, default=1)
    command.add_argument('--fixed', action='store_true')
    command.add_argument('--most', type=int, default=EXPLORATION.recordings)
    arguments = command.parse_args()
    known = arguments.file.read_text().splitlines() if arguments.file.exists() else []
    rows = [json.loads(line) for line in known]
    done = {row['key'] for row in rows}
    settings = replace(EXPLORATION, recordings=arguments.most)
    for seed in range(arguments.first, arguments.first + arguments.trials):
        if f'{seed}{"/fixed" if arguments.fixed else ""}' in done:
            continue
        row = tried(seed, arguments.fixed, settings)
        rows.append(row)
        with arguments.file.open('a') as file:
            file.write(json.dumps(row) + '\n')
    show(rows)


if __name__ == '__main__':
    main()

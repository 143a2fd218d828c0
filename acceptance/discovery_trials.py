"""Blind trials of discovery, with hidden causes outside the library, or none.

    python acceptance/discovery_trials.py [--block causes clean named] [--cause NAME ...]
        [--sizes N] [--seeds N] [--first SEED] [--output FILE.jsonl] [--json]

Blocks: `causes` of `unnamed/causes.py`, `clean` recordings, and `named`: an effect of the library
that is there to be named, beside which nothing is to be found. A file goes on where it stopped.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
import json
import math
from pathlib import Path
import sys
import time
from typing import Any
import zlib

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

from blind.hidden import hidden_effect, HIDEABLE, MISMATCH
from blind.scoring import Z_95
from blind.trials import Label, recorded, Trial
import numpy as np
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.diagnosis.diagnosis import investigate
from pneunet_ros.diagnosis.result import Diagnosis
from pneunet_ros.diagnosis.settings import DEFAULTS
from pneunet_ros.discovery.discovery import discover
from pneunet_ros.effects import EFFECTS
from pneunet_ros.files.json_text import json_text
from rich.console import Console
from rich.table import Table
from unnamed.causes import add_causes, Cause, CAUSES

Row = dict[str, Any]
BLOCKS = ('causes', 'clean', 'named')
ABOVE = 3.0  # times the threshold of the lack-of-fit test: from there on a cause should be found


def wanted(arguments: argparse.Namespace) -> Iterator[tuple[str, str, int, int]]:
    """Yield block, name, step of the size and seed of all trials asked for."""
    for seed in range(arguments.first, arguments.first + arguments.seeds):
        for block in arguments.block:
            names = {'causes': arguments.cause, 'clean': ['clean'], 'named': list(HIDEABLE)}
            for name in names[block]:
                steps = arguments.step or range(arguments.sizes)
                steps = steps if block == 'causes' else [3]
                for step in steps:
                    yield block, name, step, seed


def label_of(block: str, name: str, step: int, seed: int, sizes: int) -> Label:
    """Draw what is hidden in a trial."""
    key = f'discovery/{block}/{name}/{step}'
    random = np.random.default_rng([zlib.crc32(key.encode()), seed])
    outside = {'harmless_mismatch': {'size': MISMATCH, 'phase': random.uniform(-3.0, 3.0)}}
    effects = {name: hidden_effect(name, step, random)} if block == 'named' else {}
    if block == 'causes':
        cause = CAUSES[name]
        parameter, weakest, strongest = cause.size
        size = weakest * (strongest / weakest) ** (step / max(sizes - 1, 1))
        values = {parameter: size, **dict(cause.fixed)}
        if cause.place:
            values[cause.place] = random.uniform(0.25, 0.85)
        outside[name] = values
    return Label(
        block=key,
        seed=seed,
        design='full',
        effects=effects,
        outside=outside,
        arm_seed=int(random.integers(1, 2**31)),
        elements=int(random.integers(160, 321)),
    )


def answer_of(trial: Trial, withheld: tuple[str, ...]) -> Row:
    """Return what diagnosis and discovery say of a trial."""
    started = time.process_time()
    known = tuple(name for name in withheld if name in EFFECTS)
    settings = replace(DEFAULTS, withheld=known)
    row: Row = {'answer': 'failed', 'found': [], 'notes': [], 'closed': None, 'excess': 0.0}
    try:
        investigation = investigate(trial.frame, trial.training, trial.held_out, settings=settings)
        found = discover(investigation)
    except PneunetError as error:
        return row | {'notes': [str(error)], 'seconds': time.process_time() - started}
    diagnosis = investigation.overruled(found.overruling).diagnosis
    row['overruled'] = found.overruling is not None
    row['answer'] = diagnosis.answer
    if isinstance(diagnosis, Diagnosis):
        test = diagnosis.adequacy_before
        row['excess'] = test.statistic / test.threshold
        row['effects'] = [effect.name for effect in diagnosis.effects]
    row['found'] = [
        {
            'kind': law.kind,
            'tied': list(law.tied_with),
            'terms': [item.name for item in law.covariates] + (['period'] if law.time_law else []),
            'coefficients': [[item.coefficient, item.std] for item in law.covariates],
            'place': None if law.location is None else [law.location.value, law.location.std],
            'period': None
            if law.time_law is None or 'period' not in law.time_law.parameters
            else law.time_law.parameters['period'].value,
            'share': law.share,
            'sentence': law.sentence,
        }
        for law in found.found
    ]
    row |= {'notes': list(found.notes), 'closed': found.closed}
    return row | {'seconds': time.process_time() - started}


def one_trial(block: str, name: str, step: int, seed: int, sizes: int) -> Row:
    """Make a trial, let it be diagnosed without its label, and return both."""
    label = label_of(block, name, step, seed, sizes)
    try:
        _, trial = recorded(label)
    except PneunetError as error:
        return {'answer': 'not made', 'notes': [str(error)], 'found': [], 'excess': 0.0}
    cause = CAUSES.get(name)
    return answer_of(trial, cause.withheld if cause else ()) | {
        'truth': {key: dict(values) for key, values in (label.outside | label.effects).items()}
    }


def judge(row: Row) -> Row:
    """Return what of an answer is right."""
    cause: Cause | None = CAUSES.get(row['name'])
    law = row['found'][0] if row['found'] else None
    if cause is None or law is None:
        return {'given': law is not None}
    kinds = {law['kind'], *law['tied']}
    judged: Row = {
        'given': True,
        'in_set': bool(kinds & cause.kinds),
        'alone': law['kind'] in cause.kinds and not set(law['tied']) - cause.kinds,
        'term': bool(set(law['terms']) & cause.terms),
    }
    if cause.place and law['place'] is not None and law['kind'] in cause.kinds:
        judged['off'] = abs(law['place'][0] - row['truth'][row['name']][cause.place])
    right = [place for place, term in enumerate(law['terms']) if term in cause.terms]
    if math.isfinite(cause.coefficient) and right and law['kind'] in cause.kinds:
        # Of several plays a reader takes the sum: each side is a coarser or finer one of the same.
        parts = [law['coefficients'][place] for place in right]
        value, std = sum(part[0] for part in parts), math.hypot(*(part[1] for part in parts))
        true = cause.coefficient * row['truth'][row['name']][cause.size[0]]
        judged |= {'size_off': abs(value / true - 1.0), 'covered': abs(value - true) <= Z_95 * std}
    return judged


def summary_of(rows: list[Row]) -> Row:
    """Return rates over trials, of all causes and of each.

    A trial without an excess, as its diagnosis failed or did not settle, counts as one in which
    the cause should have been found.
    """
    out: Row = {'trials': len(rows), 'causes': {}}
    made = [row for row in rows if row['answer'] != 'not made']
    clean = [row for row in made if row['block'] != 'causes' and row['excess']]
    out['false_laws'] = sum(bool(row['found']) for row in clean)
    out['without_cause'] = len(clean)
    out['unsettled'] = sum(not row['excess'] for row in made)
    for name in ['all', *CAUSES]:
        own = [
            row
            for row in made
            if row['block'] == 'causes'
            and name in ('all', row['name'])
            and (not row['excess'] or row['excess'] > ABOVE)
        ]
        judged = [judge(row) for row in own]
        given = [item for item in judged if item['given']]
        off = [item['off'] for item in given if 'off' in item]
        sizes = [item['size_off'] for item in given if 'size_off' in item]
        closed = [row['closed'] for row in own if row.get('closed') is not None]
        out['causes'][name] = {
            'above': len(own),
            'unknown': sum(row['answer'] == 'unknown' for row in own),
            'given': len(given),
            'in_set': sum(item['in_set'] for item in given),
            'alone': sum(item['alone'] for item in given),
            'term': sum(item['term'] for item in given),
            'off': float(np.median(off)) if off else None,
            'size_off': float(np.median(sizes)) if sizes else None,
            'sizes': len(sizes),
            'covered': sum(item.get('covered', False) for item in given),
            'closed': float(np.median(closed)) if closed else None,
        }
    return out


def show(summary: Row) -> None:
    """Print for people."""
    console = Console()
    console.print(
        f'{summary["trials"]} trials; a law where none is: {summary["false_laws"]} of '
        f'{summary["without_cause"]}; did not settle, and count as above: {summary["unsettled"]}'
    )
    table = Table()
    columns = (
        'above', 'unknown', 'given', 'in_set', 'alone', 'term', 'off', 'size_off', 'sizes',
        'covered', 'closed',
    )  # fmt: skip
    for column in ('cause', *columns):
        table.add_column(column)
    for name, values in summary['causes'].items():
        texts = ['' if values[key] is None else f'{values[key]:.3g}' for key in columns]
        table.add_row(name, *texts)
    console.print(table)


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('--block', nargs='+', default=list(BLOCKS), choices=BLOCKS)
    command.add_argument('--cause', nargs='+', default=list(CAUSES), choices=list(CAUSES))
    command.add_argument('--sizes', type=int, default=5, help='sizes, from weakest to strongest')
    command.add_argument('--step', type=int, nargs='+', help='subset of the sizes (default: all)')
    command.add_argument('--seeds', type=int, default=4)
    command.add_argument('--first', type=int, default=1, help='first seed')
    command.add_argument('--output', type=Path, metavar='FILE.jsonl', help='resumable')
    command.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = command.parse_args()
    add_causes()
    rows: list[Row] = []
    if arguments.output is not None and arguments.output.exists():
        rows = [json.loads(line) for line in arguments.output.read_text().splitlines() if line]
    done = {(row['block'], row['name'], row['step'], row['seed']) for row in rows}
    for item in wanted(arguments):
        if item in done:
            continue
        block, name, step, seed = item
        row = one_trial(*item, arguments.sizes)
        rows.append({'block': block, 'name': name, 'step': step, 'seed': seed, **row})
        if arguments.output is not None:
            with arguments.output.open('a') as file:
                file.write(json_text(rows[-1]))
    summary = summary_of(rows)
    if arguments.json:
        sys.stdout.write(json_text({'bench': 'discovery_trials', **summary}))
    else:
        show(summary)


if __name__ == '__main__':
    main()

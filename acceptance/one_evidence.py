"""Comparison of two diagnosis engines on the same blind trials.

    python acceptance/one_evidence.py FILE.jsonl [--rounds 10] [--first SEED] [--block NAME ...]
                                      [--show]

A round is a single effect, one of `unnamed/causes.py`, a pair, nothing hidden (at 5 to 50 Hz), a
cause outside the library, and two sets of few static frames (one of an arm that gets longer). Rows
that stand in the file are not made again. The table ends with the exact test of each block: the
chance of so uneven a split of the trials that only one engine answered rightly.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
import json
from math import comb
from pathlib import Path
import time
from typing import Any

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':
    use_one_thread()

from blind.running import answered, truth_of
from blind.scoring import claims, detectable, exactly, size_of, within, wrong
from blind.trials import made, recorded, SCORING, Trial
from blind.visibility import shown_beside
from discovery_trials import label_of
from evidence import engine
from pneunet_ros.diagnosis import diagnosis as today
from pneunet_ros.diagnosis.investigation import Investigation
from pneunet_ros.diagnosis.settings import DEFAULTS, DiagnosisSettings
from pneunet_ros.discovery.discovery import discover
from pneunet_ros.effects import EFFECTS
from pneunet_ros.files.json_text import json_text
import static_frames
from unnamed.causes import add_causes, CAUSES

Row = dict[str, Any]
STEP, SIZES = 4, 5  # the strongest size of an unnamed cause
ROUND = ('rated_single', 'unnamed', 'rated_pairs', 'rated_nothing', 'outside', 'static')


def wanted(rounds: int, first: int, blocks: Sequence[str]) -> Iterator[tuple[str, int]]:
    """Yield block and seed."""
    for turn in range(rounds):
        for block in blocks:
            if block == 'static':
                yield block, SCORING + 2 * (first + turn)
                yield block, SCORING + 2 * (first + turn) + 1
            else:
                yield block, SCORING + first + turn


def by_today(trial: Trial, settings: DiagnosisSettings, kinds: list[str]) -> Investigation:
    """Diagnose as `pneunet diagnose` does."""
    found = today.investigate(trial.frame, trial.training, trial.held_out, settings=settings)
    law = discover(found)
    kinds += [name for item in law.found for name in (item.kind, *item.tied_with)]
    return found.overruled(law.overruling)


def by_evidence(trial: Trial, settings: DiagnosisSettings, kinds: list[str]) -> Investigation:
    """Diagnose by one evidence."""
    found, laws = engine.investigate(
        trial.frame, trial.training, trial.held_out, settings=settings
    )
    kinds += laws
    return found


ENGINES: dict[str, Callable[..., Investigation]] = {'today': by_today, 'evidence': by_evidence}


def static_trial(seed: int) -> Row:
    """Let both engines answer one of `static_frames`."""
    bench = static_frames.made(seed, seed)
    training, held_out = static_frames.recorded(bench, 2 * seed)
    trial = Trial(
        key=f'static/{seed}',
        frame=static_frames.model(bench),
        training=tuple(training),
        held_out=tuple(held_out),
    )
    row: Row = {'key': trial.key, 'block': 'static', 'right_kinds': []}
    row['truth'] = {'effects': {}, 'strain': bench.strain, 'uneven': bench.uneven, 'design': ''}
    for name, investigate in ENGINES.items():
        row[name], found = answer_by(investigate, trial, DEFAULTS)
        limit = getattr(found and found.diagnosis, 'detectable', {}).get(static_frames.WANTED)
        said = static_frames.Found(
            strain=bench.strain,
            uneven=bench.uneven,
            frames=len(training[0].stamp_ns),
            held_out=bench.held_out,
            static=bench.static,
            answer=row[name]['answer'],
            effects=tuple(item['name'] for item in row[name]['effects']),
            alternatives=tuple(row[name]['alternatives']),
            visible=limit is not None and bool(bench.strain / bench.pressure[-1] > limit.smallest),
        )
        row[name] |= {'score': said.score, 'said': asdict(said)}
    return row


def answer_by(
    investigate: Callable[..., Investigation], trial: Trial, settings: DiagnosisSettings
) -> tuple[Row, Investigation | None]:
    """Return what one engine says of a trial, with its CPU time (s) and the kinds of its laws."""
    started, kinds = time.process_time(), list[str]()
    answer, found = answered(trial, lambda *_: investigate(trial, settings, kinds))
    return answer | {'cpu_s': time.process_time() - started, 'kinds': kinds}, found


def one_trial(block: str, seed: int) -> Row:
    """Make a trial, let both engines answer, and open the label."""
    if block == 'static':
        return static_trial(seed)
    settings, cause = DEFAULTS, None
    if block == 'unnamed':
        names = list(CAUSES)
        cause = CAUSES[names[seed % len(names)]]
        sealed, trial = recorded(label_of('causes', cause.effect, STEP, seed, SIZES))
        known = tuple(name for name in cause.withheld if name in EFFECTS)
        settings = replace(DEFAULTS, withheld=known)
    else:
        sealed, trial = made(block, seed)
    row: Row = {'key': f'{block}/{seed}', 'block': block}
    for name, investigate in ENGINES.items():
        row[name], found = answer_by(investigate, trial, settings)
        if name == 'today':
            row['truth'] = truth_of(sealed, trial)
            hidden = list(sealed.label.effects)
            if found is not None and len(hidden) > 1:
                row['truth']['shown_beside'] = shown_beside(found, hidden)
    row['right_kinds'] = sorted(cause.kinds) if cause else []
    return row


def outcome(row: Row, name: str) -> str:
    """Return what an answer is worth, in a word."""
    truth, answer = row['truth'], row[name]
    if row['block'] == 'static':
        nothing = not truth['strain'] and answer['score'] == 'unobservable'
        return 'right' if nothing or answer['score'] == 'inseparable' else str(answer['score'])
    hidden = set(truth['effects'])
    if not hidden:
        if claims(answer):
            return 'false name'
        if row['block'] == 'rated_nothing':
            return 'right' if answer['answer'] in ('none', 'unobservable') else answer['answer']
        if row['block'] == 'outside':
            return 'right' if answer['answer'] == 'unknown' else answer['answer']
        if not answer['kinds']:
            return f'{answer["answer"]}, no law'
        return 'right' if set(answer['kinds']) & set(row['right_kinds']) else 'wrong kind'
    if not all(detectable(truth, row['today'], item) for item in hidden):
        return 'invisible, false name' if wrong(truth, answer) else 'invisible'
    if exactly(truth, answer) or (within(truth, answer) and answer['answer'] == 'inseparable'):
        return 'right'
    if wrong(truth, answer):
        return 'false name'
    return 'one of two' if claims(answer) else str(answer['answer'])


def chance_of_split(one: int, other: int) -> float:
    """Return the two-sided chance of such a split of trials that only one engine got right."""
    both = one + other
    tail = sum(comb(both, place) for place in range(min(one, other) + 1))
    return min(1.0, 2.0 * tail / 2**both)


def show(rows: list[Row]) -> None:
    """Print what both came to, block by block."""
    for block in dict.fromkeys(ROUND):
        those = [row for row in rows if row['block'] == block]
        for name in ENGINES:
            counts: dict[str, int] = {}
            for row in those:
                word = outcome(row, name)
                counts[word] = counts.get(word, 0) + 1
            cpu = sorted(row[name]['cpu_s'] for row in those)
            middle = f'{cpu[len(cpu) // 2]:.0f} s' if cpu else ''
            print(f'{block:14} {name:9} {len(those):3}  {middle:6} {counts}')
        right = [tuple(outcome(row, name) == 'right' for name in ENGINES) for row in those]
        only = right.count((True, False)), right.count((False, True))
        print(f'{block:14} only today {only[0]}, only evidence {only[1]}: ', end='')
        print(f'p {chance_of_split(*only):.3f}')
    for name in ENGINES:
        sizes = [
            found[0]
            for row in rows
            for effect in row['truth']['effects']
            if (found := size_of(row['truth'], row[name], effect)) is not None
        ]
        print(f'sizes covered  {name:9} {sum(sizes)} of {len(sizes)}')
    for row in rows:
        said = {name: outcome(row, name) for name in ENGINES}
        if len(set(said.values())) > 1:
            print(row['key'], row['truth']['design'], said)


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument('file', type=Path)
    command.add_argument('--rounds', type=int, default=10)
    command.add_argument('--first', type=int, default=0)
    command.add_argument('--block', nargs='+', choices=ROUND, default=ROUND)
    command.add_argument('--show', action='store_true', help='only print the file')
    arguments = command.parse_args()
    add_causes()
    known = arguments.file.read_text().splitlines() if arguments.file.exists() else []
    rows = [json.loads(line) for line in known]
    done = {row['key'] for row in rows}
    asked = wanted(arguments.rounds, arguments.first, arguments.block)
    for block, seed in () if arguments.show else asked:
        if f'{block}/{seed}' in done:
            continue
        rows.append(one_trial(block, seed))
        with arguments.file.open('a', encoding='utf-8') as file:
            file.write(json_text(rows[-1]))
    show(rows)


if __name__ == '__main__':
    main()

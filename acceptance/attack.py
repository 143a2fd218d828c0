"""Robustness test of the verbs against damaged and hostile inputs of every kind.

    python acceptance/attack.py [--cases N] [--seconds S] [--kind KIND ...] [--seed N] [--json]
                                [--keep DIR]

One case is one input of one kind, mutated by a generator that its number seeds, and one verb on
it. The verb runs in a forked process of its own with limits on memory, processor time and waiting.
What must hold: an exit code of the contract and at most one sentence, no control characters, less
than 1 GB, no output unless it is whole, nothing left behind, and readings of ours that changed are
said to be damaged. Exit code 1 if anything else happened; a case is repeated by
`--kind KIND --seed N --cases 1`.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
import math
from pathlib import Path
import sys
import tempfile
import time

from hostile.cases import case_of, CASES
from hostile.corpus import Corpus, make_corpus
from hostile.place import Case
from hostile.running import Finding, LIMITS, run_case
from pneunet_ros.files.json_text import json_text
from rich.console import Console
from rich.table import Table


def kinds_of(arguments: argparse.Namespace) -> list[str]:
    """Return the kinds asked for; SystemExit names those there are."""
    unknown = set(arguments.kind) - set(CASES)
    if unknown:
        raise SystemExit(f'no kind {", ".join(sorted(unknown))}; there are {", ".join(CASES)}')
    return arguments.kind or list(CASES)


def attack(
    corpus: Corpus, kinds: list[str], first: int, cases: int, until: float
) -> list[tuple[Case, Finding]]:
    """Run so many cases, the kinds by their weights in turn; none begins after a time."""
    wanted = [kind for kind in kinds for _ in range(CASES[kind].weight)]
    found = []
    for number in range(first, first + cases):
        if time.monotonic() > until:
            print(f'out of time: the next case is --seed {number}', file=sys.stderr)
            break
        case = case_of(wanted[number % len(wanted)], number, corpus)
        finding = run_case(case, corpus)
        found.append((case, finding))
        for problem in finding.problems:
            print(f'{case.kind} --seed {number}: {problem}', file=sys.stderr, flush=True)
    return found


def summary_of(found: list[tuple[Case, Finding]]) -> dict[str, dict[str, float]]:
    """Return counts and the largest numbers of every kind."""
    by_kind: defaultdict[str, list[Finding]] = defaultdict(list)
    for case, finding in found:
        by_kind[case.kind].append(finding)
    return {
        kind: {
            'cases': len(findings),
            'done': sum(finding.code in (0, 1) for finding in findings),
            'refused': sum(finding.code == 2 for finding in findings),
            **Counter(problem.kind for finding in findings for problem in finding.problems),
            'seconds': max(finding.seconds for finding in findings),
            'megabytes': max(finding.megabytes for finding in findings),
        }
        for kind, findings in by_kind.items()
    }


def show(summary: dict[str, dict[str, float]]) -> None:
    """Print the table."""
    table = Table()
    for column in ('kind', 'cases', 'done', 'refused', 'wrong', 'longest', 'largest'):
        table.add_column(column, justify='left' if column == 'kind' else 'right')
    beside = ('cases', 'done', 'refused', 'seconds', 'megabytes')
    for kind, numbers in summary.items():
        wrong = {name: count for name, count in numbers.items() if name not in beside}
        table.add_row(
            kind,
            *(f'{numbers[name]:.0f}' for name in beside[:3]),
            ', '.join(f'{count:.0f} {name}' for name, count in wrong.items()) or '0',
            f'{numbers["seconds"]:.1f} s',
            f'{numbers["megabytes"]:.0f} MB',
        )
    Console(width=110, highlight=False).print(table)


def main() -> int:
    """Attack, tell, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--cases', type=int, default=5000, help='number of cases (default: 5000)')
    parser.add_argument('--kind', nargs='+', default=[], help=f'of {", ".join(CASES)}')
    parser.add_argument('--seed', type=int, default=0, help='number of the first case')
    parser.add_argument(
        '--seconds',
        type=float,
        default=math.inf,
        help='time after which no further case is started',
    )
    parser.add_argument('--keep', type=Path, help='work in this folder and keep it')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    kinds, started = kinds_of(arguments), time.perf_counter()
    until = time.monotonic() + arguments.seconds
    with tempfile.TemporaryDirectory() as folder:
        corpus = make_corpus(arguments.keep or Path(folder))
        found = attack(corpus, kinds, arguments.seed, arguments.cases, until)
    summary = summary_of(found)
    problems = sum(len(finding.problems) for _, finding in found)
    if arguments.json:
        content = {'kinds': summary, 'problems': problems, 'limits': LIMITS}
        sys.stdout.write(json_text(content | {'seconds': time.perf_counter() - started}))
    else:
        show(summary)
    return 1 if problems else 0


if __name__ == '__main__':
    raise SystemExit(main())

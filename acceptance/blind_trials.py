"""Blind trials of the diagnosis, with effects hidden by the virtual lab.

    python acceptance/blind_trials.py --block all [--output FILE.jsonl] [--json] [--baselines]
                                      [--dots 0 4 9 13 18 22]

Labels are sealed: the diagnosing function is given recordings alone, the truth goes to a file of
its own (FILE.sealed.jsonl) that only the scorer opens. A bench that was stopped goes on with the
same command. The generator is the virtual lab: other discretization, richer effects, arms up to
15 % off, a harmless mismatch of 0.3 % in every trial, drop-outs, jitter, drift. Workers of a Dask
cluster need this folder on their PYTHONPATH.
"""

from __future__ import annotations

import argparse
from concurrent.futures import as_completed
from pathlib import Path
import sys
import tempfile

from pneunet_ros.core.threads import use_one_thread

if __name__ == '__main__':  # not where a test imports this: its processes would inherit it
    use_one_thread()

from blind.record import Record
from blind.running import one_trial
from blind.scoring import Row
from blind.summary import baseline_rates, summary_of, TARGETS
from blind.trials import BLOCKS, DEVELOPMENT, key_of, SCORING
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.core.executor import open_executor
from pneunet_ros.files.json_text import json_text
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table


def wanted(arguments: argparse.Namespace) -> list[tuple[str, int]]:
    """Return (block, seed) of all trials asked for, the blocks in turn."""
    blocks = list(BLOCKS) if 'all' in arguments.block else list(dict.fromkeys(arguments.block))
    start = (DEVELOPMENT if arguments.development else SCORING) + arguments.first
    counts = {block: arguments.trials or BLOCKS[block] for block in blocks}
    if arguments.development and start + max(counts.values()) > SCORING:
        raise SystemExit('seeds of development end where those of scoring begin')
    return [
        (block, start + place)
        for place in range(max(counts.values()))
        for block in blocks
        if place < counts[block]
    ]


def run(arguments: argparse.Namespace, record: Record) -> list[str]:
    """Do the trials that are not done yet; return a sentence for each that broke off."""
    done, broken = record.done(), []
    dots = arguments.dots
    left = [item for item in wanted(arguments) if key_of(*item, dots) not in done]
    columns = TextColumn('trials'), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with (
        open_executor(arguments.workers, arguments.scheduler) as executor,
        Progress(*columns, console=Console(stderr=True), disable=arguments.json) as progress,
    ):
        bar = progress.add_task('trials', total=len(left))
        futures = {
            executor.submit(one_trial, *item, arguments.baselines, dots): key_of(*item, dots)
            for item in left
        }
        try:
            for future in as_completed(futures):
                # One that broke off is not written down, so that it is tried again next time.
                error = future.exception()
                if error is None:
                    record.add(*future.result())
                else:
                    broken.append(f'{futures[future]} broke off: {error!r}')
                progress.advance(bar)
        except BaseException:
            for future in futures:
                future.cancel()
            raise
    return broken


def show(summary: Row) -> None:
    """Print for people."""
    console = Console()
    if not summary['trials']:
        return
    console.print(f'{summary["trials"]} blind trials, {summary["seconds"]:.1f} s each')
    table = Table()
    for column in ('what', 'reached', '95 % interval', 'of', 'wanted'):
        table.add_column(column)
    for block, key, what, target in TARGETS:
        value = summary.get(block, {}).get(key)
        if isinstance(value, dict) and value['of']:
            interval = f'{value["low"]:.3f} to {value["high"]:.3f}'
            share = f'{value["share"]:.3f}'
            table.add_row(what, share, interval, f'{value["count"]} / {value["of"]}', target)
        elif isinstance(value, float):
            table.add_row(what, f'{value:.3f}', '', '', target)
    left = summary['gap']
    if left['trials']:
        table.add_row(
            'held-out rms / that of the true model', f'{left["ratio"]:.3f}', '', '', '<= 1.05'
        )
        if left['closed'] is not None:
            table.add_row(
                '    share of the gap closed', f'{left["closed"]:.3f}', '', '', '>= 0.95'
            )
    console.print(table)
    for hidden, answers in summary['confusion'].items():
        console.print(f'{hidden}: ' + ', '.join(f'{k} {v}' for k, v in answers.items()))
    console.print(f'did not settle, and count as visible: {summary["unsettled"]}')
    for sentence in summary['failed']:
        console.print(f'failed: {sentence}')
    others = Table(title='Methods on the same trials')
    columns = {
        'first_right': 'right name first',
        'both_right': 'both of two right',
        'false_names': 'a false name',
        'held_out_over_true': 'held-out rms / true',
    }
    for column in ('method', *columns.values()):
        others.add_column(column)
    for method, values in summary['baselines'].items():
        others.add_row(method, *(in_short(values[key]) for key in columns))
    if others.rows:
        console.print(others)


def in_short(value: Row | float | None) -> str:
    """Return a rate or a number for a table."""
    if isinstance(value, dict):
        return f'{value["count"]} / {value["of"]}'
    return '' if value is None else f'{value:.3f}'


def main() -> None:
    """Run and print."""
    command = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    command.add_argument(
        '--block', nargs='+', default=['all'], choices=['all', *BLOCKS], help='default: all'
    )
    command.add_argument(
        '--trials', type=int, help='trials per block (default: as defined by the block)'
    )
    command.add_argument('--first', type=int, default=0, help='first trial of a block')
    command.add_argument(
        '--development', action='store_true', help='use development seeds, which are never scored'
    )
    command.add_argument('--workers', type=int, help='processes (default: one per core)')
    command.add_argument('--scheduler', metavar='ADDRESS', help='address of a Dask scheduler')
    command.add_argument('--output', type=Path, metavar='FILE.jsonl', help='resumable')
    command.add_argument(
        '--baselines', action='store_true', help='also run baseline methods on the same data'
    )
    command.add_argument(
        '--dots',
        type=int,
        nargs='+',
        choices=range(23),
        default=[],
        metavar='N',
        help='paint only these of the targets 0 (clamp) to 22 (tip); default: all',
    )
    command.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = command.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        record = Record(arguments.output or Path(folder) / 'trials.jsonl')
        try:
            broken = run(arguments, record)
        except PneunetError as error:
            sys.exit(f'{error}')
        asked = {key_of(*item, arguments.dots) for item in wanted(arguments)}
        pairs = [pair for pair in record.opened() if pair[0]['key'] in asked]
    summary = summary_of(pairs) | {'baselines': baseline_rates(pairs)}
    if arguments.json:
        sys.stdout.write(json_text({'bench': 'blind_trials', **summary}))
    else:
        show(summary)
    for sentence in broken:
        print(sentence, file=sys.stderr)
    sys.exit(1 if broken else 0)


if __name__ == '__main__':
    main()

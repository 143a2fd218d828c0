"""Count the tuning constants, and those without a source; `make check` limits both.

    python acceptance/deciding_numbers.py           # the counts by room, and what is allowed
    python acceptance/deciding_numbers.py --invented  # each number without a source

A number that decides is a field made by `tuning`. It has a source where its declaration names one
that is not 'invented', and if that is the sweep, where a figure of its row in sweep.csv moved.
Whoever adds a number takes one away: lower the limits with the counts.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Iterator
import csv
from dataclasses import dataclass
from pathlib import Path
import sys

PACKAGE = Path(__file__).parents[1] / 'pneunet_ros'
SWEEP = Path(__file__).with_name('sweep.csv')
IDLE = 'nothing', 'not read', 'not a number'  # of a row of the sweep
MOST, MOST_INVENTED = 198, 6  # of the whole package: to be lowered, never raised


@dataclass(frozen=True, slots=True, kw_only=True)
class DecidingNumber:
    """A number by which an algorithm decides: where it is declared, and where it comes from."""

    room: str
    name: str
    source: str

    @property
    def is_invented(self) -> bool:
        return not self.source or 'invented' in self.source


def numbers_of(path: Path) -> Iterator[DecidingNumber]:
    """Yield the numbers that a module declares by `tuning`."""
    for owner in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
        if not isinstance(owner, ast.ClassDef):
            continue
        for field in owner.body:
            call = field.value if isinstance(field, ast.AnnAssign) else None
            if isinstance(call, ast.Call) and ast.unparse(call.func) == 'tuning':
                sources = [ast.unparse(one.value) for one in call.keywords if one.arg == 'source']
                yield DecidingNumber(
                    room=path.relative_to(PACKAGE).parts[0],
                    name=f'{owner.name}.{ast.unparse(field.target)}',
                    source=sources[0] if sources else '',
                )


def moved_by_sweep() -> set[str]:
    """Return the numbers of which a figure moved when they were halved or doubled."""
    with SWEEP.open(encoding='utf-8', newline='') as table:
        return {
            row['number']
            for row in csv.DictReader(table)
            if not all(row[way].startswith(IDLE) for way in ('halved', 'doubled'))
        }


def main(argv: list[str] | None = None) -> int:
    """Print the counts; 1 where there are more than allowed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--invented', action='store_true', help='list numbers without a source')
    listed = parser.parse_args(argv).invented
    numbers = [one for path in sorted(PACKAGE.rglob('*.py')) for one in numbers_of(path)]
    moved = moved_by_sweep()
    invented = [
        one
        for one in numbers
        if one.is_invented or (one.source == "'sweep'" and one.name not in moved)
    ]
    rooms, without = (Counter(one.room for one in some) for some in (numbers, invented))
    for one in invented if listed else []:
        print(f'{one.room}: {one.name}')
    for room, count in rooms.most_common():
        print(f'{room:14} {count:4} numbers that decide, {without[room]:4} without a source')
    print(f'{"all":14} {len(numbers):4} numbers, at most {MOST}')
    print(f'{"":14} {len(invented):4} without a source, at most {MOST_INVENTED}')
    return int(len(numbers) > MOST or len(invented) > MOST_INVENTED)


if __name__ == '__main__':
    sys.exit(main())

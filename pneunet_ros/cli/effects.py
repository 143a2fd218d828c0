"""`pneunet effects`: the table of effects, from the code."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from pneunet_ros.cli.verb import add_json, DONE, output_console, print_json
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from rich.table import Table


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    add_json(parser)


def run(arguments: Namespace) -> int:
    """Print the table."""
    if arguments.json:
        print_json(
            {
                'effects': [
                    {
                        'name': effect.name,
                        'place': effect.place,
                        'meaning': effect.meaning,
                        'parameters': [
                            {'name': item.name, 'neutral': item.default, **item.metadata}
                            for item in quantities(effect)
                        ],
                    }
                    for effect in EFFECTS.values()
                ]
            }
        )
        return DONE
    table = Table(title='Effects a model file may hold under `effects:`', show_lines=True)
    for column in (
        'effect',
        'place',
        'meaning',
        'parameter',
        'unit',
        'neutral',
        'allowed',
        'prior',
    ):
        # Names stand in one piece, to be found and copied.
        table.add_column(column, no_wrap=column in ('effect', 'parameter'))
    for effect in EFFECTS.values():
        for index, item in enumerate(quantities(effect)):
            about = (effect.name, effect.place, effect.meaning) if index == 0 else ('', '', '')
            low, high = item.metadata['bounds']
            lower, upper = item.metadata['prior']
            table.add_row(
                *about,
                item.name,
                item.metadata['unit'],
                f'{item.default:g}',
                f'{low:g} to {high:g}',
                f'{lower:g} to {upper:g}',
            )
    output_console().print(table)
    return DONE

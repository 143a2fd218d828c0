"""`pneunet effects`: the table of effects, from the code."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import Field
import textwrap
from typing import Any

from pneunet_ros.cli import verb
from pneunet_ros.core.units import quantities
from pneunet_ros.effects import EFFECTS
from pneunet_ros.effects.effect import Place
from pneunet_ros.effects.user_effects import add_installed_effects

WIDTH = 80  # columns
INDENT = 22  # of the text next to a name
PLACES: dict[Place, str] = {
    'sensing': 'what a reading means',
    'actuation': 'pressure history to chamber pressure and intrinsic curvature',
    'material': 'moment against curvature',
    'mechanics': 'stretch, clamp, weight, end load',
    'motion': 'mass and damping; as the block `motion`',
}


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    verb.add_effects_path(parser)


def run(arguments: Namespace) -> int:
    """Print the table."""
    add_installed_effects()
    effects = [
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
    text = '\n'.join(lines())
    verb.present(
        arguments, {'effects': effects}, lambda console: console.print(text, soft_wrap=True)
    )
    return verb.DONE


def lines() -> Iterator[str]:
    """Yield two or more lines per effect, grouped by where the effects act."""
    yield ('Effects of a model file, under `effects:`; at the neutral value they are off.')
    yield 'prior: the expected range, from which calibration and diagnosis start. If it has'
    yield "a unit of length, force or pressure: that of the paper's arm, scaled to yours."
    for place in dict.fromkeys(effect.place for effect in EFFECTS.values()):
        yield ''
        yield f'{place}: {PLACES[place]}'
        for effect in EFFECTS.values():
            if effect.place != place:
                continue
            name = f'  {effect.name}'.ljust(INDENT)
            yield from textwrap.wrap(
                effect.meaning, WIDTH, initial_indent=name, subsequent_indent=' ' * INDENT
            )
            for item in quantities(effect):
                yield from parameter_lines(item)


def parameter_lines(item: Field[Any]) -> list[str]:
    """Return name, unit, neutral value, prior and bounds of a parameter, wrapped."""
    (low, high), (lower, upper) = item.metadata['bounds'], item.metadata['prior']
    unit = item.metadata['unit'].replace('-', '').strip()
    named = f'{item.name} ({unit})' if unit else item.name
    text = (
        f'{named}: neutral {item.default:g}, prior {lower:g} to {upper:g}, '
        f'allowed {low:g} to {high:g}'
    )
    return textwrap.wrap(
        text, WIDTH, initial_indent=' ' * 6, subsequent_indent=' ' * 8, break_on_hyphens=False
    )

"""`pneunet new-arm`: size and targets of an arm -> arm.yaml, and a template for the dots."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
import math
from pathlib import Path
import sys
from typing import Any, NamedTuple

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.quantity_option import quantity_of
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import kilopascals, millimeters, STANDARD_ATMOSPHERE
from pneunet_ros.files.atomic import all_or_none, atomic_output
from pneunet_ros.files.model_file import save_model
from pneunet_ros.model.starting_arm import even_places, starting_arm

FEWEST_TARGETS, MOST_TARGETS = 3, 500
LONGEST = 10.0  # m, of an arm
STEP = 0.0005  # m; target positions are rounded to it, so that a ruler shows them


class Question(NamedTuple):
    """A question: option, kind of unit, meaning, and a typical value."""

    name: str
    kind: str
    meaning: str
    usual: str


QUESTIONS = (
    Question('length', 'length', 'length from the clamp to the free end, along the arm', '112mm'),
    Question(
        'weight', 'force', 'weight of the arm: newtons, or grams as read from a scale', '17g'
    ),
    Question('pressure', 'pressure', 'largest pressure in use, below zero for vacuum', '60kPa'),
    Question('dot', 'length', 'diameter of the dots', '3mm'),
)


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.epilog = (
        'Numbers are in SI units, or carry a unit: 112mm, 0.17N, 17g, 60kPa. On a terminal, you '
        'are asked for missing values.'
    )
    for question in QUESTIONS:
        parser.add_argument(
            f'--{question.name}', metavar='SIZE', help=f'{question.meaning}, e.g. {question.usual}'
        )
    parser.add_argument(
        '--targets',
        metavar='N',
        help='number of dots, evenly spaced from the clamp to the free end',
    )
    parser.add_argument(
        '--places',
        nargs='+',
        metavar='SIZE',
        help='positions of the dots along the arm, measured from the clamp, instead of their '
        'number',
    )
    parser.add_argument(
        '--output',
        type=Path,
        default=Path('arm.yaml'),
        metavar='ARM.yaml',
        help='write the arm here (default: arm.yaml), and the sheet next to it, as .pdf',
    )
    parser.add_argument('--no-template', action='store_true', help='write no sheet of dots')
    verb.add_overwrite(parser)


def run(arguments: Namespace) -> int:
    """Ask, then write the arm file and the template."""
    from pneunet_ros.reports.target_template import write_template

    if arguments.output.suffix not in ('.yaml', '.yml'):
        raise RequestError(f'--output {arguments.output} must end in .yaml', reason='wrong_suffix')
    sizes, places = answers(arguments, input if sys.stdin.isatty() else None)
    name = arguments.output.stem
    arm = starting_arm(name, sizes['length'], sizes['weight'], places, sizes['pressure'])
    template = None if arguments.no_template else arguments.output.with_suffix('.pdf')
    with all_or_none():
        save_model(arm, arguments.output, overwrite=arguments.overwrite)
        if template is not None:
            with atomic_output(template, overwrite=arguments.overwrite) as temporary:
                write_template(temporary, name, places, sizes['dot'])
    summary: dict[str, Any] = {
        'output': arguments.output,
        'template': template,
        'length': arm.length,
        'weight': arm.weight,
        'largest_pressure': sizes['pressure'],
        'dot': sizes['dot'],
        'target_arclength': places,
    }
    shown = ', '.join(f'{millimeters(position):g}' for position in places.tolist())
    lines = [
        f'{name}: {millimeters(arm.length):g} mm, {arm.weight:.4g} N, up to '
        f'{kilopascals(sizes["pressure"]):g} kPa; {places.size} targets at {shown} mm',
        f'wrote {arguments.output}: dimensions and targets are yours; all other values are '
        'placeholders',
        *([] if template is None else [f'wrote {template}: print at 100 % and check its ruler']),
    ]
    verb.present(arguments, summary, lambda console: console.print('\n'.join(lines)))
    return verb.DONE


def answers(
    arguments: Namespace, ask: Callable[[str], str] | None
) -> tuple[dict[str, float], Array]:
    """Return the sizes (SI) by name, and the positions of the targets (targets,) m.

    ask: function that asks for missing values; None: there is no terminal, which raises
    RequestError.
    """
    targets_given = arguments.targets or arguments.places
    missing = [item.name for item in QUESTIONS if getattr(arguments, item.name) is None]
    missing += [] if targets_given else ['targets']
    if missing and ask is None:
        raise RequestError(
            f'give {", ".join(f"--{name}" for name in missing)}: there is no terminal on which '
            'to ask',
            reason='missing',
        )
    sizes = {}
    for question in QUESTIONS:
        text = getattr(arguments, question.name)
        if text is None and ask is not None:
            text = ask(f'{question.meaning} [{question.usual}]: ').strip() or question.usual
        sizes[question.name] = nonzero_size(f'--{question.name}', text, question.kind)
    if arguments.places:
        if arguments.targets:
            raise RequestError('give --targets or --places, not both', reason='exclusive')
        given = [size_of('--places', text, 'length') for text in arguments.places]
        places = np.array(given)
        check_gaps('--places', places, sizes['dot'])
        return sizes, places
    text = arguments.targets
    if text is None and ask is not None:
        text = ask('number of dots [12]: ').strip() or '12'
    if not str(text).isdecimal() or not FEWEST_TARGETS <= int(text) <= MOST_TARGETS:
        raise RequestError(
            f'--targets {text}: a whole number from {FEWEST_TARGETS} to {MOST_TARGETS} is needed',
            reason='out_of_bounds',
        )
    places = even_places(sizes['length'], int(text), sizes['dot'], STEP)
    check_gaps(f'--targets {text}', places, sizes['dot'])
    return sizes, places


def check_gaps(option: str, places: Array, dot: float) -> None:
    """Reject dots of a diameter (m) that are too close; the arm itself rejects a wrong order."""
    gap = float(np.diff(places).min(initial=math.inf))
    if 0.0 <= gap <= 1.5 * dot:
        raise RequestError(
            f'{option}: dots of {millimeters(dot):g} mm would be {millimeters(gap):g} mm apart, '
            'center to center, which leaves less than half a diameter between them',
            reason='out_of_bounds',
        )


def nonzero_size(option: str, text: str, kind: str) -> float:
    """Return a size, SI; RequestError if it is zero, or negative but no pressure of a vacuum."""
    value = size_of(option, text, kind)
    least = -STANDARD_ATMOSPHERE if kind == 'pressure' else 0.0
    if value == 0.0 or value < least:
        allowed = f'be above {least:g} Pa and not zero' if kind == 'pressure' else 'be above zero'
        raise RequestError(f'{option} {text} must {allowed}', reason='out_of_bounds')
    return value


def size_of(option: str, text: str, kind: str) -> float:
    """Return a size, SI; RequestError if a length was evidently meant in millimeters."""
    value = quantity_of(option, text, kind)
    if kind == 'length' and value > LONGEST and text[-1:].isdigit():
        raise RequestError(
            f'{option} {text} is {value:g} m: did you mean {text}mm?', reason='out_of_bounds'
        )
    return value

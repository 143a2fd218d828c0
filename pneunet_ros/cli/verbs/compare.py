"""`pneunet compare`: distance of two recordings, or of an estimate and a truth."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
import math
from pathlib import Path
from typing import Any

import numpy as np
from pneunet_ros.cli import verb
from pneunet_ros.cli.fitted_table import print_rows
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import millimeters
from pneunet_ros.estimation.shape_error import Comparison
from pneunet_ros.files.atomic import atomic_output
from pneunet_ros.model.arm import Arm
from pneunet_ros.offline.compare import compare_files, comparison_content
from pneunet_ros.recordings.recorded_shapes import SHAPE_TOPICS
from rich.console import Console

SIDES = ('a', 'b')
PLOTS = ('.png', '.svg', '.pdf')


def options(parser: ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        'a',
        type=Path,
        metavar='A',
        help='a recording with `tip` and `shape` (from `replay`), or with `targets` (from '
        '`track`)',
    )
    parser.add_argument(
        'b',
        type=Path,
        nargs='?',
        metavar='B',
        help='another recording, or a ground truth (.truth.npz, from `simulate`)',
    )
    parser.add_argument(
        '--truth', type=Path, metavar='FILE', help='also compare A and B with this ground truth'
    )
    parser.add_argument(
        '--plot',
        type=Path,
        metavar='FILE',
        help='draw shapes, and errors over arclength and time (.png, .svg or .pdf)',
    )
    verb.add_model(parser)
    parser.add_argument(
        '--topic',
        action='append',
        default=[],
        metavar='[a.|b.]NAME=TOPIC',
        help='read this topic in A and B, or in one of them only (b.targets=/pneunet/targets '
        'reads the measured targets of a recording B that also contains estimates); may be '
        f'repeated; NAME is {", ".join(SHAPE_TOPICS[:-1])} or {SHAPE_TOPICS[-1]}',
    )
    verb.add_overwrite(parser)


def run(arguments: Namespace) -> int:
    """Compare and summarize."""
    if arguments.plot is not None and arguments.plot.suffix.lower() not in PLOTS:
        raise RequestError(
            f'--plot {arguments.plot} must end in {", ".join(PLOTS)}', reason='wrong_suffix'
        )
    arm = verb.model_of(arguments)
    sides, topics = (arguments.a, arguments.b), side_topics(arguments.topic)
    length = arm.length if arguments.model is not None else None
    with verb.reading_bar(shown=not arguments.json):
        comparisons = compare_files(sides, topics, arguments.truth, arm.target_arclength, length)
    found = [item for item in comparisons if item.tip is not None or item.shape is not None]
    plot = arguments.plot if found else None
    if plot is not None:
        from pneunet_ros.reports.compare_plot import draw_comparisons

        inputs = [path for path in (*sides, arguments.truth) if path]
        with atomic_output(plot, overwrite=arguments.overwrite, inputs=inputs) as temporary:
            form = plot.suffix.lower().lstrip('.')
            draw_comparisons(found, temporary, form)
    contents = [comparison_content(item) for item in comparisons]
    if arguments.model is None:
        for item, content in zip(comparisons, contents, strict=True):
            content['sentences'] += places_assumed(item, arm)
    verb.present(
        arguments,
        {'comparisons': contents, 'plot': plot},
        lambda console: show(contents, plot, console),
    )
    return verb.DONE if len(found) == len(comparisons) else verb.NEGATIVE


def places_assumed(comparison: Comparison, arm: Arm) -> list[str]:
    """Report that target positions of the shipped model were assumed, if targets were compared."""
    lines = [side.centerlines for side in (comparison.of, comparison.to)]
    places = arm.target_arclength
    if any(line is not None and np.array_equal(line.arclength, places) for line in lines):
        return [
            f'targets are assumed to be where {arm.name} has them; use --model for another arm'
        ]
    return []


def side_topics(pairs: list[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the chosen topics of A and of B, by last name."""
    of_one = [f'{side}.{name}' for side in SIDES for name in SHAPE_TOPICS]
    chosen = verb.topics_of(pairs, [*SHAPE_TOPICS, *of_one])
    common = {name: topic for name, topic in chosen.items() if name in SHAPE_TOPICS}
    a, b = (
        common
        | {name: chosen[f'{side}.{name}'] for name in SHAPE_TOPICS if f'{side}.{name}' in chosen}
        for side in SIDES
    )
    return a, b


def show(contents: list[dict[str, Any]], plot: Path | None, console: Console) -> None:
    """Print the errors, the number of matched frames, and the compared topics."""
    for content in contents:
        console.print(f'{content["of"]}\nagainst {content["to"]}')
        found = [(name, content[name]) for name in ('tip', 'shape') if content[name] is not None]
        rows = [
            row
            for name, errors in found
            for row in error_rows(name, errors, known=content['length'] is not None)
        ]
        columns = ('error', 'rms', 'median', '95 %', 'largest', 'unit')
        if rows:
            print_rows(console, '', columns, rows, numbers=range(1, 5))
        for name, errors in found:
            console.print(matched_sentence(name, errors))
        verb.print_notes(console, content['sentences'])
    if plot is not None:
        console.print(f'wrote {plot}')


def error_rows(name: str, errors: dict[str, Any], *, known: bool) -> Iterator[list[str]]:
    """Yield the rows for an error: mm, percent of the length if known, and degrees."""
    heading = errors.get('heading')
    for label, unit, values, factor in (
        (name, 'mm', errors, millimeters(1.0)),
        ('', '% of the length', errors['percent_of_length'] if known else None, 1.0),
        ('tip heading', 'deg', heading, math.degrees(1.0)),
    ):
        if values is not None:
            numbers = (f'{factor * values[key]:.3f}' for key in ('rms', 'median', 'p95', 'max'))
            yield [label, *numbers, unit]


def matched_sentence(name: str, errors: dict[str, Any]) -> str:
    """Describe the compared topics, the number of frames, and the differences of their stamps."""
    of, to = errors['topics'].values()
    offsets = errors['stamps_apart']
    text = (
        f'{name}: {of} against {to}, {errors["frames"]} frames matched, stamps '
        f'{1e3 * offsets["median"]:.3g} ms apart (median), {1e3 * offsets["max"]:.3g} ms at most'
    )
    if name != 'tip':
        return f'{text}; {errors["points"]} points at {len(errors["arclength"])} places'
    along, across = (millimeters(value) for value in errors['mean'].tolist())
    text += f'; mean difference ({along:+.3f}, {across:+.3f}) mm'
    displacement = errors['moved_between_stamps']
    if displacement > 0.0:
        text += f'; between matched stamps it moves {millimeters(displacement):.3f} mm rms'
    if math.isfinite(errors['inside_95']):
        text += f'; {100.0 * errors["inside_95"]:.1f} % within the 95 % ellipse'
    return text

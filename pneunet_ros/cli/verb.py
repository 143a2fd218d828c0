"""Output and options that verbs have in common."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, BooleanOptionalAction, Namespace
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
import dataclasses
from pathlib import Path
import sys
from typing import Any

from pneunet_ros.cli.quantity_option import KIND_OF_UNIT, quantity_type, seed
from pneunet_ros.core.errors import ModelError, RequestError
from pneunet_ros.core.printable import printable
from pneunet_ros.core.progress import OnProgress, reporting_to
from pneunet_ros.core.share import share_path
from pneunet_ros.core.unit_system import dimensionless, SI, UnitSystem
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.files.json_text import json_text
from pneunet_ros.files.model_file import load_model
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.gravity import Gravity, gravity_of, OUT_OF_PLANE
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

DONE, NEGATIVE = 0, 1  # exit codes
PAPER_ARM = 'config/paper_arm.yaml'
# The settings for the meaning of readings, for verbs that read recordings without estimating.
SENSOR_SETTINGS = (
    'frame_id',
    'wrench_required',
    'pressure_unit',
    'pressure_reference',
    'pressure_sign',
    'ambient_pressure',
    'pressure_offset',
    'wrench_unit',
    'wrench_sign',
    'wrench_yaw',
    'force_offset_x',
    'force_offset_y',
    'wrench_frame',
    'imu_from_base',
    'gravity_frame',
    'judge_readings',
)


def output_console() -> Console:
    """Return the console for tables; for a pipe, as wide as the table."""
    return PlainConsole(
        width=None if sys.stdout.isatty() else 120, highlight=False, markup=False, emoji=False
    )


class PlainConsole(Console):
    """A console that prints text literally, without markup or control characters."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Return printable text; called for all lines, cells and titles."""
        return super().render_str(printable(text), **options)


def progress_bar(shown: bool) -> Progress:
    """Return a progress bar on stderr, for terminals only."""
    hidden = not shown or not sys.stderr.isatty()
    return Progress(
        TextColumn('{task.description}', markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True, quiet=hidden),  # rich before 13.8 adds a final newline
        transient=True,
        disable=hidden,
    )


def progress_of(bar: Progress, what: str) -> OnProgress:
    """Return a progress callback; a total of 0 means unknown."""
    task = bar.add_task(what, total=None)
    return lambda stage, done, total: bar.update(
        task, description=stage, completed=done, total=total or None
    )


@contextmanager
def reading_bar(shown: bool) -> Iterator[None]:
    """Show the progress of reading and writing files if there is a terminal."""
    with progress_bar(shown) as bar:
        stages: dict[str, TaskID] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in stages:
                stages[stage] = bar.add_task(stage, total=total)
            bar.update(stages[stage], completed=done, total=total)

        with reporting_to(show):
            yield


def print_json(content: dict[str, Any]) -> None:
    """Print one JSON object with full precision; non-finite numbers become null."""
    sys.stdout.write(json_text(content))


def present(
    arguments: Namespace, content: dict[str, Any], show: Callable[[Console], object]
) -> None:
    """Print the results of a verb: with --json as one object, otherwise as `show` does."""
    if arguments.json:
        print_json(content)
    else:
        show(output_console())


def print_notes(console: Console, sentences: Iterable[str]) -> None:
    """Print notes, a line each."""
    for sentence in sentences:
        console.print(f'note: {sentence}')


def print_outputs(
    arguments: Namespace, content: dict[str, Any], text: str, more: Iterable[str] = ()
) -> None:
    """Print the outputs of a verb, with its own sentences and further notes."""

    def show(console: Console) -> None:
        console.print(text)
        print_notes(console, (*content['sentences'], *more))
        console.print(f'wrote {content["output"]}')

    present(arguments, content, show)


def add_output(parser: ArgumentParser, metavar: str, meaning: str) -> None:
    """Add the options for the output, which is required, and for overwriting it."""
    parser.add_argument('--output', type=Path, required=True, metavar=metavar, help=meaning)
    add_overwrite(parser)


def add_recordings(
    parser: ArgumentParser, option: str, meaning: str, *, required: bool = False
) -> None:
    """Add an option that takes several recordings."""
    parser.add_argument(
        option, type=Path, nargs='+', required=required, default=[], metavar='REC', help=meaning
    )


def add_seed(
    parser: ArgumentParser, meaning: str, option: str = '--seed', default: int | None = 0
) -> None:
    """Add an option for a random seed."""
    parser.add_argument(option, type=seed, default=default, metavar='N', help=meaning)


def add_static(parser: ArgumentParser) -> None:
    """Add the option for recordings of steady states."""
    parser.add_argument(
        '--static',
        action='store_true',
        help='treat every frame as a steady state: stamps are ignored, and time-dependent effects '
        'are not considered',
    )


def add_model(
    parser: ArgumentParser, meaning: str = "(default: the shipped model of the paper's arm)"
) -> None:
    """Add the option for the model file."""
    parser.add_argument(
        '--model',
        type=Path,
        metavar='FILE',
        help=f'model file, YAML{"" if meaning[0] == "(" else ":"} {meaning}',
    )
    add_effects_path(parser)


def add_gravity(parser: ArgumentParser, of: str = 'model file') -> None:
    """Add the option for the direction of gravity."""
    parser.add_argument(
        '--gravity',
        type=gravity_option,
        metavar='GX,GY',
        help='direction of gravity: x and y of the unit vector that points down, in the base '
        f'frame, e.g. --gravity=0,-1, or {OUT_OF_PLANE} (default: from base_imu if '
        f'recorded, otherwise as in the {of})',
    )


def gravity_option(text: str) -> Gravity:
    """Return the gravity requested by an option."""
    try:
        return gravity_of(text, fixed=True)
    except ModelError as error:
        raise ArgumentTypeError(f'{error}') from None


def with_gravity(arm: Arm, arguments: Namespace) -> Arm:
    """Return an arm with the gravity of `--gravity`, if given."""
    gravity: Gravity | None = getattr(arguments, 'gravity', None)
    return arm if gravity is None else dataclasses.replace(arm, gravity=gravity)


def add_effects_path(parser: ArgumentParser) -> None:
    """Add the option for user effects; `cli.main` loads them before the verb runs."""
    parser.add_argument(
        '--effects-path',
        type=Path,
        metavar='DIR',
        help='load the effect files *.py of this folder, which are executed, in addition to the '
        'effects of the library and of installed packages',
    )


def add_dimensionless(parser: ArgumentParser, what: str) -> None:
    """Add the option for dimensionless results, with the scales of the paper."""
    parser.add_argument(
        '--dimensionless',
        action='store_true',
        help=f'{what} by the scales of the arm, as in the paper: lengths by l, forces by mg, '
        'moments by mg l, curvature by 1/l (default: SI; pressure stays in Pa)',
    )


def units_of(arguments: Namespace, arm: Arm, default: UnitSystem = SI) -> UnitSystem:
    """Return the scales of this arm with --dimensionless, else the given units."""
    return dimensionless(arm.length, arm.weight) if arguments.dimensionless else default


def scales_sentence(arm: Arm) -> str:
    """Describe the scales of dimensionless numbers."""
    length, weight = 1000.0 * arm.length, arm.weight
    return (
        f'dimensionless: lengths by l = {length:g} mm, forces by mg = {weight:g} N of {arm.name}'
    )


def model_of(arguments: Namespace) -> Arm:
    """Return the requested model."""
    return with_gravity(load_model(arguments.model or share_path(PAPER_ARM)), arguments)


def still_model_of(arguments: Namespace) -> Arm:
    """Return the requested model with a fixed direction of gravity.

    RequestError if the direction of gravity is only known from readings.
    """
    arm = model_of(arguments)
    if arm.gravity.is_measured:
        raise RequestError(
            f'{arm.name} takes the direction of gravity from {arm.gravity.source}, which this '
            'command does not read: set the direction, e.g. --gravity=0,-1',
            reason='no_gravity',
        )
    return arm


def add_overwrite(parser: ArgumentParser) -> None:
    """Add --overwrite; without it, existing outputs are not replaced."""
    parser.add_argument(
        '--overwrite', action='store_true', help='overwrite existing outputs (default: refuse)'
    )


def add_settings(parser: ArgumentParser, names: Collection[str] | None = None) -> None:
    """Add the settings of the estimator as options: all, or those named."""
    group = parser.add_argument_group('sensors and stack (as the parameters of the node)')
    for item in dataclasses.fields(EstimatorSettings):
        if names is not None and item.name not in names:
            continue
        meaning, unit = item.metadata['meaning'], item.metadata.get('unit')
        shown = f' {unit}' if unit not in (None, '-') else ''
        option: dict[str, Any] = {'help': f'{meaning} (default: {item.default}{shown})'}
        if isinstance(item.default, bool):
            option['action'] = BooleanOptionalAction
        else:
            kind = KIND_OF_UNIT.get(str(unit))
            option['type'] = quantity_type(kind) if kind else type(item.default)
            option['choices'] = item.metadata.get('choices') or None
            if not option['choices']:
                option['metavar'] = (shown.strip() or item.name.split('_')[-1]).upper()
        group.add_argument(
            f'--{item.name.replace("_", "-")}', dest=item.name, default=item.default, **option
        )


def settings_of(arguments: Namespace) -> EstimatorSettings:
    """Return the requested settings."""
    names = [item.name for item in dataclasses.fields(EstimatorSettings)]
    given = {name: getattr(arguments, name) for name in names if hasattr(arguments, name)}
    return EstimatorSettings(**given)


def add_topics(parser: ArgumentParser, example: str = 'pressure=/my/pressure') -> None:
    """Add the option for other topic names."""
    parser.add_argument(
        '--topic',
        action='append',
        default=[],
        metavar='NAME=TOPIC',
        help=f'read this topic instead, e.g. {example}; may be repeated',
    )


def topics_of(pairs: Iterable[str], known: Iterable[str]) -> dict[str, str]:
    """Return full topic names by last name; RequestError if malformed."""
    chosen: dict[str, str] = {}
    known = tuple(known)
    for pair in pairs:
        name, equals, topic = pair.partition('=')
        if not equals or not topic or name not in known:
            raise RequestError(
                f'--topic {pair} is not of the form NAME=TOPIC; NAME is one of {", ".join(known)}',
                reason='wrong_form',
            )
        chosen[name] = topic
    return chosen

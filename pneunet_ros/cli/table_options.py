"""Options of `import` and `track` for reading a table."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Sequence
import math

from pneunet_ros.core.errors import RequestError
from pneunet_ros.tables.reading_table import ReadingTable
from pneunet_ros.tables.table_reader import ImportRequest

AUTO = 'auto'  # estimate the delay


def add_table_options(parser: ArgumentParser) -> None:
    """Add the options for reading the columns of a table."""
    group = parser.add_argument_group('columns of the table')
    for option, form, meaning in (
        ('--select', 'COLUMN=VALUE', 'read only the rows with this text in this column'),
        ('--rename', 'OLD=NEW', 'rename a column to a known name'),
        ('--offset', 'COLUMN=NUMBER', 'number to add to a column (new name), in its unit'),
        ('--ignore', 'COLUMN', 'leave columns out'),
        (
            '--missing',
            'NUMBER',
            'numbers that mean "no reading" (for a target: in both coordinates), or none '
            '(default: stop if a number seems to mean it)',
        ),
    ):
        group.add_argument(
            option, action='extend', nargs='+', default=[], metavar=form, help=meaning
        )


def table_request(arguments: Namespace, rate: float | None = None) -> ImportRequest:
    """Return the request given by the options; rate: rows per second of a table without time."""
    offsets = {
        name: number(f'--offset {name}={text}', text)
        for name, text in pairs_of('--offset', arguments.offset).items()
    }
    return ImportRequest(
        select=pairs_of('--select', arguments.select),
        rename=pairs_of('--rename', arguments.rename),
        ignore=arguments.ignore,
        offsets=offsets,
        missing=missing_of(arguments.missing),
        rate=rate,
    )


def unit_objections(
    table: ReadingTable, arguments: Namespace
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Describe an implausible unit of the pressures in the table; empty if it is plausible.

    Without --model, pressures are compared with those typical of soft actuators.
    """
    from pneunet_ros.cli.verb import model_of
    from pneunet_ros.measurement.meaning.pressure_judge import ANY_ACTUATOR, expected_of
    from pneunet_ros.offline.judge import judge_table_readings

    if not arguments.judge_readings:
        return (), ()
    known = arguments.model is not None
    expected = [expected_of(model_of(arguments))] if known else ANY_ACTUATOR
    return judge_table_readings(table, expected)


def missing_of(words: Sequence[str]) -> tuple[float, ...] | None:
    """Return the numbers that mean "no reading"; None if the option is absent."""
    if not words:
        return None
    if list(words) == ['none']:
        return ()
    return tuple(number('--missing', word) for word in words)


def pairs_of(option: str, words: Iterable[str]) -> dict[str, str]:
    """Return texts by name from words NAME=TEXT; raises RequestError if malformed."""
    pairs: dict[str, str] = {}
    for word in words:
        name, equals, text = word.partition('=')
        if not equals or not name or not text or name in pairs:
            raise RequestError(
                f'{option} {word} is not of the form NAME=TEXT, or its name is given twice',
                reason='wrong_form',
            )
        pairs[name] = text
    return pairs


def number(option: str, text: str) -> float:
    """Return a finite number, or raise a RequestError that names the option."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RequestError(f'{option}: {text!r} is not a number', reason='not_a_number')
    return value

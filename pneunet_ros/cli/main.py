"""The command `pneunet`: the one place where an error becomes a sentence and an exit code."""

from __future__ import annotations

from argparse import ArgumentParser
from collections.abc import Sequence
from decimal import Decimal
import os
import re
import sys

from pneunet_ros import __version__
from pneunet_ros.cli import (
    calibrate,
    check,
    demo,
    diagnose,
    effects,
    export,
    import_table,
    predict,
    replay,
    simulate,
    track,
)
from pneunet_ros.cli.verb import Verb, WRONG
from pneunet_ros.core.errors import PneunetError

VERBS: tuple[Verb, ...] = (
    demo.VERB,
    predict.VERB,
    replay.VERB,
    track.VERB,
    calibrate.VERB,
    diagnose.VERB,
    check.VERB,
    export.VERB,
    import_table.VERB,
    effects.VERB,
    simulate.VERB,
)
INTERRUPTED = 130
NEGATIVE_NUMBER = re.compile(r'-(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?')


def parser() -> ArgumentParser:
    """Build the command line of all verbs."""
    command = ArgumentParser(
        prog='pneunet',
        description='Where a pneu-net arm is, from pressure and end force, by a rod model.',
        epilog='Exit codes: 0 done; 1 done, the answer is negative; 2 request or file was wrong.',
        allow_abbrev=False,
    )
    command.add_argument('--version', action='version', version=f'pneunet_ros {__version__}')
    verbs = command.add_subparsers(dest='verb', metavar='VERB', required=True)
    for verb in VERBS:
        options = verbs.add_parser(
            verb.name, help=verb.help, description=verb.help, allow_abbrev=False
        )
        verb.options(options)
        options.set_defaults(run=verb.run)
    return command


def without_exponent(argument: str) -> str:
    """Return a negative number in the form that argparse does not take for an option: -0.00001."""
    if NEGATIVE_NUMBER.fullmatch(argument):
        return f'{Decimal(argument):f}'
    return argument


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    given = parser().parse_args([without_exponent(word) for word in words])
    try:
        code: int = given.run(given)
        sys.stdout.flush()
        return code
    except PneunetError as error:
        print(f'pneunet {given.verb}: {error}', file=sys.stderr)
        return WRONG
    except KeyboardInterrupt:
        print(f'pneunet {given.verb}: interrupted, nothing written', file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, as in `pneunet effects | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0

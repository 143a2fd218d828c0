"""The command `pneunet`: the one place where an error becomes a sentence and an exit code."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from decimal import Decimal
from importlib import import_module
import os
import re
import sys
from typing import Literal, NamedTuple, NoReturn

from pneunet_ros import __version__
from pneunet_ros.core import jit
from pneunet_ros.core.errors import PneunetError, shortened
from pneunet_ros.core.kernel_cache import answer_first, compile_first, compile_meanwhile
from pneunet_ros.core.printable import printable


class WrongUsageError(SystemExit):
    """The command line was wrong, and a person has been told so; `sentence` is for programs."""

    def __init__(self, sentence: str) -> None:
        """Exit with the code of a wrong request."""
        super().__init__(WRONG)
        self.sentence = sentence


class CommandParser(ArgumentParser):
    """A parser whose complaints may be shown, whatever words it was given."""

    def error(self, message: str) -> NoReturn:
        """Print usage and what was wrong, and exit."""
        sentence = printable(shortened(message))
        if UNIT_APART.search(sentence):
            sentence += '; a number and its unit are one word, as in 31kPa'
        self.print_usage(sys.stderr)
        print(f'{self.prog}: error: {sentence}', file=sys.stderr)
        raise WrongUsageError(sentence)


class Verb(NamedTuple):
    """A verb: its name, one line of help, and its module, which is imported when it is called.

    The module has `options(parser)`, which adds the options, and `run(arguments)`, which does it
    and returns the exit code. kernels: 'meanwhile' where it answers while they are compiled,
    'first' where it waits for them, as it has long work for them.
    """

    name: str
    help: str
    module: str
    kernels: Literal['none', 'meanwhile', 'first'] = 'none'


VERBS = (
    Verb(
        'demo',
        "replay the loads of the paper's Table 1: the first minute",
        'pneunet_ros.cli.demo',
        'meanwhile',
    ),
    Verb(
        'predict',
        'predict the shape under pressure and end load, or find the force from the tip',
        'pneunet_ros.cli.predict',
        'meanwhile',
    ),
    Verb(
        'replay',
        'run the estimator on a recording of pressure and end wrench',
        'pneunet_ros.cli.replay',
        'first',
    ),
    Verb(
        'track',
        'track the targets in camera images: points, smoothed centerline, curvature',
        'pneunet_ros.cli.track',
        'meanwhile',
    ),
    Verb(
        'calibrate',
        'calibrate a model with error bars from recordings without and with end load',
        'pneunet_ros.cli.calibrate',
        'first',
    ),
    Verb(
        'diagnose',
        'find the physical effect that a model lacks; write the augmented model and a report',
        'pneunet_ros.cli.diagnose',
        'first',
    ),
    Verb(
        'explore',
        'record, diagnose and choose the next recording until the missing effect has a name',
        'pneunet_ros.cli.explore',
        'first',
    ),
    Verb(
        'survey',
        'check, calibrate and diagnose each of many arms; show them side by side on one page',
        'pneunet_ros.cli.survey',
        'first',
    ),
    Verb(
        'compare',
        'measure the distance of two recordings, or of an estimate and a truth',
        'pneunet_ros.cli.compare',
    ),
    Verb(
        'check',
        'list what recordings contain and lack, and what they can be used for',
        'pneunet_ros.cli.check',
    ),
    Verb(
        'export',
        'write the readings of a recording as a table, CSV or npz',
        'pneunet_ros.cli.export',
    ),
    Verb(
        'import',
        'convert a CSV table, whose columns name their units, to a recording',
        'pneunet_ros.cli.import_table',
    ),
    Verb(
        'new-arm',
        'write arm.yaml for an arm of your own, and a printable sheet of its dots',
        'pneunet_ros.cli.new_arm',
    ),
    Verb(
        'effects',
        'list the physical effects that a model can have, with their parameters',
        'pneunet_ros.cli.effects',
    ),
    Verb(
        'simulate',
        'simulate a recording in the virtual lab, and write its truth to a file beside it',
        'pneunet_ros.cli.simulate',
        'first',
    ),
    Verb(
        'urdf',
        'write a URDF of the arm as a chain of links, for robot_state_publisher',
        'pneunet_ros.cli.urdf',
    ),
    Verb(
        'compile',
        'compile all kernels ahead and keep them on the disk',
        'pneunet_ros.cli.compile',
    ),
)
WRONG = 2  # exit code
NEGATIVE_NUMBER = re.compile(r'-(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?')
UNIT_APART = re.compile(r'^unrecognized arguments: ([kMm]?(Pa|Nm?)|[mc]?m|m?bar|psi|k?g)\b')
NEGATIVE_WITH_UNIT = re.compile(rf'({NEGATIVE_NUMBER.pattern})([A-Za-z_]+)')


def parser(words: Sequence[str]) -> ArgumentParser:
    """Build the command line of all verbs, with the options of the one among the words."""
    command = CommandParser(
        prog='pneunet',
        description='The shape of a pneu-net arm, by a rod model and by camera.',
        epilog='Exit codes: 0 done; 1 done, with a negative answer; 2 wrong request or file.',
        allow_abbrev=False,
    )
    command.add_argument('--version', action='version', version=f'pneunet_ros {__version__}')
    verbs = command.add_subparsers(dest='verb', metavar='VERB', required=True)
    for verb in VERBS:
        options = verbs.add_parser(
            verb.name, help=verb.help, description=verb.help, allow_abbrev=False
        )
        if words and words[0] == verb.name:
            if verb.kernels != 'none':
                answer_first()
            module = import_module(verb.module)
            module.options(options)
            options.set_defaults(run=module.run, kernels=verb.kernels)
    return command


def negative_number(argument: str) -> str:
    """Return a negative number so that argparse takes it for no option: -0.00001, '-3 mm'."""
    if NEGATIVE_NUMBER.fullmatch(argument):
        return f'{Decimal(argument):f}'
    if match := NEGATIVE_WITH_UNIT.fullmatch(argument):
        return f'{match[1]} {match[4]}'
    return argument


def complete() -> None:
    """Answer the shell that asks how the command line may go on, and exit."""
    import argcomplete  # an extra: who asks has it

    words = os.environ.get('COMP_LINE', '').split()[1:]
    argcomplete.autocomplete(parser(words))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code."""
    if '_ARGCOMPLETE' in os.environ:
        complete()
    words = sys.argv[1:] if arguments is None else arguments
    try:
        given = parser(words).parse_args([negative_number(word) for word in words])
    except WrongUsageError as error:
        if '--json' in words:
            print_error(error.sentence)
        raise
    try:
        see_to_kernels(given)
        if getattr(given, 'effects_path', None) is not None:
            from pneunet_ros.effects.user_effects import add_effects

            add_effects(given.effects_path)
        code: int = given.run(given)
        sys.stdout.flush()
        return code
    except PneunetError as error:
        return complain(given, str(error))
    except BrokenPipeError:  # the reader of our output has gone, as in `pneunet effects | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # what no file of ours has to do with: a full /tmp, too many files
        about = f'{error.filename}: ' if error.filename else ''
        return complain(given, f'{about}{error.strerror or error}')
    except MemoryError:
        return complain(given, 'there is not enough memory for this')


def see_to_kernels(given: Namespace) -> None:
    """Have the kernels compiled where they are not, before or while the verb works."""
    if given.kernels == 'none' or not jit.is_waiting():
        return
    if given.kernels == 'meanwhile':
        compile_meanwhile()
        say(given, 'the kernels are being compiled in the background, once; numpy answers')
        return
    say(given, 'compiling the kernels, once: about 20 s of CPU')
    from pneunet_ros.cli.verb import progress_bar

    with progress_bar(shown=not given.json) as bar:
        task = bar.add_task('compiling, once', total=None)
        compile_first(lambda: bar.update(task))


def say(given: Namespace, sentence: str) -> None:
    """Say on stderr what a person should know."""
    if not given.json:
        print(f'pneunet {given.verb}: {sentence}', file=sys.stderr)


def complain(given: Namespace, sentence: str) -> int:
    """Say on stderr what was wrong, in one line, to programs also as JSON; returns the code."""
    line = ' '.join(printable(shortened(sentence)).split())
    print(f'pneunet {given.verb}: {line}', file=sys.stderr)
    if given.json:
        print_error(line)
    return WRONG


def print_error(sentence: str) -> None:
    """Print what was wrong as one JSON object on stdout."""
    from pneunet_ros.files.json_text import json_text

    sys.stdout.write(json_text({'error': sentence}))
    sys.stdout.flush()

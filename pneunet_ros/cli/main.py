"""The command `pneunet`: turns errors into a sentence and an exit code."""

from __future__ import annotations

from argparse import Action, ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from decimal import Decimal
from difflib import get_close_matches
from importlib import import_module
import os
import re
import sys
from textwrap import wrap
from typing import Any, Literal, NamedTuple, NoReturn

from pneunet_ros import __version__
from pneunet_ros.core.errors import PneunetError, shorten
from pneunet_ros.core.kernels import jit
from pneunet_ros.core.kernels.cache import compile_first, compile_in_background, use_plain_python
from pneunet_ros.core.printable import printable


class WrongUsageError(SystemExit):
    """Invalid command line; the message is printed to stderr, and `sentence` is for programs."""

    def __init__(self, sentence: str) -> None:
        """Use the exit code of an invalid request."""
        super().__init__(WRONG)
        self.sentence = sentence


class CommandParser(ArgumentParser):
    """A parser that reports an error in one sentence with an example command."""

    def __init__(self, *arguments: Any, example: str = '', **options: Any) -> None:
        """Make a parser; example: a complete command to start from."""
        super().__init__(*arguments, **options)
        self._example = example
        self._words: Sequence[str] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; each verb reports unknown words itself."""
        self._words = args
        given, unexpected = super().parse_known_args(args, namespace)
        if unexpected:
            self.refuse(self._describe_unexpected(unexpected))
        return given, unexpected

    def error(self, message: str) -> NoReturn:
        """Print a usage error and exit."""
        missing = MISSING.fullmatch(message)
        if missing is None:
            self.refuse(message.removeprefix('argument '), example=False)
        if missing['one']:
            problem = f'one of {missing["one"].replace(" ", ", ")} is missing'
        else:
            *leading, last = missing['all'].split(', ')
            problem = (
                f'{", ".join(leading)} and {last} are missing' if leading else f'{last} is missing'
            )
        unexpected = self._unexpected_words()
        self.refuse(
            f'{self._describe_unexpected(unexpected)}, and {problem}' if unexpected else problem
        )

    def refuse(self, sentence: str, *, example: bool = True) -> NoReturn:
        """Print a usage error, with an example command if helpful, and exit."""
        line = printable(shorten(sentence))
        if example:
            line += f'; a complete command: {self._example} (see {self.prog} --help)'
        print(f'{self.prog}: {line}', file=sys.stderr)
        raise WrongUsageError(line)

    def _unexpected_words(self) -> list[str]:
        """Return the unexpected words, which argparse does not report if arguments are missing."""
        for action in self._actions:
            action.required = False
        for group in self._mutually_exclusive_groups:
            group.required = False
        unexpected: list[str] = super().parse_known_args(self._words)[1]
        return unexpected

    def _describe_unexpected(self, words: Sequence[str]) -> str:
        """Describe the unexpected words; a word after an unknown option is its value."""
        if unknown := next((word for word in words if OPTION.match(word)), None):
            name = unknown.partition('=')[0]
            options = [option for action in self._actions for option in action.option_strings]
            return f'{name} is not an option{suggestion(name, options)}'
        hint = ('; write a number and its unit as one word, as in 31kPa') * bool(
            UNIT.match(words[0])
        )
        return f'{" ".join(words)} belong{"s" * (len(words) == 1)} to no option{hint}'


def suggestion(word: str, known: Sequence[str]) -> str:
    """Return a question with the most similar known word."""
    matches = get_close_matches(word, known, 1, 0.75)
    return f' ({matches[0]}?)' if matches else ''


class CommandHelp(RawDescriptionHelpFormatter):
    """Help formatter that omits the list of verbs: the description has them in groups."""

    def add_argument(self, action: Action) -> None:
        """Add an option; skips verbs, which are in the description."""
        if action.dest != 'verb':
            super().add_argument(action)


class Verb(NamedTuple):
    """A verb: its name, its line of help, and a complete command.

    The module in `verbs` is imported on use; `file` is its name if it differs from that of the
    verb. The module has `options(parser)`, which adds the options, and `run(arguments)`, which
    runs the verb and returns the exit code. kernels: 'meanwhile' if the verb runs while kernels
    are compiled, 'first' if it waits for the kernels because it uses them heavily.
    """

    name: str
    help: str
    example: str
    kernels: Literal['none', 'meanwhile', 'first'] = 'none'
    file: str = ''

    @property
    def module(self) -> str:
        """Name of its module."""
        return f'pneunet_ros.cli.verbs.{self.file or self.name.replace("-", "_")}'


VERBS = (
    Verb('demo', "replay the loads of the paper's Table 1 (start here)", 'pneunet demo'),
    Verb(
        'predict',
        'predict the shape under pressure and end load, or the force from the tip position',
        'pneunet predict --pressure 31kPa --force 175mN 70mN',
        'meanwhile',
    ),
    Verb(
        'replay',
        'run the estimator on a recording of pressure and end wrench',
        'pneunet replay REC.mcap --model model.yaml --output replayed.mcap',
        'first',
    ),
    Verb(
        'track',
        'track the targets in camera images: points, smoothed centerline, curvature',
        'pneunet track FILM.mp4 --readings TABLE.csv --model arm.yaml --output REC.mcap',
        'meanwhile',
    ),
    Verb(
        'calibrate',
        'calibrate a model with error bars from recordings without and with end load',
        'pneunet calibrate --unloaded FREE.mcap --loaded PULLED.mcap --arm arm.yaml '
        '--output model.yaml',
        'first',
    ),
    Verb(
        'diagnose',
        'find the physical effect missing in a model; write the augmented model and a report',
        'pneunet diagnose --model model.yaml --train REC1.mcap REC2.mcap --heldout REC3.mcap '
        '--output diagnosis',
        'first',
    ),
    Verb(
        'explore',
        'record, diagnose and choose the next recording until the missing effect is named',
        'pneunet explore --by-hand --model model.yaml --output exploration',
        'first',
    ),
    Verb(
        'survey',
        'check, calibrate and diagnose each of many arms; show them side by side on one page',
        'pneunet survey FOLDER --output survey',
        'first',
    ),
    Verb(
        'compare',
        'compare two recordings, or an estimate with the ground truth',
        'pneunet compare REPLAYED.mcap TRACKED.mcap',
    ),
    Verb(
        'check',
        'list the contents, gaps and possible uses of recordings',
        'pneunet check REC.mcap',
    ),
    Verb(
        'export',
        'export the readings of a recording as a table (CSV or npz)',
        'pneunet export REC.mcap --output table.csv',
    ),
    Verb(
        'import',
        'convert a CSV table to a recording; the column names give the units',
        'pneunet import TABLE.csv --output rec.mcap',
        file='import_table',
    ),
    Verb(
        'new-arm',
        'write arm.yaml for your own arm, and a printable sheet of dots',
        'pneunet new-arm --length 112mm --weight 17g --pressure 60kPa --dot 3mm --targets 12',
    ),
    Verb(
        'effects',
        'list the physical effects that a model can have, with their parameters',
        'pneunet effects',
    ),
    Verb(
        'simulate',
        'simulate a recording in the virtual lab, with its ground truth in a second file',
        'pneunet simulate random_mix --output rec.mcap',
        'first',
    ),
    Verb(
        'urdf',
        'write a URDF of the arm as a chain of links, for robot_state_publisher',
        'pneunet urdf --model model.yaml --output arm.urdf',
    ),
    Verb(
        'mjcf',
        'write the finger as a MuJoCo model: hinges, masses, damping, contact',
        'pneunet mjcf --model model.yaml --output finger.xml',
    ),
    Verb('compile', 'compile all kernels ahead of time and cache them on disk', 'pneunet compile'),
)
# The verbs as listed by the help, grouped by purpose.
GROUPS = {
    'First steps': ('demo', 'new-arm', 'effects', 'compile'),
    'Recordings': ('check', 'track', 'import', 'export', 'compare', 'simulate'),
    'Estimates': ('predict', 'replay', 'urdf', 'mjcf'),
    'Models': ('calibrate', 'diagnose', 'explore', 'survey'),
}
HELP_WIDTH = 90  # columns
WRONG = 2  # exit code
NEGATIVE_NUMBER = re.compile(r'-(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?')
MISSING = re.compile(
    r'the following arguments are required: (?P<all>.*)'
    r'|one of the arguments (?P<one>.*) is required'
)
OPTION = re.compile(r'--?[A-Za-z]')
UNIT = re.compile(r'([kMm]?(Pa|Nm?)|[mc]?m|m?bar|psi|k?g)\b')
NEGATIVE_WITH_UNIT = re.compile(rf'({NEGATIVE_NUMBER.pattern})([A-Za-z_]+)')


def parser(words: Sequence[str], *, ends: bool = False) -> CommandParser:
    """Build the parser of all verbs, with the options of the requested one.

    ends: whether a help request ends the process.
    """
    command = CommandParser(
        prog='pneunet',
        example='pneunet demo',
        description='Estimate the shape of a pneu-net arm with a rod model and a '
        f'camera.\n{verbs_in_groups()}',
        formatter_class=CommandHelp,
        epilog='Exit codes: 0 done; 1 done, but the answer is negative; 2 invalid request '
        'or file.',
        allow_abbrev=False,
    )
    command.add_argument('--version', action='version', version=f'pneunet_ros {__version__}')
    verbs = command.add_subparsers(dest='verb', metavar='VERB', required=True)
    for verb in VERBS:
        options = verbs.add_parser(
            verb.name,
            help=verb.help,
            description=verb.help,
            example=verb.example,
            allow_abbrev=False,
        )
        if words and words[0] == verb.name:
            if ends and {'--help', '-h'} & set(words):
                jit.use_plain_python()  # --help computes nothing and needs no kernels
            elif verb.kernels != 'none':
                use_plain_python()
            module = import_module(verb.module)
            module.options(options)
            options.add_argument(
                '--json',
                action='store_true',
                help='print one JSON object on stdout and nothing else',
            )
            options.set_defaults(run=module.run, kernels=verb.kernels)
    return command


def verbs_in_groups() -> str:
    """Return the verbs by group, each with its help line."""
    helps = {verb.name: verb.help for verb in VERBS}
    width = max(map(len, helps)) + 4
    lines = []
    for title, names in GROUPS.items():
        lines += ['', f'{title}:']
        for name in names:
            first, rest = f'  {name}'.ljust(width), ' ' * width
            lines += wrap(helps[name], HELP_WIDTH, initial_indent=first, subsequent_indent=rest)
    return '\n'.join(lines)


def negative_number(argument: str) -> str:
    """Return a negative number, e.g. '-3 mm', in a form that is not mistaken for an option."""
    if NEGATIVE_NUMBER.fullmatch(argument):
        return f'{Decimal(argument):f}'
    if match := NEGATIVE_WITH_UNIT.fullmatch(argument):
        return f'{match[1]} {match[4]}'
    return argument


def complete() -> None:
    """Print the shell completions of a command line, and exit."""
    import argcomplete  # an optional dependency, needed for completions only

    words = os.environ.get('COMP_LINE', '').split()[1:]
    argcomplete.autocomplete(parser(words))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code."""
    if '_ARGCOMPLETE' in os.environ:
        complete()
    words = sys.argv[1:] if arguments is None else arguments
    try:
        command = parser(words, ends=arguments is None)
        names = [verb.name for verb in VERBS]
        if words and words[0] not in names and not words[0].startswith('-'):
            command.refuse(f'{words[0]!r} is not a verb{suggestion(words[0], names)}')
        given = command.parse_args([negative_number(word) for word in words])
    except WrongUsageError as error:
        if '--json' in words:
            print_error(error.sentence, 'usage')
        raise
    try:
        prepare_kernels(given)
        if getattr(given, 'effects_path', None) is not None:
            from pneunet_ros.effects.user_effects import add_effects

            add_effects(given.effects_path)
        code: int = given.run(given)
        sys.stdout.flush()
        return code
    except PneunetError as error:
        return report_error(given, str(error), error.reason)
    except BrokenPipeError:  # the reading process has ended, as in `pneunet effects | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # no error of an input or output: a full /tmp, too many open files
        about = f'{error.filename}: ' if error.filename else ''
        return report_error(given, f'{about}{error.strerror or error}', 'system')
    except MemoryError:
        return report_error(given, 'not enough memory', 'memory')


def prepare_kernels(given: Namespace) -> None:
    """Compile missing kernels, before the verb runs or while it runs."""
    if given.kernels == 'none' or not jit.is_waiting():
        return
    if given.kernels == 'meanwhile':
        compile_in_background()
        say(given, 'compiling the kernels in the background (once only); using numpy meanwhile')
        return
    say(given, 'compiling the kernels (once only): about 20 s of CPU')
    from pneunet_ros.cli.verb import progress_bar

    with progress_bar(shown=not given.json) as bar:
        task = bar.add_task('compiling, once', total=None)
        compile_first(lambda: bar.update(task))


def say(given: Namespace, sentence: str) -> None:
    """Print a message for users on stderr."""
    if not given.json:
        print(f'pneunet {given.verb}: {sentence}', file=sys.stderr)


def report_error(given: Namespace, sentence: str, reason: str) -> int:
    """Print an error as one line on stderr, and with --json as JSON; return the exit code."""
    line = ' '.join(printable(shorten(sentence)).split())
    print(f'pneunet {given.verb}: {line}', file=sys.stderr)
    if given.json:
        print_error(line, reason)
    return WRONG


def print_error(sentence: str, reason: str) -> None:
    """Print an error as one JSON object on stdout."""
    from pneunet_ros.files.json_text import json_text

    sys.stdout.write(json_text({'error': sentence, 'reason': reason}))
    sys.stdout.flush()

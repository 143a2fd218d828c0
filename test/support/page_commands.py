"""Commands on the pages: found as they stand there, run as a reader types them.

A fenced block is run by what stands behind the fence:

- `sh`: a script; no command of it may fail. Nodes run until they are ready, then until Ctrl-C.
- `console`: lines that begin with `$ ` are run, what they print must be what stands below.
- `python` with `>>>`: a doctest; without: a script whose output is the `text` block after it.

The line before a fence may say more, in a comment that a forge does not show:

- `<!-- slow -->`: takes longer than some seconds; run by `make test-all`.
- `<!-- slow; answers no -->`: as well, and a verb may end with 1: done, the answer is negative.
- `<!-- not run: why -->`: needs what no package index has, or a display.
- `<!-- part of: file -->`: an extract; test_page_commands holds that it stands in that file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import doctest
from itertools import groupby
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import time
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
DOCS = [page for page in (ROOT / 'docs').glob('*.md') if page.name != 'index.md']  # it is made
PAGES = sorted([*ROOT.glob('*.md'), *DOCS, *(ROOT / 'bags').glob('*/README.md')])
BLOCK = re.compile(
    r'(?:^ *<!-- (?P<remark>[^\n]*) -->\n)?'
    r'^(?P<indent> *)```(?P<kind>\w*)\n(?P<content>.*?)^(?P=indent)```$',
    re.MULTILINE | re.DOTALL,
)
COMMAND = re.compile(r'^\$ ((?:.*\\\n)*.*)\n', re.MULTILINE)
FILE_NAME = re.compile(r'# \S+/\S+\.py\n')  # a file to be made: test_extending makes it
NUMBER = re.compile(r'(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?')
NODES = (
    'pneunet-estimator',
    'pneunet-tracker',
    'pneunet-fusion',
    'pneunet-virtual-arm',
    'pneunet-gripper',
    'pneunet-stack',
)
ANSWERS_NO = 'pneunet() { command pneunet "$@" || test $? = 1; }\n'
RUN_KINDS = ('sh', 'console', 'python')
START_TIMEOUT = 240.0  # s; kernels may have to be compiled
COMMAND_TIMEOUT = 1800.0  # s; nothing takes that long, but a machine may be busy


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A fenced block of a page; expected: the `text` block right after a script of Python."""

    page: str
    line: int
    kind: str
    content: str
    remark: str
    expected: str | None = None

    @property
    def reason_not_run(self) -> str:
        """Why it is not run, or nothing."""
        return self.remark.removeprefix('not run: ') if self.remark.startswith('not run: ') else ''

    @property
    def whole(self) -> str | None:
        """The file of which it is an extract."""
        _, _, file = self.remark.partition('part of: ')
        return file or None

    @property
    def is_run(self) -> bool:
        """Whether it is run here."""
        if self.kind not in RUN_KINDS or FILE_NAME.match(self.content):
            return False
        return not self.reason_not_run and not self.whole

    @property
    def commands(self) -> list[str]:
        """Its commands, each in one line, without remarks."""
        text = self.content
        if self.kind == 'console':
            text = '\n'.join(COMMAND.findall(text))
        lines = text.replace('\\\n', ' ').splitlines()
        return [said for line in lines if (said := re.sub(r'(^|\s)#.*', '', line).strip())]


def blocks_of(page: Path) -> list[Block]:
    """Return the fenced blocks of a page, in their order."""
    text = page.read_text(encoding='utf-8')
    name = page.relative_to(ROOT).as_posix()
    matches = list(BLOCK.finditer(text))
    blocks = []
    for match, after in zip(matches, [*matches[1:], None], strict=False):
        expected = None
        if match['kind'] == 'python' and after is not None and after['kind'] == 'text':
            between = text[match.end() : after.start()]
            expected = None if between.strip() else after['content']
        blocks.append(
            Block(
                page=name,
                line=text[: match.start()].count('\n') + 1,
                kind=match['kind'],
                content=re.sub(rf'^{match["indent"]}', '', match['content'], flags=re.MULTILINE),
                remark=match['remark'] or '',
                expected=expected,
            )
        )
    return blocks


def environment() -> dict[str, str]:
    """Return that of a reader who has just installed the package and is in a checkout."""
    programs = f'{Path(sys.executable).parent}{os.pathsep}{os.environ["PATH"]}'
    return os.environ | {'PATH': programs, 'COLUMNS': '100'}


class Printed(NamedTuple):
    """What a command printed, what the page shows of that, and what stands before it there."""

    before: str
    shown: str
    printed: str


def run_block(block: Block, folder: Path) -> list[Printed]:
    """Run a block in a folder; returns what was printed, as far as the page shows it."""
    if block.kind == 'console':
        return [
            Printed(f'$ {command}\n', shown, run_shell(command, folder))
            for command, shown in shown_in(block.content)
        ]
    if block.kind == 'python':
        return run_python(block, folder)
    if any(started_node(line) for line in block.commands):
        run_nodes(block.commands, folder)
    else:
        run_shell(ANSWERS_NO * block.remark.endswith('answers no') + block.content, folder)
    return []


def folder_after(block: Block, folder: Path) -> Path:
    """Return the folder in which a reader is who typed the commands of a block in this one."""
    for line in block.commands:
        for name in re.findall(r'(?:^|&& )cd (\S+)', line):
            folder = folder / name
    return folder


def shown_in(content: str) -> Iterator[tuple[str, str]]:
    """Yield every command of a console and what is shown below it."""
    parts = COMMAND.split(content)
    assert not parts[0], 'a console begins with `$ ` and a command'
    yield from zip(parts[1::2], parts[2::2], strict=True)


def run_shell(script: str, folder: Path) -> str:
    """Run commands, none of which may fail; returns what they print, but for what stderr says."""
    script = re.sub(r'^make ', 'make --dry-run ', script, flags=re.MULTILINE)
    done = subprocess.run(
        ['bash', '-euo', 'pipefail', '-c', script],
        cwd=folder,
        env=environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=COMMAND_TIMEOUT,
    )
    assert done.returncode == 0, f'{script}\n{done.stdout}{done.stderr}'
    return done.stdout


def run_python(block: Block, folder: Path) -> list[Printed]:
    """Run an example of Python as a script or a doctest."""
    if '>>>' not in block.content:
        done = subprocess.run(
            [sys.executable, '-c', block.content],
            cwd=folder,
            env=environment(),
            capture_output=True,
            text=True,
            timeout=COMMAND_TIMEOUT,
        )
        assert done.returncode == 0, done.stderr
        if block.expected is None:
            return []
        return [Printed('```text\n', block.expected, done.stdout)]
    test = doctest.DocTestParser().get_doctest(block.content, {}, block.page, block.page, 0)
    runner = doctest.DocTestRunner(verbose=False)
    before = Path.cwd()
    os.chdir(folder)
    try:
        runner.run(test)
    finally:
        os.chdir(before)
    assert runner.tries and not runner.failures, block.page
    return []


def started_node(line: str) -> str | None:
    """Return the command with which a line starts a node, or None.

    `ros2 run pneunet_ros NODE` starts the same entry point as `pneunet-NODE`.
    """
    line = line.removesuffix('&').strip().removeprefix('.venv/bin/')
    found = re.match(r'ros2 run pneunet_ros (\w+)(.*)', line)
    if found:
        line = f'pneunet-{found[1].replace("_", "-")}{found[2]}'
    return line if line.startswith(NODES) else None


def run_nodes(lines: list[str], folder: Path) -> None:
    """Start nodes and what talks to them, and end all of them by Ctrl-C, without an error."""
    running: list[tuple[str, subprocess.Popen[bytes], Path]] = []
    try:
        for place, line in enumerate(lines):
            command = started_node(line)
            output = folder / f'node_{place}.txt'
            with output.open('w') as stream:
                process = subprocess.Popen(
                    ['bash', '-c', f'exec {command or line.removesuffix("&")}'],
                    cwd=folder,
                    env=environment(),
                    stdout=stream,
                    stderr=stream,
                )
            running.append((line, process, output))
            wait_for_word('ready' if command else ' ', line, process, output)
        for line, process, output in reversed(running):
            assert process.poll() is None, f'{line}\n{output.read_text()}'
            process.send_signal(signal.SIGINT)
            assert process.wait(START_TIMEOUT) == 0, f'{line}\n{output.read_text()}'
    finally:
        for _, process, _ in running:
            if process.poll() is None:
                process.kill()
                process.wait()


def wait_for_word(word: str, line: str, process: subprocess.Popen[bytes], output: Path) -> None:
    """Wait until a program has said a word: a node that it is ready, another one anything."""
    end = time.monotonic() + START_TIMEOUT
    while word not in output.read_text():
        assert process.poll() is None, f'{line}\n{output.read_text()}'
        assert time.monotonic() < end, f'{line}\n{output.read_text()}'
        time.sleep(0.05)


def agree(shown: str, printed: str) -> bool:
    """Whether what a page shows is what was printed, word by word; `...` is any words.

    Numbers may differ by two of the last digit shown or by 2 %, as libraries of other versions
    round otherwise; the length of lines of tables does not count.
    """
    words, place = _words(printed), 0
    runs = [list(run) for is_run, run in groupby(_words(shown), '...'.__ne__) if is_run]
    starts, ends = not shown.lstrip().startswith('...'), not shown.rstrip().endswith('...')
    for index, run in enumerate(runs):
        last = len(words) - len(run)
        places = range(place, last + 1)
        if index == 0 and starts:
            places = range(min(1, last + 1))
        if index == len(runs) - 1 and ends:
            places = range(max(last, places.start), places.stop)
        found = (at for at in places if all(map(_same, run, words[at : at + len(run)])))
        place = next(found, -len(run) - 1) + len(run)
        if place < 0:
            return False
    return place == len(words) or not ends


def _words(text: str) -> list[str]:
    return re.sub(r'([━─])\1*', r'\1', text).split()


def _same(shown: str, printed: str) -> bool:
    """Whether two words are the same but for the rounding of numbers."""
    if NUMBER.sub('#', shown) != NUMBER.sub('#', printed):
        return False
    return all(map(_near, NUMBER.findall(shown), NUMBER.findall(printed)))


def _near(shown: str, printed: str) -> bool:
    mantissa, _, exponent = shown.lower().partition('e')
    decimals = len(mantissa.partition('.')[2])
    last_digit = 10.0 ** (int(exponent or 0) - decimals) if decimals else 0.0
    wrong = abs(float(shown) - float(printed))
    return wrong <= max(2.001 * last_digit, 0.02 * abs(float(shown)))


def rewrite(page: Path, before: str, shown: str, printed: str) -> None:
    """Put what was printed in the place of what a page shows."""
    text = page.read_text(encoding='utf-8')
    printed = '\n'.join(line.rstrip() for line in printed.strip('\n').splitlines())
    after = f'{printed}\n' if printed else ''
    assert text.count(before + shown) == 1, f'{page.name}: not there once:\n{before}{shown}'
    page.write_text(text.replace(before + shown, before + after), encoding='utf-8')

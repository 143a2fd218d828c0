"""Run one case in a forked process with limits, and check its outcome."""

from __future__ import annotations

import csv
from dataclasses import dataclass
import os
from pathlib import Path
import resource
import shutil
import signal
import sys
import time
import traceback
from typing import Any, NamedTuple

import cv2
from matplotlib.image import imread
import numpy as np
from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import PneunetError
from pneunet_ros.files.yaml_file import YamlFile
from pneunet_ros.recordings.recording import open_recording, Recording

from hostile.corpus import Corpus
from hostile.place import Case

LIMITS: dict[str, float] = {
    'seconds': 20.0,  # of processor
    'patience': 90.0,  # s; a verb that waits for something takes no processor
    'megabytes': 1000.0,
    'address_space': 3_000_000_000,  # bytes beyond what is mapped already
    'said': 6000,  # characters on stderr; one sentence has at most a third
}
CRASHED = 70  # exit code of a traceback
CODES = (0, 1, 2)


class Problem(NamedTuple):
    """What must not be: its kind, and what it was."""

    kind: str
    text: str

    def __str__(self) -> str:
        """Return both, in one line."""
        return f'{self.kind}: {" ".join(self.text.split())[-400:]!r}'


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """How a case ended."""

    code: int
    seconds: float
    megabytes: float
    problems: tuple[Problem, ...]


def run_case(case: Case, corpus: Corpus) -> Finding:
    """Run a case and look at what it left."""
    before = {path.name for path in case.folder.iterdir()}
    said = {name: Pipe() for name in ('out', 'err')}
    started = time.perf_counter()
    child = os.fork()
    if child == 0:
        _be_the_verb(case, list(said.values()))
    for pipe in said.values():
        pipe.listen()
    code, usage, waited = _wait(child, started, case, list(said.values()))
    texts = {name: pipe.text() for name, pipe in said.items()}
    seconds = usage.ru_utime + usage.ru_stime
    finding = Finding(
        code=code,
        seconds=seconds,
        megabytes=usage.ru_maxrss / 1e3,
        problems=tuple(_problems(case, corpus, code, texts, usage, waited, before)),
    )
    if not finding.problems:
        shutil.rmtree(case.folder, ignore_errors=True)
    return finding


class Pipe:
    """What a child says: no limit on the size of files holds for it."""

    def __init__(self) -> None:
        """Open both ends."""
        self.reader, self.writer = os.pipe()
        self.heard = bytearray()

    def listen(self) -> None:
        """Be the side that reads, without waiting."""
        os.close(self.writer)
        os.set_blocking(self.reader, False)

    def hear(self) -> None:
        """Take what there is."""
        try:
            while part := os.read(self.reader, 1 << 16):
                self.heard += part
        except BlockingIOError:
            pass

    def text(self) -> str:
        """Return all that was said, and close."""
        self.hear()
        os.close(self.reader)
        return self.heard.decode(errors='surrogateescape')


def _be_the_verb(case: Case, said: list[Pipe]) -> None:
    """Run the verb in this forked process, and end it."""
    code = CRASHED
    try:
        for number, pipe in enumerate(said, start=1):
            os.dup2(pipe.writer, number)
        sys.stdout = os.fdopen(1, 'w', encoding='utf-8')
        sys.stderr = os.fdopen(2, 'w', encoding='utf-8', errors='backslashreplace')
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.chdir(case.folder)
        mapped = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
        limit = mapped + int(LIMITS['address_space'])
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        seconds = int(case.seconds or LIMITS['seconds'])
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))  # SIGXCPU, then SIGKILL
        if case.room is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (case.room, case.room))
        code = main(list(case.words))
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else CRASHED
    except BaseException:
        os.write(2, traceback.format_exc()[-4000:].encode(errors='backslashreplace'))
    finally:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except Exception:
                code = CRASHED
        os._exit(code)


def _wait(child: int, started: float, case: Case, said: list[Pipe]) -> tuple[int, Any, bool]:
    """Wait for a child; returns exit code (or -signal), usage, and whether it took too long."""
    patience = LIMITS['patience'] + 4.0 * (case.seconds or 0.0)
    patience = patience if case.kill is None else case.kill
    while True:
        for pipe in said:
            pipe.hear()
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status), usage, False
        if time.perf_counter() - started > patience:
            os.kill(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return os.waitstatus_to_exitcode(status), usage, case.kill is None
        time.sleep(0.002)


def _problems(
    case: Case,
    corpus: Corpus,
    code: int,
    said: dict[str, str],
    usage: Any,
    waited: bool,
    before: set[str],
) -> list[Problem]:
    """List all that must not be."""
    found = []
    if (
        waited
        or usage.ru_utime + usage.ru_stime >= (case.seconds or LIMITS['seconds'])
        or code == -signal.SIGXCPU
    ):
        found.append(Problem('hang', ' '.join(case.words)))
    elif code not in CODES and not (case.kill is not None and code == -signal.SIGKILL):
        found.append(Problem('traceback', f'code {code}: {said["err"][-3000:]}'))
    if usage.ru_maxrss / 1e3 > LIMITS['megabytes'] or 'not enough memory' in said['err']:
        found.append(Problem('memory', f'{usage.ru_maxrss / 1e3:.0f} MB'))
    if len(said['err']) > LIMITS['said']:
        found.append(Problem('words', f'{len(said["err"])} characters'))
    for name, text in said.items():
        bare = text.replace('\n', '').replace('\t', '')
        if any(not letter.isprintable() and ord(letter) < 0x3000 for letter in bare):
            found.append(Problem('control', f'{name}: {text!r}'))
    if 'Warning: ' in said['err']:
        found.append(Problem('warning', said['err']))
    found += _wrong_outputs(case, code)
    if case.kill is None and code != -signal.SIGKILL:
        left = [path.name for path in case.folder.rglob('.pneunet-*')]
        if left:
            found.append(Problem('left', ', '.join(left)))
    if case.read_back is not None and code in CODES:
        found += _silent_change(case, corpus, said)
    return found


def _wrong_outputs(case: Case, code: int) -> list[Problem]:
    """List outputs that are not whole, that stand there after a refusal, or that are not there."""
    found = []
    for path in case.outputs:
        if path.exists():
            if code == 2:
                found.append(Problem('written', f'{path.name} in spite of a refusal'))
            wrong = fault_of(path)
            if wrong:
                found.append(Problem('half', f'{path.name}: {wrong}'))
    there = {path.exists() for path in case.outputs}
    if len(there) > 1:
        found.append(Problem('half', 'some of the outputs stand there, and some do not'))
    return found


def fault_of(path: Path) -> str:
    """Return why a file of this suffix is not whole; empty where it is."""
    try:
        if path.suffix == '.mcap':
            recording = open_recording(path)
            for _ in recording.messages([topic.name for topic in recording.topics]):
                pass
            return '; '.join(recording.sentences)
        if path.suffix == '.npz':
            with path.open('rb') as binary, np.load(binary) as content:
                for name in content.files:
                    content[name]
        elif path.suffix == '.csv':
            with path.open(newline='') as stream:
                lengths = {len(row) for row in csv.reader(stream)}
            return '' if len(lengths) == 1 else f'rows of {lengths} cells'
        elif path.suffix == '.yaml':
            YamlFile(kind='file', error=PneunetError).load(path, lambda content: content)
        elif path.suffix == '.png':
            imread(path)
        elif path.suffix == '.mp4':
            return '' if cv2.VideoCapture(str(path)).grab() else 'no frame can be read'
        elif path.is_dir() and not any(path.iterdir()):
            return 'an empty folder'
    except Exception as error:
        return repr(error)
    return ''


def _silent_change(case: Case, corpus: Corpus, said: dict[str, str]) -> list[Problem]:
    """Say whether readings changed and nothing said so, neither the recording nor the verb."""
    assert case.read_back is not None
    try:
        recording = open_recording(case.read_back)
        after = content_of(recording)
    except PneunetError:
        return []
    if recording.sentences or after == content_of(
        open_recording(corpus.whole(case.read_back.name))
    ):
        return []
    return [Problem('silent', f'{case.read_back.name} reads otherwise: {said["out"][:200]}')]


def content_of(recording: Recording) -> list[Any]:
    """Return all that a recording says: its topics and its messages."""
    topics = [(topic.name, topic.type, topic.definition) for topic in recording.topics]
    return [topics, list(recording.raw_messages([name for name, _, _ in topics]))]

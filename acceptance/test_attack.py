"""The attack: its inputs are the same whenever they are made, and it sees what must not be."""

from __future__ import annotations

from pathlib import Path
import random
import resource
import sys
import time

from hostile.corpus import Corpus
from hostile.mutations import damage_bytes, damage_text, flip_bit
from hostile.place import Case
import hostile.running
from hostile.running import fault_of, run_case
from pneunet_ros.core.errors import RecordingError
import pytest

WHOLE = bytes(range(256)) * 4


@pytest.fixture
def corpus(tmp_path):
    for name in ('whole', 'trials', 'case'):
        (tmp_path / name).mkdir()
    return Corpus(folder=tmp_path / 'whole', trials=tmp_path / 'trials')


def resident_megabytes() -> float:
    """Return what this process holds, and a forked one begins with."""
    pages = int(Path('/proc/self/statm').read_text(encoding='ascii').split()[1])
    return pages * resource.getpagesize() / 1e6


@pytest.fixture(autouse=True)
def room(monkeypatch):
    """Count what a verb takes beyond what the process of the tests holds already."""
    allowed = resident_megabytes() + hostile.running.LIMITS['megabytes']
    monkeypatch.setitem(hostile.running.LIMITS, 'megabytes', allowed)


@pytest.mark.parametrize('mutation', [flip_bit, damage_bytes, damage_text])
def test_a_mutation_is_that_of_its_seed(mutation):
    made = [mutation(WHOLE, random.Random(seed)) for seed in (1, 1, 2)]
    assert made[0] == made[1] != WHOLE
    assert made[2] != made[0]


def fails() -> int:
    raise KeyError('a traceback')


def prints_commands() -> int:
    print('\x1b[2J')
    return 0


def says_too_much() -> int:
    print('x' * 10_000, file=sys.stderr)
    return 2


def takes_memory() -> int:
    return len(b'x' * 800_000_000)


def takes_time() -> int:
    while True:
        pass


def waits() -> int:
    time.sleep(1000)
    return 0


def writes_half() -> int:
    Path('out.npz').write_bytes(b'PK\3\4 half')
    return 0


def writes_and_refuses() -> int:
    Path('out.npz').write_bytes(b'')
    return 2


def leaves_scratch() -> int:
    Path('.pneunet-1.partial').mkdir()
    return 0


def behaves() -> int:
    print('done')
    return 0


@pytest.mark.parametrize(
    ('verb', 'kind'),
    [
        (fails, 'traceback'),
        (prints_commands, 'control'),
        (says_too_much, 'words'),
        (takes_memory, 'memory'),
        (takes_time, 'hang'),
        (waits, 'hang'),
        (writes_half, 'half'),
        (writes_and_refuses, 'written'),
        (leaves_scratch, 'left'),
        (behaves, ''),
    ],
)
def test_what_must_not_be_is_seen(corpus, tmp_path, monkeypatch, verb, kind):
    monkeypatch.setattr(hostile.running, 'main', lambda words: verb())
    # To take memory is slow on some machines, and is no hang.
    seconds, patience = (1.0, 2.0) if kind == 'hang' else (30.0, 20.0)
    limits = {'seconds': seconds, 'patience': patience, 'megabytes': resident_megabytes() + 250.0}
    monkeypatch.setattr(hostile.running, 'LIMITS', hostile.running.LIMITS | limits)
    outputs = (tmp_path / 'case' / 'out.npz',)
    case = Case(kind='made', folder=tmp_path / 'case', words=('verb',), outputs=outputs)
    found = run_case(case, corpus)
    kinds = [problem.kind for problem in found.problems][:1]
    assert kinds == ([kind] if kind else []), found.problems


def test_a_change_that_is_not_said_is_seen(corpus, tmp_path, monkeypatch):
    from support.made_recordings import write_by_mcap

    options = {'enable_crcs': False, 'use_chunking': False}
    whole = write_by_mcap(corpus.whole('r.mcap'), list(range(20)), **options)
    path = tmp_path / 'case' / 'r.mcap'
    path.write_bytes(whole.read_bytes())
    case = Case(kind='made', folder=path.parent, words=('verb',), read_back=path)
    monkeypatch.setattr(hostile.running, 'main', lambda words: 0)
    assert run_case(case, corpus).problems == ()
    path.parent.mkdir()
    raw = bytearray(whole.read_bytes())
    raw[raw.index(b'pneunet_base')] ^= 1
    path.write_bytes(raw)
    assert [problem.kind for problem in run_case(case, corpus).problems] == ['silent']


def test_half_files_are_known_as_such(tmp_path):
    (tmp_path / 'a.csv').write_text('a,b\n1,2\n3\n')
    (tmp_path / 'b.csv').write_text('a,b\n1,2\n')
    (tmp_path / 'c.mcap').write_bytes(b'')
    assert fault_of(tmp_path / 'a.csv')
    assert not fault_of(tmp_path / 'b.csv')
    assert RecordingError.__name__ in fault_of(tmp_path / 'c.mcap')

"""A few of the recordings with wrong readings, and right ones, as the whole run asks of all."""

from __future__ import annotations

from pathlib import Path

import pytest
import wrong_readings as bench

MODEL = bench.ROOT / 'config/paper_arm.yaml'
CASES = dict(bench.cases())
NAMES = (
    'table1 in psi',
    'table1 reversed',
    'table1 absolute in hPa, air 101100',
    'table1 in frame cell',
    'loaded force turned by 180',
    'heldout zero -9000',
)


@pytest.fixture(scope='module')
def messages():
    return {name: bench.read(path) for name, (path, _) in bench.SOURCES.items()}


@pytest.mark.parametrize('name', NAMES)
def test_wrong_readings_are_named_and_give_no_estimates(messages, tmp_path, name):
    source, change, expected = CASES[name]
    path = tmp_path / 'wrong'
    bench.write(path, change(messages[source]))
    code, settings = bench.named(path, MODEL)
    assert (code, settings.keys()) == (1, expected.keys())
    assert all(value in (None, settings[key]) for key, value in expected.items())
    assert bench.replayed(path, MODEL) == (1, 0)


@pytest.mark.parametrize('source', bench.SOURCES)
def test_right_readings_are_not_accused(messages, tmp_path, source):
    path: Path = tmp_path / 'right'
    bench.write(path, messages[source])
    assert bench.named(path, MODEL) == (0, {})


def test_there_are_sixty():
    assert len(CASES) == len(bench.cases()) == 60

"""What fuzz tests share: how many examples, how bytes and texts are damaged, and when one hangs.

Few examples, the same in every run, by default; many, and new ones each time, for `slow` tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal
from typing import Any

from hypothesis import given, HealthCheck, settings
from hypothesis import strategies as st
from pneunet_ros.core.errors import PneunetError
import pytest

FEW, MANY = 60, 3000
HANG = 120  # s; no example takes that long, on whatever machine
AMOUNTS = pytest.mark.parametrize(
    'examples',
    [pytest.param(FEW, id='few'), pytest.param(MANY, id='many', marks=pytest.mark.slow)],
)


def fuzz(examples: int, body: Callable[..., None], **strategies: Any) -> None:
    """Run a body with so many examples; few of them are always the same ones."""
    chosen = settings(
        max_examples=examples,
        derandomize=examples == FEW,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    chosen(given(**strategies)(body))()


@contextmanager
def no_hang() -> Iterator[None]:
    """Fail instead of running forever."""

    def stop(number: int, frame: Any) -> None:
        pytest.fail(f'no answer within {HANG} s')

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(HANG)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def answer(attempt: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Return a result, or the error of ours that is one sentence; anything else passes through."""
    with no_hang():
        try:
            return attempt(*arguments, **named)
        except PneunetError as error:
            sentence = str(error)
            assert sentence
            assert len(sentence) < 3000
            return error


@st.composite
def damaged_bytes(draw: Any, whole: bytes) -> bytes:
    """Draw bytes with some changed, taken out, put in, doubled, or cut off at the end."""
    raw = bytearray(whole)
    for _ in range(draw(st.integers(1, 6))):
        place = draw(st.integers(0, max(len(raw) - 1, 0)))
        length = draw(st.sampled_from([1, 1, 1, 2, 4, 8, 16, 200]))
        kind = draw(st.sampled_from(['set', 'set', 'set', 'extreme', 'cut', 'insert', 'double']))
        if kind == 'set' and raw:
            raw[place] = draw(st.integers(0, 255))
        elif kind == 'extreme':
            raw[place : place + length] = draw(st.sampled_from([b'\xff', b'\0', b'\x7f'])) * length
        elif kind == 'cut':
            del raw[place : place + length]
        elif kind == 'insert':
            raw[place:place] = draw(st.binary(min_size=1, max_size=16))
        else:
            raw[place:place] = raw[place : place + length]
    if draw(st.integers(0, 4)) == 0:
        del raw[draw(st.integers(0, len(raw))) :]
    return bytes(raw)


@st.composite
def damaged_text(draw: Any, whole: str, scraps: st.SearchStrategy[str]) -> str:
    """Draw a text in which some places hold scraps instead of what was there."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(whole)))
        end = min(start + draw(st.integers(0, 14)), len(whole))
        whole = whole[:start] + draw(scraps) + whole[end:]
    return whole


@st.composite
def damaged_tree(draw: Any, tree: Any, leaves: st.SearchStrategy[Any]) -> Any:
    """Draw a tree of mappings and lists with something else in some of its places."""
    if draw(st.integers(0, 11)) == 0:
        return draw(leaves)
    if isinstance(tree, dict):
        found = {key: draw(damaged_tree(value, leaves)) for key, value in tree.items()}
        if found and draw(st.integers(0, 19)) == 0:
            del found[draw(st.sampled_from(sorted(found)))]
        return found
    if isinstance(tree, list):
        return [draw(damaged_tree(value, leaves)) for value in tree]
    return tree

"""What is refused is known by its reason: sentences may be rewritten, reasons may not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import json

from pneunet_ros.core.errors import PneunetError
import pytest


@contextmanager
def refused(error: type[PneunetError], reason: str) -> Iterator[pytest.ExceptionInfo]:
    """Expect this error for this reason."""
    with pytest.raises(error) as caught:
        yield caught
    assert caught.value.reason == reason, caught.value


def reasons(notes: Iterable[str]) -> list[str]:
    """Return the keys of notes, '' for a sentence without one."""
    return [getattr(note, 'reason', '') for note in notes]


def refusal(said: tuple[int, str, str]) -> str:
    """Return why a command with --json was refused, of its exit code, stdout and stderr.

    People are told in one line.
    """
    code, out, err = said
    assert code == 2, out
    assert err.count('\n') == 1, err
    return json.loads(out)['reason']

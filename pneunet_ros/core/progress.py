"""Progress reports of long work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Called with the stage, the progress in it, and its total (0: unknown).
OnProgress = Callable[[str, int, int], None]


def ignore_progress(stage: str, done: int, total: int) -> None:
    """Ignore a progress report."""


def part_of(on_progress: OnProgress, part: int, parts: int) -> OnProgress:
    """Return a progress display that prefixes each stage with its part of the whole work."""
    return lambda stage, done, total: on_progress(f'{part}/{parts} {stage}', done, total)


_READING: ContextVar[OnProgress] = ContextVar('reading', default=ignore_progress)
STEP = 1000  # messages or rows between two reports


@contextmanager
def reporting_to(on_progress: OnProgress) -> Iterator[None]:
    """Send progress reports of reading and writing to a function within this context."""
    token = _READING.set(on_progress)
    try:
        yield
    finally:
        _READING.reset(token)


def report_progress(stage: str, done: int, total: int) -> None:
    """Report the progress of reading or writing a file."""
    _READING.get()(stage, done, total)

"""Deferred interrupts, for work that must be completed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import signal
import threading
from types import FrameType
from typing import Any

_held: list[int] | None = None  # signals that came while something is completed


@dataclass(frozen=True, slots=True)
class Deferrable:
    """A handler of signals that waits for what must be completed.

    Work that finds it in use leaves it there: to put another one in its place would also take away
    the handlers that a library in C, such as rclpy, has put before it.
    """

    handler: Callable[[int, FrameType | None], Any]

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal, now or afterwards."""
        if _held is None:
            self.handler(number, frame)
        else:
            _held.append(number)


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Defer an interrupt (SIGINT, and what else is `Deferrable`) until the block has finished.

    Only the main thread is ever interrupted; in others nothing has to be held back.
    """
    global _held
    if threading.current_thread() is not threading.main_thread() or _held is not None:
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    held = _held = []
    if not isinstance(before, Deferrable):
        signal.signal(signal.SIGINT, Deferrable(signal.default_int_handler))
    try:
        yield
    finally:
        if not isinstance(before, Deferrable):
            # None: a handler that is not of Python, and cannot be set from here.
            signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
        _held = None
        if held:
            signal.raise_signal(held[0])


def forget_interrupt() -> None:
    """Let the process end with its exit code after a KeyboardInterrupt that was caught.

    Python notes an interrupt that leaves code made from text (dataclasses, numba and attrs make
    theirs so) as one that nobody caught, and at the end kills itself with SIGINT whatever the
    program returned. The next text that runs takes the note away.
    Source: run_eval_code_obj and Py_RunMain of CPython 3.8 to 3.13.
    """
    exec('')

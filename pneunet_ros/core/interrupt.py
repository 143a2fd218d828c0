"""Deferred interrupts, for work that must be completed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import signal
import threading
from types import FrameType
from typing import Any

_held: list[int] | None = None  # signals received during a critical section


@dataclass(frozen=True, slots=True)
class Deferrable:
    """A signal handler that can be deferred until critical work is complete.

    A handler that is already installed is not replaced for the deferral, because this would also
    remove handlers that a C library, such as rclpy, has installed in front of it.
    """

    handler: Callable[[int, FrameType | None], Any]

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal, now or after the deferral."""
        if _held is None:
            self.handler(number, frame)
        else:
            _held.append(number)


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Defer an interrupt (SIGINT and other `Deferrable` signals) until the block has finished.

    Only the main thread is interrupted, so other threads need no deferral.
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
            # None: a handler that was not set by Python, and cannot be restored from here.
            signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
        _held = None
        if held:
            signal.raise_signal(held[0])


def clear_interrupt() -> None:
    """Keep the exit code of the process after a KeyboardInterrupt that was caught.

    If an interrupt passes through code that was compiled from text (as by dataclasses, numba and
    attrs), Python records it as uncaught, and finally kills itself with SIGINT whatever the
    program returned. Executing any other text clears the record. Source: run_eval_code_obj and
    Py_RunMain of CPython 3.8 to 3.13.
    """
    exec('')

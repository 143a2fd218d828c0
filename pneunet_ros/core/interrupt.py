"""Deferred interrupts, for work that must be completed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import signal
import threading


@contextmanager
def interrupted_afterwards() -> Iterator[None]:
    """Defer an interrupt (SIGINT) until the block has finished.

    Only the main thread is ever interrupted; in others nothing has to be held back.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: held.append(number))
    try:
        yield
    finally:
        # None: a handler that is not of Python, and cannot be set from here.
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
        if held:
            signal.raise_signal(signal.SIGINT)


def forget_interrupt() -> None:
    """Let the process end with its exit code after a KeyboardInterrupt that was caught.

    Python notes an interrupt that leaves code made from text (dataclasses, numba and attrs make
    theirs so) as one that nobody caught, and at the end kills itself with SIGINT whatever the
    program returned. The next text that runs takes the note away.
    Source: run_eval_code_obj and Py_RunMain of CPython 3.8 to 3.13.
    """
    exec('')

"""Pauses in which a long computation lets urgent work run in its thread.

A computation of milliseconds calls `pause` between its steps. A caller registers urgent work with
`work_in_pauses`; otherwise `pause` does nothing. The urgent work must not touch the data of the
computation, so that the result does not depend on it.
"""

from __future__ import annotations

from collections.abc import Callable
import threading


class InPauses(threading.local):
    """The registered work of each thread."""

    def __init__(self) -> None:
        self.work: list[Callable[[], None]] = []


IN_PAUSES = InPauses()


def pause() -> None:
    """Run pending urgent work."""
    for work in IN_PAUSES.work:
        work()


def work_in_pauses(work: Callable[[], None]) -> Callable[[], None]:
    """Run `work` in every pause of this thread; return a function that ends this."""
    IN_PAUSES.work.append(work)
    return lambda: IN_PAUSES.work.remove(work)

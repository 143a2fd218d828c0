"""Where long work lets what is more urgent go first.

Work that takes milliseconds calls `pause` between its steps, which by itself does nothing. What
else has to be done in this thread is done there, if somebody has said so by `work_in_pauses`. It
must not touch what the work reads or writes: so nothing that comes of the work depends on it.
"""

from __future__ import annotations

from collections.abc import Callable
import threading


class InPauses(threading.local):
    """What is done in the pauses of this thread."""

    def __init__(self) -> None:
        self.work: list[Callable[[], None]] = []


IN_PAUSES = InPauses()


def pause() -> None:
    """Let what is more urgent go first."""
    for work in IN_PAUSES.work:
        work()


def work_in_pauses(work: Callable[[], None]) -> Callable[[], None]:
    """Do `work` in every pause of this thread from now on; returns what ends that, there."""
    IN_PAUSES.work.append(work)
    return lambda: IN_PAUSES.work.remove(work)

"""Where long work lets what is more urgent go first.

Work that takes milliseconds calls `pause` between its steps, which by itself does nothing. What
else has to be done in this thread is done there, if somebody has said so by `work_in_pauses`. It
must not touch what the work reads or writes: so nothing that comes of the work depends on it.
"""

from __future__ import annotations

from collections.abc import Callable

_in_pauses: list[Callable[[], None]] = []


def pause() -> None:
    """Let what is more urgent go first."""
    for work in _in_pauses:
        work()


def work_in_pauses(work: Callable[[], None]) -> Callable[[], None]:
    """Do `work` in every pause from now on; returns what ends that."""
    _in_pauses.append(work)
    return lambda: _in_pauses.remove(work)

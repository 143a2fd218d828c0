"""Load shedding: a node that falls behind drops frames, then readings, and reports its delay.

Frames are dropped first. Readings wait for at most `input_timeout`, the time after which a silent
sensor is reported. Later readings stay in the queues of the middleware, which keep only the
newest; the others count as lost.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
import math
from typing import Any

from pneunet_ros.core.units import NANOSECONDS_PER_SECOND

# Number of pressures in the queue of a subscription: 0.2 s at 100 Hz. If a node has fallen this
# far behind and is then busy for the same time again, it loses readings.
MOST_WAITING = 20
# The same time for any rate: all frames of a backlog are dropped, and the fusion stops using the
# camera after a gap of `target_timeout`.
LONGEST_BACKLOG_NS = 200_000_000
FEW_WAITING = 1  # the pressure of a frame arrives just after the frame


class LoadShedding:
    """Drops frames, then stops receiving, while the backlog of pressures is too long.

    backlog: returns the number of waiting pressures, and the time span (ns) of their arrivals;
    span: returns the time span of all waiting messages; timeout: returns the longest wait (s).
    """

    def __init__(self) -> None:
        self.backlog: Callable[[], tuple[int, int]] = lambda: (0, 0)
        self.span: Callable[[], int] = lambda: 0
        self.timeout: Callable[[], float] = lambda: math.inf
        self.total = 0
        self._unreported = 0
        self._late = False

    def drop_frames_if_late(
        self, take: Callable[..., None], note: Callable[[Any], None]
    ) -> Callable[..., None]:
        """Return a frame callback that drops frames while the node is late.

        note: called with the message info of a dropped frame, which does not count as lost.
        """

        @wraps(take)
        def call(message: Any, info: Any) -> None:
            if self.is_late():
                self.total += 1
                self._unreported += 1
                note(info)
            else:
                take(message, info)

        return call

    def is_late(self) -> bool:
        """Whether readings have been waiting for too long, so that frames are dropped."""
        count, span_ns = self.backlog()
        is_long = count >= MOST_WAITING or span_ns >= LONGEST_BACKLOG_NS
        self._late = count > FEW_WAITING if self._late else is_long
        return self._late

    def is_full(self) -> bool:
        """Whether the backlog is so long that no further messages are received.

        Never true before frames are dropped, nor while a reading waits for another sensor's
        reading of the same stamp.
        """
        longest_ns = max(self.timeout() * NANOSECONDS_PER_SECOND, LONGEST_BACKLOG_NS)
        return self.span() >= longest_ns

    def sentence(self) -> str:
        """Report frames dropped since the last call, and waiting readings; empty if none."""
        new, self._unreported = self._unreported, 0
        count, span_ns = self.backlog()
        facts = []
        if new:
            facts.append(f'{new} frame{"s" if new > 1 else ""} of targets dropped')
        if self.is_late():
            seconds = span_ns / NANOSECONDS_PER_SECOND
            facts.append(f'{count} pressure readings are waiting, for up to {seconds:.1f} s')
        if not facts:
            return ''
        return f'{" and ".join(facts)}, because this machine is too slow for all readings'

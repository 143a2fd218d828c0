"""Checks of the header stamps of readings, and matching of readings with frames.

A reading matches a frame if it is the nearest one by stamp, within half a period.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between, seconds_since

BACKWARD_JUMP = 1.0  # s; a stamp older by more means a restart of time, by less a late message
RESTARTED = 'starts_anew'
AHEAD = 'ahead'  # reason: the stamp of a message was wrong, as the next message showed
LATEST_STAMP = 2**31 * NANOSECONDS_PER_SECOND  # the seconds of a header have 32 bits


def stamp_fault(what: str, last_ns: int | None, stamp_ns: int) -> tuple[str, str]:
    """Return why a reading cannot follow the last reading of its kind: a key and a sentence.

    Both are empty if it can. A jump back by more than a second (a looping bag, a restarted
    simulation) is a restart of time, with the key `RESTARTED`.
    """
    if stamp_ns <= 0:
        return 'no_stamp', f'{what} without a header stamp'
    if last_ns is None or stamp_ns > last_ns:
        return '', ''
    if stamp_ns == last_ns:
        return 'duplicate', f'{what} with the same stamp as the previous one'
    back = seconds_between(stamp_ns, last_ns)
    if back <= BACKWARD_JUMP:
        return 'older', f'{what} {back:.3g} s older than the previous one'
    return RESTARTED, f'time jumped back by {back:.3g} s: state reset'


@dataclass(frozen=True, slots=True, kw_only=True)
class StampGate:
    """The last stamps of one topic, to check the next one.

    last_ns: the last stamp; before_ns: the one before it, if more than a second earlier: the next
    stamp then decides whether time jumped or the last stamp was wrong.
    """

    last_ns: int | None = None
    before_ns: int | None = None

    def fault(self, what: str, stamp_ns: int) -> tuple[str, str]:
        """Return why a message cannot follow the last message, as in `stamp_fault`.

        The key `AHEAD` means that the message is valid, but the last message must be ignored.
        """
        reason, sentence = stamp_fault(what, self.last_ns, stamp_ns)
        if reason == RESTARTED and self.before_ns is not None and stamp_ns > self.before_ns:
            return AHEAD, f'the previous {what} had a stamp in the future'
        return reason, sentence

    def interval(self, stamp_ns: int) -> float:
        """Return the time (s) since the last message; 0 if unknown, as after a long gap."""
        seconds = 0.0 if self.last_ns is None else seconds_since(self.last_ns, stamp_ns)
        return seconds if 0.0 < seconds <= BACKWARD_JUMP else 0.0

    def after(self, stamp_ns: int) -> StampGate:
        """Return the counter after one more message."""
        last_ns = self.last_ns
        gap = last_ns is not None and seconds_since(last_ns, stamp_ns) > BACKWARD_JUMP
        return StampGate(last_ns=stamp_ns, before_ns=last_ns if gap else None)


def count_reason(counts: Mapping[str, int], reason: str) -> Mapping[str, int]:
    """Return counts by reason with one more of this reason."""
    return MappingProxyType({**counts, reason: counts.get(reason, 0) + 1})


Stamps = npt.NDArray[np.int64]


def match_stamps(
    wanted_ns: Stamps, stamp_ns: Stamps, reach_ns: float
) -> tuple[Stamps, npt.NDArray[np.bool_]]:
    """Match each stamp with the nearest of increasing stamps; also return whether it is near.

    Of two equally near stamps, the earlier one is matched; near: within reach_ns, half a period.
    """
    after = np.clip(np.searchsorted(stamp_ns, wanted_ns), 1, max(len(stamp_ns) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamp_ns) - 1)
    earlier = wanted_ns - stamp_ns[before] <= stamp_ns[after] - wanted_ns
    found = np.where(earlier, before, after)
    return found, np.abs(stamp_ns[found] - wanted_ns) <= reach_ns

"""Which reading may follow which, by the stamps of their headers; and counting of what may not."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from pneunet_ros.core.units import NANOSECONDS_PER_SECOND, seconds_between

BACKWARD_JUMP = 1.0  # s; a stamp older by more is a new start of time, by less a late message
STARTS_ANEW = 'starts_anew'
LATEST_STAMP = 2**31 * NANOSECONDS_PER_SECOND  # a header holds its seconds in 32 bits


def stamp_fault(what: str, last_ns: int | None, stamp_ns: int) -> tuple[str, str]:
    """Return why a reading cannot follow the last one of its kind, as a key and a sentence.

    Both are empty where it can. A stamp that jumps back by more than a second (a looping bag, a
    restarted simulation) is a new start of time, with the key `STARTS_ANEW`.
    """
    if stamp_ns <= 0:
        return 'no_stamp', f'{what} without a header stamp'
    if last_ns is None or stamp_ns > last_ns:
        return '', ''
    if stamp_ns == last_ns:
        return 'duplicate', f'{what} with the stamp of the last one'
    back = seconds_between(stamp_ns, last_ns)
    if back <= BACKWARD_JUMP:
        return 'older', f'{what} {back:.3g} s older than the last one'
    return STARTS_ANEW, f'time jumped back by {back:.3g} s: state reset'


def count_reason(counts: Mapping[str, int], reason: str) -> Mapping[str, int]:
    """Return counts by reason with one more of this reason."""
    return MappingProxyType({**counts, reason: counts.get(reason, 0) + 1})

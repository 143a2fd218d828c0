"""Steady states: intervals in which readings are constant to within their noise."""

from __future__ import annotations

import itertools

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.stamps import Stamps
from pneunet_ros.core.units import seconds_between

SHORTEST_HOLD = 1.5  # s


def steady_segments(values: Array, tolerance: Array | float) -> list[tuple[int, int]]:
    """Return start and stop of steady intervals of values (n, quantities), greedily.

    In each interval, the range of every quantity is at most `tolerance` (quantities,). An interval
    stops where the next one starts, and every value belongs to one.
    """
    starts = []
    low = high = np.full(values.shape[1:], np.nan)
    for index, value in enumerate(values):
        low, high = np.minimum(low, value), np.maximum(high, value)
        if not np.all(high - low <= tolerance):
            starts.append(index)
            low = high = value
    return list(itertools.pairwise([*starts, len(values)]))


def hold_intervals(
    stamp_ns: Stamps, values: Array, tolerance: Array | float, shortest: float = SHORTEST_HOLD
) -> list[tuple[int, int]]:
    """Return first and last index of the `steady_segments` of at least `shortest` s."""
    return [
        (start, stop - 1)
        for start, stop in steady_segments(values, tolerance)
        if seconds_between(int(stamp_ns[start]), int(stamp_ns[stop - 1])) >= shortest
    ]

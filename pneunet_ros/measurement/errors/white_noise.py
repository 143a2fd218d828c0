"""White noise of a sensor, estimated from recent readings of a changing quantity.

High-order differences remove a signal that is smooth from reading to reading, but keep all white
noise. If readings are too sparse for that, an intermediate order leaves the smallest remainder of
the signal.
"""

from __future__ import annotations

import math

import numpy as np
from pneunet_ros.core.arrays import Array, median
from pneunet_ros.measurement.dataset import SIGMA_OF_MEDIAN

ORDERS = 2, 4, 6
FEWEST = 12  # differences of an order that are used; invented
REPEATS = 0.2  # share of repeated readings above which there is no estimate; invented


def white_std(readings: Array) -> float:
    """Return an upper limit on one sigma of white noise of successive readings (n, k).

    Computed from a median of differences, which is robust against jumps; 0 if there are too few
    readings. Columns with many repeated values are excluded (an axis that is not measured, a
    frozen or coarsely quantized sensor).
    """
    same = np.count_nonzero(readings[1:] == readings[:-1], axis=0)
    readings = readings[:, same <= REPEATS * len(readings)]
    found, before = [], 0
    for order in ORDERS:
        for _ in range(order - before):
            readings = readings[1:] - readings[:-1]
        before = order
        if readings.size >= FEWEST:
            size = SIGMA_OF_MEDIAN * median(np.abs(readings))
            found.append(size / math.sqrt(math.comb(2 * order, order)))
    return min(found, default=0.0)

"""Rounding error of a sensor that reads in steps: a scale, a converter of few bits.

At rest such a sensor seems to have no noise at all, and is wrong by up to half a step. Readings
with noise of their own soon differ by next to nothing, those in steps never by less than one. So
the smallest change from reading to reading is the step.
"""

from __future__ import annotations

import math


def smallest_change(smallest: float, change: float) -> float:
    """Return the smallest change from reading to reading, after one more; 0 is none.

    smallest: of those before, infinite where there was none.
    """
    return min(smallest, abs(change) or math.inf)


def rounding_std(step: float) -> float:
    """Return one sigma of the quantization error of a step (uniform within half of it)."""
    return step / math.sqrt(12.0)


def with_rounding(std: float, rounding: float) -> float:
    """Return one sigma of a sensor including quantization.

    Noise that is larger than the quantization was measured with the sensor, and includes it.
    """
    return math.hypot(std, rounding) if std < rounding else std

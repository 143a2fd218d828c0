"""Quantization error of a sensor with coarse steps, such as a scale or a low-resolution ADC.

At rest, such a sensor seems to have no noise, although its error is up to half a step. Among noisy
readings of a fine sensor, two successive ones are soon almost equal, but quantized readings never
differ by less than one step. The smallest change between successive readings therefore estimates
the step.
"""

from __future__ import annotations

import math


def smallest_change(smallest: float, change: float) -> float:
    """Return the smallest nonzero change between successive readings, updated by one change.

    smallest: the previous value; infinite if there was no change.
    """
    return min(smallest, abs(change) or math.inf)


def rounding_std(step: float) -> float:
    """Return one sigma of the quantization error of a step (uniform within half of it)."""
    return step / math.sqrt(12.0)


def with_rounding(std: float, rounding: float) -> float:
    """Return one sigma of a sensor including quantization.

    Noise larger than the quantization was measured with this sensor, and already includes it.
    """
    return math.hypot(std, rounding) if std < rounding else std

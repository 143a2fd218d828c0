"""Upper limit of chi squared for frames and models whose residuals are consistent with noise."""

from __future__ import annotations

import math

RARE = 1e-4  # probability of a false alarm, by convention
RARELY = 3.719  # sigma: its one-sided normal quantile


def chi_square_limit(coordinates: float) -> float:
    """Return the chi squared per coordinate that white noise exceeds in one of 10 000 frames.

    Source: Wilson & Hilferty, Proc. National Academy of Sciences 17 (1931).
    """
    variance = 2.0 / (9.0 * coordinates)
    return (1.0 - variance + RARELY * math.sqrt(variance)) ** 3

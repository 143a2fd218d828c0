"""Chi-squared limit of the misfit due to noise alone, for frames and models."""

from __future__ import annotations

import math

RARELY = 3.719  # sigma: one-sided normal quantile of 1e-4, by convention


def chi_square_limit(coordinates: float) -> float:
    """Return the chi square per coordinate that white noise exceeds once in 10 000 frames.

    Source: Wilson & Hilferty, Proc. National Academy of Sciences 17 (1931).
    """
    variance = 2.0 / (9.0 * coordinates)
    return (1.0 - variance + RARELY * math.sqrt(variance)) ** 3

"""Upper limit of chi squared for frames and models whose residuals are consistent with noise."""

from __future__ import annotations

from dataclasses import dataclass
import math
from statistics import NormalDist

from pneunet_ros.core.settings import tuning

RARE = 1e-4  # probability of a false alarm, by convention
RARELY = 3.719  # sigma: its one-sided normal quantile


@dataclass(frozen=True, slots=True, kw_only=True)
class AdequacySettings:
    """The confidence level of intervals."""

    outside: float = tuning(
        0.05,
        'share of true values outside of their ellipses and intervals; recordings with at most '
        'this share of outlier frames are otherwise right',
        source='convention',
    )


ADEQUACY = AdequacySettings()
LARGEST_95 = -2.0 * math.log(ADEQUACY.outside)  # chi squared of two coordinates
SIGNIFICANT_FALL = NormalDist().inv_cdf(ADEQUACY.outside) ** 2  # of chi squared, one-sided


def chi_square_limit(coordinates: float) -> float:
    """Return the chi squared per coordinate that white noise exceeds in one of 10 000 frames.

    Source: Wilson & Hilferty, Proc. National Academy of Sciences 17 (1931).
    """
    variance = 2.0 / (9.0 * coordinates)
    return (1.0 - variance + RARELY * math.sqrt(variance)) ** 3

"""What the model lacks: errors of the law that are unknowns of the fusion.

Soft arms remember. What a model without creep or hysteresis lacks depends on where the pressure
has been: a part of the intrinsic curvature that follows the chamber late, and the pressure behind
a play. How large these parts are stays the same, so frames tell them even without a force sensor,
and the force is corrected by them.

Whatever else is missing is a slow error of the pressure and one of the intrinsic curvature, which
move with time and with the pressure. One number says how much, their scale: the share of what the
whole range of pressure does. It is not known either. With a scale L the innovation of a frame has
the covariance S + L^2 H D H^T, with S that of all else, and one fit gives the likelihood of all L.
So intervals become wide where something is missing, and stay narrow where nothing is.

Source: empirical Bayes of a variance component on a grid; noise of a Kalman filter from its
innovations: Mehra, IEEE Trans. Automatic Control 15 (1970).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.fusion.settings import FusionSettings
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.uncertainty import STIFFNESS
from scipy.linalg.lapack import dsyev

MOST_CERTAIN = 1.0 - 1e-9  # share of an innovation that one error can be


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LackGrowth:
    """How what the model lacks may have moved since the last frame.

    scale: of it, as assumed; grown (errors,): one sigma of its moves for a scale of 1; seconds: of
    time gone by.
    """

    scale: float
    grown: Array
    seconds: float


def first_weights(settings: FusionSettings) -> Array:
    """Return the log weights (scales,) before any frame: the larger, the less likely."""
    return falling(settings.lack_scales, settings.lack_fall)


@cache
def falling(scales: tuple[float, ...], power: float) -> Array:
    """Return minus a power of the scales, in logs."""
    return freeze(-power * np.log(np.array(scales)))


@cache
def squared(scales: tuple[float, ...]) -> Array:
    """Return the squares of the scales."""
    return freeze(np.square(scales))


def scale_of(settings: FusionSettings, log_weights: Array) -> float:
    """Return the scale: the root of the mean square of those that are likely."""
    weights = np.exp(log_weights - log_weights.max())
    return math.sqrt(float(weights @ squared(settings.lack_scales) / weights.sum()))


def weights_after(
    settings: FusionSettings,
    log_weights: Array,
    growth: LackGrowth,
    information: tuple[Array, Array],
) -> Array:
    """Return the log weights after a frame.

    information: H^T S^-1 v (errors,) and H^T S^-1 H (errors, errors) of the moves for a scale of
    1, with those assumed in S.
    """
    score, precision = information
    assumed = growth.scale
    share, axes, _ = dsyev(assumed**2 * precision, lower=1)
    scores, precise = [], []
    for one, projection in zip(share.tolist(), (score @ axes).tolist(), strict=True):
        without = 1.0 / (1.0 - min(max(one, 0.0), MOST_CERTAIN))  # of S without these errors
        scores.append((without * projection) ** 2)
        precise.append(without * one / assumed**2)
    likelihood = np.array(
        [
            0.5
            * sum(
                scale**2 * squared / (1.0 + scale**2 * known) - math.log1p(scale**2 * known)
                for squared, known in zip(scores, precise, strict=True)
            )
            for scale in settings.lack_scales
        ]
    )
    kept = math.exp(-growth.seconds / settings.lack_time)
    after = kept * log_weights + (1.0 - kept) * first_weights(settings) + likelihood
    return freeze(after - after.max())


def remember(
    settings: FusionSettings,
    memory: tuple[float, ...],
    chamber: float,
    seconds: float,
    width: float,
) -> tuple[float, ...]:
    """Return the pressures (Pa) that lag behind the chamber, and the one behind a play.

    memory: those at the last reading, `seconds` ago, empty before the first; chamber (Pa): now;
    width (Pa): of the play. Exact where the chamber jumps with each reading and rests between two.
    """
    if not memory:
        return (chamber,) * (len(settings.lag_times) + 1)
    *lagging, played = memory
    late = [
        chamber + (one - chamber) * math.exp(-seconds / time)
        for one, time in zip(lagging, settings.lag_times, strict=True)
    ]
    half = 0.5 * width
    return (*late, min(max(played, chamber - half), chamber + half))


def span_of(arm: Arm) -> tuple[float, float]:
    """Return the range of pressure (Pa), also of an arm that was calibrated at one pressure."""
    low, high = arm.pressure_range
    return (low, high) if low < high else arm.table_range


def lack_columns(settings: FusionSettings, arm: Arm) -> tuple[dict[str, float], ...]:
    """Return what one unit of each further error of the law moves, by dotted path.

    First an intrinsic curvature off by what the whole range of pressure does to it, while the
    moment law stays that of the pressure; then a stiffness off by a share of it.
    """
    table, law = arm.intrinsic_curvature, arm.moment_law
    low, high = (table.at(pressure, table.arclength) for pressure in span_of(arm))
    field = table.curvature[0] if len(table.pressure) == 1 else high - low
    curvature = {
        f'intrinsic_curvature.curvature.{row}.{place}': float(value)
        for row in range(len(table.pressure))
        for place, value in enumerate(field)
    }
    stiffness: dict[str, float] = {}
    for name in (item for item in STIFFNESS if hasattr(law, item)):
        for place, value in np.ndenumerate(np.asarray(getattr(law, name))):
            path = '.'.join(('moment_law', name, *map(str, place)))
            stiffness[path] = settings.lack_stiffness * float(value)
    return curvature, stiffness

"""Comparison of calibrated arms at one pressure, and outlier detection.

Arms of one design differ. Center and scatter are estimated robustly, so that outliers do not mask
themselves. The distance of an arm from the center is relative to scatter and error bars together.
Simulated fleets of similar arms with the same error bars give the distribution of the largest
distance.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.core.units import quantities
from pneunet_ros.model.arm import Arm, EXTRAPOLATION
import scipy

MEDIAN_SQUARE = 0.454936423119572  # median of the square of a standard normal variable
STATIONS = 101  # places along the arm for means over it
ROUNDS = 20  # fixed-point iterations of the most probable center and scatter
TURNS = 6  # fixed-point iterations of center and scatter by medians
HALVINGS = 40
# False alarm per simulated fleet of equal arms (per real one: acceptance/outlier_arms.py), and the
# one below which an arm is excluded from the center; convention.
LEVEL = 0.01
# Invented: no figure of acceptance/sweep.py contains a fleet.
DRAWS = 400  # simulated fleets for the threshold
FEWEST_COMPARED = 12  # arms with a known value, for a comparison
FEWEST_SHOWN = 2  # arms with a known value, for a figure
REACHED = 0.75  # share of the arms that reach the pressure of the comparison
SHRUNK = 0.1  # of correlations by medians, which are poor with few arms
LEAST_SCATTER = 0.3  # error bars, of the initial scatter
EVEN = 1e-4  # of the curvature: a spread along an arm that counts as zero


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmNumber:
    """A quantity that is compared between arms: dotted name, meaning with its pressure, unit."""

    name: str
    meaning: str
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmNumbers:
    """The compared numbers of one arm: values by name, and their covariance in that order."""

    values: Mapping[ArmNumber, float]
    covariance: Array

    def __post_init__(self) -> None:
        """Check the size of the covariance."""
        object.__setattr__(
            self, 'covariance', frozen_array(self.covariance, (len(self.values),) * 2)
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fleet:
    """Comparison of several arms.

    pressure (Pa) of the comparison; numbers (n,): quantities known for several arms; values and
    stds (arms, n), NaN if unknown for an arm; center and scatter (n,): mean of similar arms, and
    their standard deviation beyond the error bars. p_values (arms,): probability that the furthest
    of as many similar arms deviates at least as much, NaN if an arm is not compared; log_chance
    (arms,): log of this probability for a single arm, for sorting.
    """

    names: tuple[str, ...]
    pressure: float
    numbers: tuple[ArmNumber, ...]
    values: Array
    stds: Array
    center: Array
    scatter: Array
    p_values: Array
    log_chance: Array

    @property
    def odd(self) -> tuple[int, ...]:
        """Indices of the outliers, the largest first."""
        order = np.argsort(self.log_chance, kind='stable').tolist()
        return tuple(index for index in order if self.p_values[index] <= LEVEL)

    @property
    def deviations(self) -> Array:
        """Deviation of each number in standard deviations (scatter and error bar combined)."""
        return np.asarray((self.values - self.center) / np.hypot(self.scatter, self.stds))

    @property
    def sentence(self) -> str:
        """Describe the outliers, or say why there are none."""
        compared = int(np.count_nonzero(np.isfinite(self.p_values)))
        if not compared:
            return (
                f'Outliers cannot be detected: at least {FEWEST_COMPARED} arms with a number '
                'in common are needed.'
            )
        if not self.odd:
            most_different = int(np.nanargmin(self.p_values))
            return (
                f'No arm is an outlier: among {compared} similar arms, the most different one '
                f'would deviate as much as {self.names[most_different]} with probability '
                f'{self.p_values[most_different]:.2g}.'
            )
        verb = 'is an outlier' if len(self.odd) == 1 else 'are outliers'
        count = f'{len(self.odd)} of {compared} arms {verb}'
        return f'{count}: {"; ".join(map(self.describe, self.odd))}.'

    def describe(self, arm: int) -> str:
        """Name the compared quantity in which an arm differs most from the others."""
        compared = np.isfinite(self.values).sum(axis=0) >= FEWEST_COMPARED
        which = int(np.nanargmax(np.where(compared, np.abs(self.deviations[arm]), np.nan)))
        number = self.numbers[which]
        unit = '' if number.unit == '-' else f' {number.unit}'
        sentence = (
            f'{self.names[arm]}: {number.meaning} is {self.values[arm, which]:.4g} ± '
            f'{self.stds[arm, which]:.2g}{unit}, the others have {self.center[which]:.4g} ± '
            f'{self.scatter[which]:.2g}{unit}'
        )
        if abs(self.deviations[arm, which]) < scipy.stats.norm.isf(0.5 * LEVEL):
            sentence += ' (no single number is unusual, but all of them together are)'
        return sentence


def compared_pressure(arms: Sequence[Arm]) -> float:
    """Return the largest pressure or vacuum (Pa) that most arms reach, used to compare them."""
    tops = sorted((max(arm.pressure_range, key=abs) for arm in arms), key=abs, reverse=True)
    return tops[max(int(np.ceil(REACHED * len(tops))) - 1, 0)]


def arm_numbers(arm: Arm, pressure: float, *, loaded: bool) -> ArmNumbers:
    """Return the compared quantities of a calibrated arm, with the covariance of its model file.

    Args:
        arm: the arm, with the covariance of its model.
        pressure: gauge, Pa; quantities at pressures outside the calibrated range are omitted.
        loaded: whether the arm was calibrated under loads, so that its stiffness was measured.

    Returns:
        Turning angle of the unloaded arm at zero, half and full pressure, that of its outer half
        if the curvature may vary along the arm, the bending stiffness of the whole arm at half
        pressure, and the parameters of its effects.
    """
    values = evaluate(arm, pressure, loaded)
    columns = [] if arm.covariance is None else arm.covariance.columns()
    moves = np.zeros((len(values), len(columns)))
    for index, column in enumerate(columns):
        sides = [
            evaluate(
                arm.with_changes({name: side * size for name, size in column.items()}),
                pressure,
                loaded,
            )
            for side in (-0.5, 0.5)
        ]
        moves[:, index] = [sides[1][number] - sides[0][number] for number in values]
    return ArmNumbers(values=values, covariance=moves @ moves.T)


def reaches(arm: Arm, pressure: float) -> bool:
    """Whether a model is valid at a pressure (Pa); ends of recordings differ by noise."""
    return arm.beyond_range(pressure) <= EXTRAPOLATION


def evaluate(arm: Arm, pressure: float, loaded: bool) -> dict[ArmNumber, float]:
    """Return the numbers of an arm by name."""
    curvature = arm.intrinsic_curvature
    at = f'at {1e-3 * pressure:.4g} kPa'
    half = f'at {0.5e-3 * pressure:.4g} kPa'
    share = np.linspace(0.0, 1.0, STATIONS)
    outer = np.linspace(0.5, 1.0, STATIONS)
    found: dict[ArmNumber, float] = {}

    def add(name: str, meaning: str, unit: str, value: float) -> None:
        found[ArmNumber(name=name, meaning=meaning, unit=unit)] = value

    def turning(where: float, places: Array) -> float:
        along = curvature.at(where, places)
        return float(arm.length * np.ptp(places) * np.trapezoid(along, dx=1 / (along.size - 1)))

    if reaches(arm, 0.0):
        add('turning_at_rest', 'turning angle without pressure', 'rad', turning(0.0, share))
    if reaches(arm, 0.5 * pressure):
        add('turning_at_half', f'turning angle {half}', 'rad', turning(0.5 * pressure, share))
    if reaches(arm, pressure):
        add('turning', f'turning angle {at}', 'rad', turning(pressure, share))
        table = curvature.curvature
        if np.ptp(table, axis=1).max() > EVEN * np.abs(table).max():
            meaning = f'turning angle of the outer half {at}'
            add('turning_of_outer_half', meaning, 'rad', turning(pressure, outer))
    if loaded and reaches(arm, 0.5 * pressure):
        value = arm.mean_stiffness(0.5 * pressure)
        add('bending_stiffness', f'bending stiffness EI of the whole arm {half}', 'N m^2', value)
    for effect in arm.effects:
        for item in quantities(effect):
            name = f'{effect.name}.{item.name}'
            add(name, name, item.metadata['unit'], float(getattr(effect, item.name)))
    return found


def compare_arms(arms: Mapping[str, ArmNumbers], pressure: float, *, seed: int = 0) -> Fleet:
    """Estimate center and scatter of a fleet, and its outliers.

    Args:
        arms: the numbers of each arm, by name.
        pressure: at which the numbers are compared, Pa.
        seed: that of the simulated fleets.

    Returns:
        The compared arms. A number is compared if enough arms have it; center and scatter of the
        others are medians.
    """
    counts = Counter(number for item in arms.values() for number in item.values)
    numbers = tuple(number for number, count in counts.items() if count >= FEWEST_SHOWN)
    values, covariance = table(list(arms.values()), numbers)
    stds = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    stds = np.where(np.isfinite(values), stds, np.nan)
    center, scatter = np.zeros(len(numbers)), np.zeros(len(numbers))
    p_values, chance = np.full((2, len(arms)), np.nan)
    if numbers:
        ((center,), (scatter,)) = center_and_scatter(values[None], stds**2)
    compared = [which for which, item in enumerate(numbers) if counts[item] >= FEWEST_COMPARED]
    if compared:
        some, errors = values[:, compared], covariance[:, compared][:, :, compared]
        ((middle,), (spread,), (chance,)) = fleet_distances(some[None], errors)
        smallest = np.sort(simulate_smallest(some, errors, middle, spread, seed))
        below = np.searchsorted(smallest, chance, side='right')
        p_values = np.where(np.isnan(chance), np.nan, (1.0 + below) / (1.0 + smallest.size))
        center[compared], scatter[compared] = middle, np.sqrt(np.diagonal(spread))
    return Fleet(
        names=tuple(arms),
        pressure=pressure,
        numbers=numbers,
        values=values,
        stds=stds,
        center=center,
        scatter=scatter,
        p_values=p_values,
        log_chance=chance,
    )


def table(arms: Sequence[ArmNumbers], numbers: Sequence[ArmNumber]) -> tuple[Array, Array]:
    """Return values (arms, n) and covariances (arms, n, n), NaN and zero where unknown."""
    values = np.full((len(arms), len(numbers)), np.nan)
    covariance = np.zeros((len(arms), len(numbers), len(numbers)))
    for row, arm in enumerate(arms):
        indices = {number: index for index, number in enumerate(arm.values)}
        columns = [index for index, number in enumerate(numbers) if number in indices]
        own_columns = [indices[numbers[index]] for index in columns]
        values[row, columns] = [arm.values[numbers[index]] for index in columns]
        covariance[row][np.ix_(columns, columns)] = arm.covariance[
            np.ix_(own_columns, own_columns)
        ]
    # Keeps the distance finite for numbers that agree to the last digit and have no error.
    floor = (1e-9 * np.nanmax(np.abs(values), axis=0, initial=0.0)) ** 2 + 1e-300
    return values, covariance + np.diag(floor)


def fleet_distances(values: Array, covariance: Array) -> tuple[Array, Array, Array]:
    """Return center, scatter and the probability of each arm's deviation, for many fleets at once.

    A robust initial estimate selects the arms to use; center and scatter are the most probable
    ones for these arms.

    Args:
        values: (fleets, arms, n), NaN if unknown for an arm.
        covariance: that of the error bars (arms, n, n), the same in every fleet.

    Returns:
        center (fleets, n); scatter (fleets, n, n), the covariance of similar arms beyond their
        error bars; log probability (fleets, arms) of a deviation at least as large, NaN if an arm
        has no numbers.
    """
    center, scatter = robust_start(values, covariance)
    chance = log_chance(values, covariance, center, scatter)
    half = np.nanmedian(chance, axis=1, keepdims=True)
    counted = chance >= np.minimum(np.log(LEVEL), half)  # false for NaN
    for _ in range(ROUNDS):
        center, scatter = next_estimate(values, covariance, center, scatter, counted)
    return center, scatter, log_chance(values, covariance, center, scatter)


def log_chance(values: Array, covariance: Array, center: Array, scatter: Array) -> Array:
    """Return the log probability (fleets, arms) of a deviation at least this large."""
    deviation, precision = deviations_and_precision(values, covariance, center, scatter)
    squares = np.einsum('dai,daij,daj->da', deviation, precision, deviation)
    freedom = np.isfinite(values).sum(axis=2)
    chance = scipy.stats.chi2.logsf(squares, np.maximum(freedom, 1))
    return np.where(freedom > 0, chance, np.nan)


def deviations_and_precision(
    values: Array, covariance: Array, center: Array, scatter: Array
) -> tuple[Array, Array]:
    """Return the deviations of arms (fleets, arms, n) and their inverse covariance.

    Both are zero where a number of an arm is unknown.
    """
    known = np.isfinite(values)
    both_known = known[..., :, None] & known[..., None, :]
    total = np.where(both_known, scatter[:, None] + covariance, np.eye(values.shape[2]))
    scale = np.sqrt(np.diagonal(total, axis1=2, axis2=3))
    scale = scale[..., :, None] * scale[..., None, :]
    correlation = total / scale + 1e-9 * np.eye(values.shape[2])  # always invertible
    precision = np.where(both_known, np.linalg.inv(correlation) / scale, 0.0)
    return np.where(known, values - center[:, None], 0.0), precision


def next_estimate(
    values: Array, covariance: Array, center: Array, scatter: Array, counted: npt.NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return center and scatter after one EM iteration.

    counted (fleets, arms): mask of the arms to use.
    """
    deviation, precision = deviations_and_precision(values, covariance, center, scatter)
    precision = precision * counted[..., None, None]
    step = np.einsum('daij,daj->di', precision, deviation)
    total = precision.sum(axis=1)
    unknown = np.diagonal(total, axis1=1, axis2=2) == 0.0  # for all arms in use
    center = (
        center
        + np.linalg.solve(total + unknown[..., None] * np.eye(step.shape[1]), step[..., None])[
            ..., 0
        ]
    )
    deviation = np.where(np.isfinite(values), values - center[:, None], 0.0)
    pull = np.einsum('daij,daj->dai', precision, deviation)
    arms = counted.sum(axis=1)[:, None, None]
    spread = (np.einsum('dai,daj->dij', pull, pull) - total) / arms
    scatter = scatter + scatter @ spread @ scatter
    return center, 0.5 * (scatter + scatter.swapaxes(1, 2))


def robust_start(values: Array, covariance: Array) -> tuple[Array, Array]:
    """Estimate center (fleets, n) and scatter (fleets, n, n) by medians.

    Correlations are those of Gnanadesikan and Kettenring (1972).
    """
    variances = np.diagonal(covariance, axis1=1, axis2=2)
    center, width = center_and_scatter(values, variances)
    deviation = values - center[:, None]
    correlation = robust_correlation(deviation / np.sqrt(width[:, None] ** 2 + variances))
    correlation = (1.0 - SHRUNK) * correlation
    correlation = correlation + SHRUNK * np.eye(values.shape[2])
    # A scatter of zero would stay zero: medians of few arms are not that sure of it.
    width = np.sqrt(width**2 + LEAST_SCATTER**2 * np.nanmedian(variances, axis=0))
    return center, width[:, :, None] * correlation * width[:, None, :]


def center_and_scatter(values: Array, variances: Array) -> tuple[Array, Array]:
    """Return median and scatter beyond the error bars of each number, (fleets, n) each.

    With this scatter, the median of the squared deviations, normalized by scatter and error bar,
    equals that of a standard normal variable. The scatter is zero where the error bars alone
    suffice.
    """
    center = np.nanmedian(values, axis=1)
    square = np.zeros_like(center)
    for _ in range(TURNS):
        weights = np.where(np.isfinite(values), 1.0 / (square[:, None] + variances), 0.0)
        center = weighted_median(values, np.sqrt(weights))
        deviation = (values - center[:, None]) ** 2
        low = np.zeros_like(center)
        high = np.nanmax(deviation, axis=1) / MEDIAN_SQUARE
        for _ in range(HALVINGS):
            square = 0.5 * (low + high)
            median = np.nanmedian(deviation / (square[:, None] + variances), axis=1)
            low = np.where(median > MEDIAN_SQUARE, square, low)
            high = np.where(median > MEDIAN_SQUARE, high, square)
        is_explained = np.nanmedian(deviation / variances, axis=1) <= MEDIAN_SQUARE
        square = np.where(is_explained, 0.0, square)
    return center, np.sqrt(square)


def weighted_median(values: Array, weights: Array) -> Array:
    """Return the weighted median over arms, (fleets, n); NaN has no weight."""
    order = np.argsort(values, axis=1)
    sums = np.cumsum(np.take_along_axis(weights, order, axis=1), axis=1)
    index = np.argmax(sums >= 0.5 * sums[:, -1:], axis=1)
    ranked = np.take_along_axis(values, order, axis=1)
    return np.take_along_axis(ranked, index[:, None], axis=1)[:, 0]


def robust_correlation(standardized: Array) -> Array:
    """Return correlations (fleets, n, n) by the spread of sums and differences of numbers."""
    count = standardized.shape[2]
    correlation = np.tile(np.eye(count), (standardized.shape[0], 1, 1))
    for first in range(count):
        for second in range(first):
            a, b = standardized[..., first], standardized[..., second]
            both_known = np.isfinite(a) & np.isfinite(b)
            if np.count_nonzero(both_known[0]) < 3:
                continue
            spread_of_sum, spread_of_difference = (
                np.nanmedian(np.abs(np.where(both_known, side, np.nan)), axis=1) ** 2
                for side in (a + b, a - b)
            )
            value = (spread_of_sum - spread_of_difference) / np.maximum(
                spread_of_sum + spread_of_difference, 1e-300
            )
            correlation[:, first, second] = correlation[:, second, first] = value
    sizes, vectors = np.linalg.eigh(correlation)
    correlation = np.einsum('dij,dj,dkj->dik', vectors, np.maximum(sizes, 0.0), vectors)
    scale = np.sqrt(np.maximum(np.diagonal(correlation, axis1=1, axis2=2), 1e-12))
    return np.asarray(correlation / (scale[:, :, None] * scale[:, None, :]))


def simulate_smallest(
    values: Array, covariance: Array, center: Array, scatter: Array, seed: int
) -> Array:
    """Return the smallest log probability in each of many simulated fleets of equal arms.

    The simulated fleets have the same number of arms, error bars and missing numbers, and the same
    estimator of center and scatter, because with few arms the largest deviation does not follow a
    chi squared distribution.
    """
    random = np.random.default_rng([seed, values.shape[0]])
    roots = [np.linalg.cholesky(with_jitter(one + scatter)) for one in covariance]
    normal = random.standard_normal((DRAWS, *values.shape))
    drawn = center + np.einsum('aij,daj->dai', np.array(roots), normal)
    drawn = np.where(np.isfinite(values), drawn, np.nan)
    return np.asarray(np.nanmin(fleet_distances(drawn, covariance)[2], axis=1))


def with_jitter(covariance: Array) -> Array:
    """Make a covariance positive definite by a change of rounding size."""
    return np.asarray(covariance + 1e-9 * np.diag(np.diag(covariance)))

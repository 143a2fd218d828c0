"""Smooth centerline through the targets, and its curvature (Eq 1), with uncertainty.

The curve is a Gaussian process with a prior learned once. The smoothing operator depends on which
targets were seen and on their relative accuracy, not on their positions; it is computed once per
set of seen targets and cached.

The tangent of the curve is exp(stretch + i angle), with the logarithm of the stretch and the angle
as functions of arclength. The logarithm of the chord between two neighboring targets, divided by
their distance along the arm, is the mean of stretch + i angle between them; only the chord of an
arc is shorter than the arc. Summed up along the arm, the chords give a line with the noise of the
targets: the straightened arm. The second derivative of this line is the curvature, and one linear
operator smooths it for any shape.

The accuracy of targets is not `sensors.target_std`, which is one number for all cameras, but the
standard deviation of each sighting. If the residuals of a frame are larger (badly placed dots),
the noise level is estimated from the residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, field, replace
import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array, freeze, frozen_array
from pneunet_ros.core.errors import CameraError, RequestError
from pneunet_ros.core.kernels.jit import inner, kernel
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.core.settings import numbers_type, tuning
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import DEFAULT_STATIONS, station_arclength
from pneunet_ros.vision.curvature_prior import (
    CurvaturePrior,
    gauss_integrals,
    learn_priors,
    PRIOR,
    PriorSettings,
    twice_integrated,
    without_line,
)

LARGEST_NOISE = 0.1  # of the mean distance of targets, to try
LEVEL_RATIO = 1.5  # factor between tried levels of noise
FAR_WORSE = 20.0  # in -2 log likelihood: the search ends at this level of noise
STD_RATIO = 2.0  # between classes of targets that count as equally accurate: few sets are needed
LEAST_ACCURATE = 20  # classes: a millionth of the weight
LEAST_WEIGHT = 1e-3  # a less probable prior is ignored

Indices = npt.NDArray[np.int64]

FEWEST_TARGETS = 4
KEPT_OPERATORS = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class SmootherSettings:
    """Settings for separating noise and stretch from curvature."""

    least_std: float = tuning(1e-5, 'smallest plausible noise', unit='length', source='sweep')
    stretch_share: float = tuning(
        0.01, 'std of the stretch relative to that of the angle', source='sweep'
    )


SmootherNumbers = numbers_type(SmootherSettings, 'SmootherNumbers')
SMOOTHER = SmootherSettings()


@functools.lru_cache
def smoother_numbers(settings: SmootherSettings) -> Any:
    """Return settings as kernels take them."""
    return SmootherNumbers(*astuple(settings))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredCurve:
    """The measured centerline at stations between the first and the last target used.

    All arrays have one entry per station: material arclength (m), x and y (m, base frame), theta
    (rad, continuous, from (-pi, pi] at the first station), curvature by Eq 1 (1/m, per stretched
    length) and its standard deviation (1/m). `rms` (m) is the root mean square distance of the
    seen targets from the curve, per coordinate.
    """

    stamp_ns: int
    arclength: Array
    x: Array
    y: Array
    theta: Array
    curvature: Array
    std_curvature: Array
    rms: float


class SmoothingOperator(NamedTuple):
    """Precomputed smoothing for one set of seen targets; see `smooth_targets`.

    seen (n,) indices of targets; shares (n,): their relative accuracy; distances (n - 1,) m along
    the arm between them; slope (n,) of the straight line through the straightened arm. For each
    prior: modes (priors, n, n - 2) of that line, independent with mode_variances (priors, n - 2)
    m^2 and with the noise of an accurate target; theta_rows, curvature_rows (priors, n - 2,
    points) and prior_variance (priors, points) 1/m^2 at points (m): stations and targets, of which
    target_points and station_points are the indices. arclength (stations,) m.
    """

    seen: Indices
    shares: Array
    distances: Array
    slope: Array
    modes: Array
    mode_variances: Array
    theta_rows: Array
    curvature_rows: Array
    prior_variance: Array
    points: Array
    target_points: Indices
    station_points: Indices
    arclength: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Smoother:
    """Smooths the targets at target_arclength (targets,) m into a curve at stations (m).

    Targets beyond `length` (m) are on the rigid cap and are not used, because the curvature jumps
    to zero there, which the prior does not model. `placement_std` (m) is the accuracy of the
    painted targets; the sightings have the accuracy of detection. Any further error is estimated
    from the residuals of a frame.
    """

    target_arclength: Array
    stations: Array
    priors: tuple[CurvaturePrior, ...]
    length: float
    placement_std: float = 0.0
    settings: SmootherSettings = SMOOTHER
    operator: Callable[[bytes], SmoothingOperator | None] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the targets and compute the parts common to all sets of seen targets."""
        targets = frozen_array(self.target_arclength)
        if targets.ndim != 1 or targets.size < FEWEST_TARGETS:
            raise CameraError(
                f'a centerline needs at least {FEWEST_TARGETS} targets; arm.target_arclength of '
                f'the model file has {targets.size}',
                reason='too_few_targets',
            )
        object.__setattr__(self, 'target_arclength', targets)
        object.__setattr__(self, 'stations', frozen_array(self.stations))
        points = np.unique(np.concatenate([targets, self.stations]))
        covariances = tuple(Covariances.between(prior, targets, points) for prior in self.priors)
        make = functools.partial(operator_for, covariances, targets, self.stations)
        object.__setattr__(self, 'operator', functools.lru_cache(KEPT_OPERATORS)(make))

    def smooth(self, sightings: TargetSightings) -> MeasuredCurve | None:
        """Return the curve through the seen targets of the soft part; None if there are too few.

        Also None if two neighboring targets coincide. Raises RequestError for sightings with
        another number of targets.
        """
        if sightings.x.size != self.target_arclength.size:
            raise RequestError(
                f'the arm has {self.target_arclength.size} targets, but the sightings have '
                f'{sightings.x.size}',
                reason='wrong_targets',
            )
        if self.target_arclength[-1] > self.length:
            x = np.where(self.target_arclength > self.length, math.nan, sightings.x)
            sightings = replace(sightings, x=freeze(x))
        least = math.hypot(self.settings.least_std * self.length, self.placement_std)
        operator = self.operator(accuracy_classes(sightings, least).tobytes())
        if operator is None:
            return None
        out = np.empty((5, operator.arclength.size))
        numbers = smoother_numbers(self.settings)
        rms = smooth_targets(
            sightings.x, sightings.y, sightings.std, operator, least, numbers, out
        )
        if not math.isfinite(rms):
            return None
        freeze(out)
        return MeasuredCurve(
            stamp_ns=sightings.stamp_ns,
            arclength=operator.arclength,
            x=out[0],
            y=out[1],
            theta=out[2],
            curvature=out[3],
            std_curvature=out[4],
            rms=rms,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Covariances:
    """Prior covariances of the straightened arm: line at targets, line with slope, curvature.

    points (points,) m; line (targets, targets) m^2; theta (points, targets) m; curvature
    (points, targets) dimensionless; variance (points,) 1/m^2 of curvature itself.
    """

    points: Array
    line: Array
    theta: Array
    curvature: Array
    variance: Array

    @staticmethod
    def between(prior: CurvaturePrior, targets: Array, points: Array) -> Covariances:
        """Integrate the covariance of curvature."""
        nodes, weights = prior.nodes(points)
        at_targets = twice_integrated(targets, nodes, weights)
        with_targets = prior.covariance(nodes, nodes) @ at_targets.T
        return Covariances(
            points=points,
            line=at_targets @ with_targets,
            theta=gauss_integrals(points, nodes, weights) @ with_targets,
            curvature=prior.covariance(points, nodes) @ at_targets.T,
            variance=np.diagonal(prior.covariance(points, points)).copy(),
        )


def accuracy_classes(sightings: TargetSightings, least_std: float) -> npt.NDArray[np.int8]:
    """Return the accuracy class (targets,) of each target: 0 unseen, 1 as accurate as most.

    Each further class is `STD_RATIO` times less accurate; least_std: smallest plausible noise (m).
    """
    seen = np.isfinite(sightings.x + sightings.y)
    classes = seen.astype(np.int8)
    std = np.hypot(np.fmax(sightings.std[seen], 0.0), least_std)  # no std: that of the least noise
    if std.size and std.max() > STD_RATIO * std.min():
        ratio = np.log(std / np.median(std)) / math.log(STD_RATIO)
        classes[seen] += np.clip(np.rint(ratio), 0.0, LEAST_ACCURATE).astype(np.int8)
    return classes


def operator_for(
    covariances: tuple[Covariances, ...], targets: Array, stations: Array, classes: bytes
) -> SmoothingOperator | None:
    """Return the operator for targets seen; None for too few. classes: `accuracy_classes`."""
    of_targets = np.frombuffer(classes, dtype=np.int8)
    seen = np.flatnonzero(of_targets)
    if seen.size < FEWEST_TARGETS:
        return None
    places, variance = targets[seen], STD_RATIO ** (2.0 * of_targets[seen] - 2.0)
    arclength = stations[(stations >= places[0]) & (stations <= places[-1])]
    if not arclength.size:
        return None
    points = np.unique(np.concatenate([places, arclength]))
    rows = np.searchsorted(covariances[0].points, points)
    line = np.stack([of.line[np.ix_(seen, seen)] for of in covariances])
    line_free = without_line(places)
    noise = np.linalg.cholesky(line_free.T @ (variance[:, None] * line_free))
    line_free = line_free @ np.linalg.inv(noise).T
    variances, turned = np.linalg.eigh(line_free.T @ line @ line_free)
    modes = line_free @ turned
    shares = 1.0 / variance / np.sum(1.0 / variance)
    away = places - shares @ places
    slope = shares * away / (shares @ away**2)
    theta = np.stack([of.theta[np.ix_(rows, seen)] for of in covariances])
    curvature = np.stack([of.curvature[np.ix_(rows, seen)] for of in covariances])
    operator = SmoothingOperator(
        seen=seen.astype(np.int64),
        shares=shares,
        distances=np.diff(places),
        slope=slope,
        modes=modes,
        mode_variances=np.maximum(variances, 0.0),
        theta_rows=transpose_rows((theta - (slope @ line)[:, None]) @ modes),
        curvature_rows=transpose_rows(curvature @ modes),
        prior_variance=np.stack([of.variance[rows] for of in covariances]),
        points=points,
        target_points=np.searchsorted(points, places).astype(np.int64),
        station_points=np.searchsorted(points, arclength).astype(np.int64),
        arclength=arclength.copy(),
    )
    for array in operator:
        array.flags.writeable = False  # they are kept, and used for many frames
    return operator


def transpose_rows(rows: Array) -> Array:
    """Return transposed matrices, contiguous in memory, because loops run along points."""
    return np.ascontiguousarray(rows.transpose(0, 2, 1))


def smoother_for(
    arm: Arm,
    stations: int = DEFAULT_STATIONS,
    settings: SmootherSettings = SMOOTHER,
    prior: PriorSettings = PRIOR,
) -> Smoother:
    """Return the smoother of this arm, at equally spaced stations; learns its prior.

    Raises CameraError if the model file has too few targets.
    """
    if arm.target_arclength.size < FEWEST_TARGETS:
        raise CameraError(
            f'a centerline needs at least {FEWEST_TARGETS} targets; arm.target_arclength of '
            f'the model file has {arm.target_arclength.size}',
            reason='too_few_targets',
        )
    return Smoother(
        target_arclength=arm.target_arclength,
        stations=station_arclength(arm.reach, stations),
        priors=learn_priors(arm, prior),
        length=arm.length,
        placement_std=arm.sensors.placement_std,
        settings=settings,
    )


@kernel
def smooth_targets(
    x: Array,
    y: Array,
    std: Array,
    operator: SmoothingOperator,
    least_std: float,
    settings: SmootherSettings,
    out: Array,
) -> float:
    """Fill out (5, stations) with x, y, theta, curvature, std of curvature; return the rms.

    x, y, std (all targets,) m; least_std: smallest plausible noise (m).
    """
    (
        seen, shares, distances, slope, modes, mode_variances, theta_rows, curvature_rows,
        prior_variance, points, target_points, station_points, _,
    ) = operator  # fmt: skip
    priors, mode_count = mode_variances.shape
    angle, stretch = np.empty(distances.size), np.empty(distances.size)
    chords(x, y, seen, distances, angle, stretch)
    bent, longer = np.zeros((priors, mode_count)), np.zeros((priors, mode_count))
    line = line_longer = mean_theta = mean_stretch = length_seen = 0.0
    for target in range(1, seen.size):
        length_seen += distances[target - 1]
        line += distances[target - 1] * angle[target - 1]
        line_longer += distances[target - 1] * stretch[target - 1]
        mean_theta += slope[target] * line
        mean_stretch += slope[target] * line_longer
        for prior in range(priors):
            for mode in range(mode_count):
                bent[prior, mode] += modes[prior, target, mode] * line
                longer[prior, mode] += modes[prior, target, mode] * line_longer
    weights = np.empty(priors)
    least = least_variance(std, seen, least_std)
    most = (LARGEST_NOISE * (length_seen / distances.size)) ** 2
    noise = noise_variance(bent, longer, mode_variances, least, most, settings, weights)

    size = points.size
    theta, log_stretch = np.empty(size), np.empty(size)
    curvature, variance = np.zeros(size), np.zeros(size)
    for point in range(size):
        theta[point], log_stretch[point] = mean_theta, mean_stretch
    own_curvature, own_variance = np.empty((priors, size)), np.empty((priors, size))
    share = settings.stretch_share * settings.stretch_share
    for prior in range(priors):
        weight = weights[prior]
        if weight == 0.0:
            continue
        for point in range(size):
            own_curvature[prior, point] = 0.0
            own_variance[prior, point] = prior_variance[prior, point]
        for mode in range(mode_count):
            known = 1.0 / (mode_variances[prior, mode] + noise)
            turn = bent[prior, mode] * known
            length = longer[prior, mode] * share / (share * mode_variances[prior, mode] + noise)
            for point in range(size):
                row = theta_rows[prior, mode, point]
                theta[point] += row * (weight * turn)
                log_stretch[point] += row * (weight * length)
                row = curvature_rows[prior, mode, point]
                own_curvature[prior, point] += row * turn
                own_variance[prior, point] -= row * row * known
        for point in range(size):
            curvature[point] += weight * own_curvature[prior, point]
    for prior in range(priors):
        if weights[prior] > 0.0:
            for point in range(size):
                away = own_curvature[prior, point] - curvature[point]
                own = max(own_variance[prior, point], 0.0)
                variance[point] += weights[prior] * (own + away * away)

    px, py = np.zeros(size), np.zeros(size)
    integrate(points, theta, curvature, log_stretch, px, py)
    offset_x = offset_y = 0.0
    for target in range(seen.size):
        offset_x += shares[target] * (x[seen[target]] - px[target_points[target]])
        offset_y += shares[target] * (y[seen[target]] - py[target_points[target]])
    squares = 0.0
    for target in range(seen.size):
        squares += (px[target_points[target]] + offset_x - x[seen[target]]) ** 2
        squares += (py[target_points[target]] + offset_y - y[seen[target]]) ** 2
    first = theta[station_points[0]]
    whole_turns = 2.0 * math.pi * math.ceil(first / (2.0 * math.pi) - 0.5)
    for station in range(station_points.size):
        point = station_points[station]
        per_length = math.exp(-log_stretch[point])
        out[0, station] = px[point] + offset_x
        out[1, station] = py[point] + offset_y
        out[2, station] = theta[point] - whole_turns
        out[3, station] = curvature[point] * per_length
        out[4, station] = math.sqrt(variance[point]) * per_length
    return math.sqrt(squares / (2 * seen.size))


@inner
def chords(
    x: Array, y: Array, seen: Indices, distances: Array, angle: Array, stretch: Array
) -> None:
    """Fill the mean angle (rad) and logarithm of the stretch between neighboring seen targets."""
    before_u = before_v = 0.0
    last = distances.size - 1
    for cell in range(last + 1):
        u = x[seen[cell + 1]] - x[seen[cell]]
        v = y[seen[cell + 1]] - y[seen[cell]]
        if cell == 0:
            angle[0] = math.atan2(v, u)
        else:
            turn = math.atan2(before_u * v - before_v * u, before_u * u + before_v * v)
            angle[cell] = angle[cell - 1] + turn
        stretch[cell] = 0.5 * np.log((u * u + v * v) / (distances[cell] * distances[cell]))
        before_u, before_v = u, v
    for cell in range(last + 1):
        before, after = max(cell - 1, 0), min(cell + 1, last)
        apart = 0.5 * (distances[before] + distances[after])
        if after - before == 2:
            apart += distances[cell]
        turn = (angle[after] - angle[before]) / apart * distances[cell]
        stretch[cell] += turn * turn / 24.0  # the chord of an arc is shorter than the arc


@inner
def integrate(
    points: Array, theta: Array, curvature: Array, log_stretch: Array, px: Array, py: Array
) -> None:
    """Fill px, py (points,) m with the integral of the tangent, by Simpson's rule."""
    scale = math.exp(log_stretch[0])
    here_u, here_v = scale * math.cos(theta[0]), scale * math.sin(theta[0])
    for point in range(1, points.size):
        length = points[point] - points[point - 1]
        middle = 0.5 * (theta[point - 1] + theta[point])
        middle += 0.125 * length * (curvature[point - 1] - curvature[point])
        there = math.exp(log_stretch[point])
        there_u, there_v = there * math.cos(theta[point]), there * math.sin(theta[point])
        four = 2.0 * (scale + there)  # the stretch hardly changes between points
        px[point] = px[point - 1] + length / 6.0 * (here_u + four * math.cos(middle) + there_u)
        py[point] = py[point - 1] + length / 6.0 * (here_v + four * math.sin(middle) + there_v)
        scale, here_u, here_v = there, there_u, there_v


@inner
def least_variance(std: Array, seen: Indices, least_std: float) -> float:
    """Return the median detection variance (m^2) of the seen targets, at least `least_std`^2."""
    known = np.empty(seen.size)
    for target in range(seen.size):
        value = std[seen[target]]
        value = value if value > 0.0 else 0.0  # also where it is NaN
        place = target  # in order, because numba's sort takes long to compile
        while place > 0 and known[place - 1] > value:
            known[place] = known[place - 1]
            place -= 1
        known[place] = value
    median = float(known[seen.size // 2])
    return median * median + least_std * least_std


@inner
def noise_variance(
    bent: Array,
    longer: Array,
    mode_variances: Array,
    least: float,
    most: float,
    settings: SmootherSettings,
    weights: Array,
) -> float:
    """Return the noise variance (m^2) of a frame with the largest marginal likelihood.

    The std of a detection does not include the placement error of the painted target. weights
    (priors,) is filled with the probability of each prior under this noise.
    """
    share = settings.stretch_share * settings.stretch_share
    misfits = np.empty(weights.size)
    best, best_misfit = least, np.inf
    level = least
    while level <= most or level == least:
        smallest = np.inf
        for prior in range(weights.size):
            misfit, product = 0.0, 1.0
            for mode in range(mode_variances.shape[1]):
                across = mode_variances[prior, mode] + level
                along = share * mode_variances[prior, mode] + level
                misfit += bent[prior, mode] ** 2 / across + longer[prior, mode] ** 2 / along
                product *= across / least * along / least
                if product > 1e200:
                    misfit += math.log(product)
                    product = 1.0
            misfits[prior] = misfit + math.log(product)
            smallest = min(smallest, misfits[prior])
        if smallest < best_misfit:
            best, best_misfit = level, smallest
            for prior in range(weights.size):
                weights[prior] = math.exp(-0.5 * (misfits[prior] - best_misfit))
        elif smallest > best_misfit + FAR_WORSE:
            break
        level *= LEVEL_RATIO * LEVEL_RATIO
    for least_weight in (LEAST_WEIGHT, 0.0):
        total = 0.0
        for prior in range(weights.size):
            total += weights[prior]
        for prior in range(weights.size):
            weights[prior] /= total
            if weights[prior] < least_weight:
                weights[prior] = 0.0
    return best

"""The arithmetic of smoothing one frame: targets to curve.

The tangent of the curve is exp(stretch + i angle), with the logarithm of the stretch and the angle
as functions of arclength. The logarithm of the chord between two neighboring targets, divided by
their distance along the arm, is the mean of stretch + i angle between them; only the chord of an
arc is shorter than the arc. Summed up along the arm, chords give a line whose noise is that of the
targets: the arm straightened out. Its second derivative is the curvature, and one linear operator
smooths it, whatever the shape.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.jit import kernel

Indices = npt.NDArray[np.int64]

STRETCH_SHARE = 0.01  # how much the stretch varies along the arm, as a share of the angle's change
LEVEL_RATIO = 1.5  # between levels of noise
LARGEST_NOISE = 0.1  # of the mean distance of targets
FAR_WORSE = 20.0  # in -2 log likelihood: no more noise than this is tried
LEAST_WEIGHT = 1e-3  # a prior less probable than this takes no part


@kernel
def smooth_targets(
    x: Array,
    y: Array,
    std: Array,
    seen: Indices,
    distances: Array,
    slope: Array,
    modes: Array,
    mode_variances: Array,
    theta_rows: Array,
    curvature_rows: Array,
    prior_variance: Array,
    points: Array,
    target_points: Indices,
    station_points: Indices,
    least_std: float,
    origin: float,
    out: Array,
) -> float:
    """Fill out (5, stations) with x, y, theta, curvature, std of curvature; return the rms.

    x, y, std (all targets,) m; the rest is of a `SmoothingOperator`, but for least_std, the
    noise (m) below which none is believed, and origin: where the curve passes at the first seen
    target, (origin, 0) m; NaN leaves it where it was seen.
    """
    priors, mode_count = mode_variances.shape
    angle, stretch = np.empty(distances.size), np.empty(distances.size)
    chords(x, y, seen, distances, angle, stretch)
    bent, longer = np.zeros((priors, mode_count)), np.zeros((priors, mode_count))
    line = line_longer = mean_theta = mean_stretch = 0.0
    for target in range(1, seen.size):
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
    most = (LARGEST_NOISE * distances.mean()) ** 2
    noise = noise_variance(bent, longer, mode_variances, least, most, weights)

    size = points.size
    theta, log_stretch = np.full(size, mean_theta), np.full(size, mean_stretch)
    curvature, variance = np.zeros(size), np.zeros(size)
    own_curvature, own_variance = np.empty((priors, size)), np.empty((priors, size))
    share = STRETCH_SHARE * STRETCH_SHARE
    for prior in range(priors):
        weight = weights[prior]
        if weight == 0.0:
            continue
        own_curvature[prior] = 0.0
        own_variance[prior] = prior_variance[prior]
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
        offset_x += x[seen[target]] - px[target_points[target]]
        offset_y += y[seen[target]] - py[target_points[target]]
    offset_x /= seen.size
    offset_y /= seen.size
    squares = 0.0
    for target in range(seen.size):
        squares += (px[target_points[target]] + offset_x - x[seen[target]]) ** 2
        squares += (py[target_points[target]] + offset_y - y[seen[target]]) ** 2
    if not math.isnan(origin):
        offset_x, offset_y = origin, 0.0
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


@kernel
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


@kernel
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
        four = 2.0 * (scale + there)  # the stretch hardly changes from point to point
        px[point] = px[point - 1] + length / 6.0 * (here_u + four * math.cos(middle) + there_u)
        py[point] = py[point - 1] + length / 6.0 * (here_v + four * math.sin(middle) + there_v)
        scale, here_u, here_v = there, there_u, there_v


@kernel
def least_variance(std: Array, seen: Indices, least_std: float) -> float:
    """Return the median of what detection says of the seen targets, at least `least_std`; m^2."""
    known = np.empty(seen.size)
    for target in range(seen.size):
        value = std[seen[target]]
        known[target] = value if value > 0.0 else 0.0  # also where it is NaN
    known.sort()
    median = float(known[seen.size // 2])
    return median * median + least_std * least_std


@kernel
def noise_variance(
    bent: Array, longer: Array, mode_variances: Array, least: float, most: float, weights: Array
) -> float:
    """Return the level of noise (m^2) that explains a frame best, by marginal likelihood.

    Detection knows how exactly it saw a target, not how exactly the target was painted. weights
    (priors,) is filled with the probability of each prior under this noise.
    """
    share = STRETCH_SHARE * STRETCH_SHARE
    misfits = np.empty(weights.size)
    best, best_misfit = least, np.inf
    level = least
    while level <= most or level == least:
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
        if misfits.min() < best_misfit:
            best, best_misfit = level, misfits.min()
            weights[:] = np.exp(-0.5 * (misfits - best_misfit))
        elif misfits.min() > best_misfit + FAR_WORSE:
            break
        level *= LEVEL_RATIO * LEVEL_RATIO
    weights /= weights.sum()
    for prior in range(weights.size):
        if weights[prior] < LEAST_WEIGHT:
            weights[prior] = 0.0
    weights /= weights.sum()
    return best

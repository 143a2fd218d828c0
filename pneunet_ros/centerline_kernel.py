"""The arithmetic of smoothing one frame: targets to curve.

The tangent of the curve is exp(stretch + i angle), with the logarithm of the stretch and the angle
as functions of arclength. The logarithm of the chord between two neighboring targets, divided by
their distance along the arm, is the mean of stretch + i angle between them, but for a small term
that the curve itself tells. Summed up along the arm, chords give a line of which the noise is that
of the targets: the arm straightened out. Its second derivative is the curvature, and a linear
operator smooths it, the same for every shape.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.shape import Array
from pneunet_ros.solver.compiled import kernel

Indices = npt.NDArray[np.int64]

PASSES = 2  # the first tells the small term for the second
STRETCH_SHARE = 0.01  # how much the stretch varies along the arm, as a share of the angle's change
LEVEL_RATIO = 1.5  # between levels of noise
LARGEST_NOISE = 0.1  # of the mean distance of targets


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
    count, size, stations = seen.size, points.size, station_points.size
    angle, stretch = np.empty(count - 1), np.empty(count - 1)
    before_u = before_v = 0.0
    for cell in range(count - 1):
        u = x[seen[cell + 1]] - x[seen[cell]]
        v = y[seen[cell + 1]] - y[seen[cell]]
        if cell == 0:
            angle[0] = math.atan2(v, u)
        else:
            turn = math.atan2(before_u * v - before_v * u, before_u * u + before_v * v)
            angle[cell] = angle[cell - 1] + turn
        stretch[cell] = 0.5 * np.log((u * u + v * v) / (distances[cell] * distances[cell]))
        before_u, before_v = u, v
    small_angle, small_stretch = np.zeros(count - 1), np.zeros(count - 1)
    theta, curvature, log_stretch = np.empty(size), np.empty(size), np.empty(size)
    px, py = np.zeros(size), np.zeros(size)
    bent, longer = np.zeros(modes.shape[0]), np.zeros(modes.shape[0])
    noise = 0.0
    for step in range(PASSES):
        # The arm straightened out: its line, and the line's modes.
        bent[:] = 0.0
        longer[:] = 0.0
        line = line_longer = 0.0
        mean_theta = mean_stretch = 0.0
        for target in range(1, count):
            cell = target - 1
            line += distances[cell] * (angle[cell] + small_angle[cell])
            line_longer += distances[cell] * (stretch[cell] + small_stretch[cell])
            mean_theta += slope[target] * line
            mean_stretch += slope[target] * line_longer
            for mode in range(bent.size):
                bent[mode] += modes[mode, target] * line
                longer[mode] += modes[mode, target] * line_longer
        if step == 0:
            noise = noise_variance(
                bent, longer, mode_variances, least_variance(std, seen, least_std),
                (LARGEST_NOISE * distances.mean()) ** 2,
            )  # fmt: skip
        share = STRETCH_SHARE * STRETCH_SHARE
        for mode in range(bent.size):
            bent[mode] /= mode_variances[mode] + noise
            longer[mode] *= share / (share * mode_variances[mode] + noise)
        for point in range(size):
            sum_theta, sum_stretch, sum_curvature = mean_theta, mean_stretch, 0.0
            for mode in range(bent.size):
                sum_theta += theta_rows[point, mode] * bent[mode]
                sum_stretch += theta_rows[point, mode] * longer[mode]
                sum_curvature += curvature_rows[point, mode] * bent[mode]
            theta[point], log_stretch[point] = sum_theta, sum_stretch
            curvature[point] = sum_curvature
        # The curve, by Simpson's rule between points; what its chords say of the small terms.
        here_u = math.exp(log_stretch[0]) * math.cos(theta[0])
        here_v = math.exp(log_stretch[0]) * math.sin(theta[0])
        cell = 0
        area = area_stretch = 0.0
        for point in range(1, size):
            length = points[point] - points[point - 1]
            middle = 0.5 * (theta[point - 1] + theta[point])
            middle += 0.125 * length * (curvature[point - 1] - curvature[point])
            middle_stretch = 0.5 * (log_stretch[point - 1] + log_stretch[point])
            scale = math.exp(middle_stretch)
            there = math.exp(log_stretch[point])
            there_u = there * math.cos(theta[point])
            there_v = there * math.sin(theta[point])
            sixth = length / 6.0
            px[point] = px[point - 1] + sixth * (here_u + 4.0 * scale * math.cos(middle) + there_u)
            py[point] = py[point - 1] + sixth * (here_v + 4.0 * scale * math.sin(middle) + there_v)
            area += sixth * (theta[point - 1] + 4.0 * middle + theta[point])
            area_stretch += length * middle_stretch
            here_u, here_v = there_u, there_v
            if point == target_points[cell + 1]:
                mean = area / distances[cell]
                u = px[point] - px[target_points[cell]]
                v = py[point] - py[target_points[cell]]
                cosine, sine = math.cos(mean), math.sin(mean)
                small_angle[cell] = -math.atan2(v * cosine - u * sine, u * cosine + v * sine)
                chord = 0.5 * np.log((u * u + v * v) / (distances[cell] * distances[cell]))
                small_stretch[cell] = area_stretch / distances[cell] - chord
                area = area_stretch = 0.0
                cell += 1
    # Put among the targets, then where the first of them belongs.
    offset_x = offset_y = 0.0
    for target in range(count):
        offset_x += x[seen[target]] - px[target_points[target]]
        offset_y += y[seen[target]] - py[target_points[target]]
    offset_x /= count
    offset_y /= count
    squares = 0.0
    for target in range(count):
        squares += (px[target_points[target]] + offset_x - x[seen[target]]) ** 2
        squares += (py[target_points[target]] + offset_y - y[seen[target]]) ** 2
    if origin == origin:
        offset_x, offset_y = origin, 0.0
    whole_turns = 2.0 * math.pi * math.ceil(theta[station_points[0]] / (2.0 * math.pi) - 0.5)
    for station in range(stations):
        point = station_points[station]
        per_length = math.exp(-log_stretch[point])
        variance = prior_variance[point]
        for mode in range(bent.size):
            row = curvature_rows[point, mode]
            variance -= row * row / (mode_variances[mode] + noise)
        out[0, station] = px[point] + offset_x
        out[1, station] = py[point] + offset_y
        out[2, station] = theta[point] - whole_turns
        out[3, station] = curvature[point] * per_length
        out[4, station] = math.sqrt(max(variance, 0.0)) * per_length
    return math.sqrt(squares / (2 * count))


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
    bent: Array, longer: Array, mode_variances: Array, least: float, most: float
) -> float:
    """Return the level of noise (m^2) that explains a frame best, by marginal likelihood.

    Detection knows how exactly it saw a target, not how exactly the target was painted.
    """
    share = STRETCH_SHARE * STRETCH_SHARE
    best, best_misfit = least, np.inf
    level = least
    while True:
        misfit = 0.0
        product = 1.0
        for mode in range(bent.size):
            across = mode_variances[mode] + level
            along = share * mode_variances[mode] + level
            misfit += bent[mode] * bent[mode] / across + longer[mode] * longer[mode] / along
            product *= (across / least) * (along / least)
            if product > 1e200:
                misfit += np.log(product)
                product = 1.0
        misfit += np.log(product)
        if misfit < best_misfit:
            best, best_misfit = level, misfit
        level *= LEVEL_RATIO * LEVEL_RATIO
        if level > most:
            return best

"""Distance of the targets of one frame from their prediction, relative to the expected errors.

One kernel computes it: a replay of an hour compares every frame.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
import numpy.typing as npt
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.kernels.jit import inlined, inner, kernel
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.measurement.disturbances import SMALLEST_STD
from pneunet_ros.measurement.predicted_targets import PredictedTargets
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.swing import solve_small

Indices = npt.NDArray[np.intp]
FEWEST_BEYOND_CLAMP = 3  # targets that determine a tip: as many as shapes of the row


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Innovation:
    """Whitened distance of the targets of one frame from their prediction.

    chi_square: that of all `coordinates` together; at_targets (targets,): chi square of each
    target per coordinate, NaN if it was not seen; at_tip: that of both coordinates of the tip,
    estimated from all targets, NaN if too few were seen.
    """

    coordinates: int
    chi_square: float
    at_targets: Array
    at_tip: float


def innovation(
    predicted: PredictedTargets, sightings: TargetSightings, noise: SensorNoise
) -> Innovation | None:
    """Compare a frame with its prediction; None if no target was seen.

    The white noise of a target is the larger of those of the model and of the tracker. The targets
    are taken for those of the calibration, with known placement, or for others, whichever is more
    likely in this frame.
    """
    (seen,) = np.nonzero(np.isfinite(sightings.x) & np.isfinite(sightings.y))
    if not seen.size:
        return None
    at_targets = np.full(sightings.x.size, np.nan)
    chi_square, at_tip = compare_targets(
        np.array([sightings.x - predicted.x, sightings.y - predicted.y]),
        np.fmax(sightings.std, noise.target_std),
        seen,
        predicted.placed,
        predicted.placed_std,
        noise.placement_std,
        math.hypot(noise.registration_std, noise.drift_std),
        predicted.errors,
        predicted.share,
        at_targets,
    )
    return Innovation(
        coordinates=2 * seen.size, chi_square=chi_square, at_targets=at_targets, at_tip=at_tip
    )


@kernel
def compare_targets(
    residuals: Array,
    white: Array,
    seen: Indices,
    placed: Array,
    placed_std: Array,
    placement_std: float,
    camera_std: float,
    errors: Array,
    share: Array,
    at_targets: Array,
) -> tuple[float, float]:
    """Compute `innovation`; returns chi squared of all coordinates seen, and that of the tip.

    residuals (2, targets) m: measured minus predicted; white (targets,) m: one sigma of each
    target; seen: mask of the targets seen; placed, placed_std: as in PredictedTargets;
    placement_std, camera_std m: one sigma of the positions of other targets, and of the camera;
    errors (n, 2, targets) m; share (targets,). Fills at_targets (targets,).
    """
    count, sources = seen.size, len(errors)
    columns = np.zeros((sources + 2, 2 * count))  # the camera last
    for axis in range(2):
        for i in range(count):
            for source in range(sources):
                columns[source, axis * count + i] = errors[source, axis, seen[i]]
            columns[sources + axis, axis * count + i] = camera_std
    known = False
    for axis in range(2):
        for i in range(count):
            known = known or placed[axis, seen[i]] != 0.0
    residual, std = np.empty(2 * count), np.empty(2 * count)
    chi_square, least, is_calibrated = 0.0, math.inf, 0
    for calibrated in range(2 if known else 1):  # other targets, then those of the calibration
        cost = 0.0
        for axis in range(2):
            for i in range(count):
                target, k = seen[i], axis * count + i
                residual[k] = residuals[axis, target] - calibrated * placed[axis, target]
                position_std = placed_std[target] if calibrated else placement_std
                std[k] = max(math.hypot(white[target], position_std), SMALLEST_STD)
                cost += 2.0 * math.log(std[k])
        distance = squared_distance(residual, std, columns)
        if calibrated == 0 or cost + distance < least:
            chi_square, least, is_calibrated = distance, cost + distance, calibrated
    for i in range(count):
        target = seen[i]
        position_std = placed_std[target] if is_calibrated else placement_std
        variance = max(math.hypot(white[target], position_std), SMALLEST_STD) ** 2
        at_targets[target] = 0.5 * distance_in_plane(
            residuals[0, target] - is_calibrated * placed[0, target],
            residuals[1, target] - is_calibrated * placed[1, target],
            columns[:, i].copy(),
            columns[:, count + i].copy(),
            variance,
        )
    return chi_square, tip_distance(residuals, white, seen, placed, placed_std, errors, share)


@inner
def squared_distance(residual: Array, std: Array, columns: Array) -> float:
    """Return r^T C^-1 r of a residual (coordinates,), C = diag(std^2) + P^T P.

    columns P (errors, coordinates): one sigma of each error that all coordinates share. The
    smaller matrix is factored: that of the coordinates, or 1 + P P^T of the errors (Woodbury).
    """
    errors, coordinates = columns.shape
    white, square = np.empty(coordinates), 0.0
    for k in range(coordinates):
        white[k] = residual[k] / std[k]
        square += white[k] * white[k]
    if coordinates < errors:
        rows = np.empty((coordinates, errors))
        for k in range(coordinates):
            for error in range(errors):
                rows[k, error] = columns[error, k] / std[k]
        return inverse_form(gram_matrix(rows), white)
    rows, projection = np.empty((errors, coordinates)), np.zeros(errors)
    for error in range(errors):
        for k in range(coordinates):
            rows[error, k] = columns[error, k] / std[k]
            projection[error] += rows[error, k] * white[k]
    return square - inverse_form(gram_matrix(rows), projection)


@inner
def gram_matrix(rows: Array) -> Array:
    """Return the lower half of 1 + R R^T of rows (n, m), (n, n)."""
    size = len(rows)
    gram = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            total = 1.0 if i == j else 0.0
            for k in range(rows.shape[1]):
                total += rows[i, k] * rows[j, k]
            gram[i, j] = total
    return gram


@inner
def inverse_form(matrix: Array, vector: Array) -> float:
    """Return v^T M^-1 v of a positive definite M (lower half), by Cholesky; overwrites both."""
    total = 0.0
    for i in range(vector.size):
        for j in range(i):
            part = matrix[i, j]
            for k in range(j):
                part -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = part / matrix[j, j]
            matrix[i, i] -= matrix[i, j] * matrix[i, j]
            vector[i] -= matrix[i, j] * vector[j]
        matrix[i, i] = math.sqrt(matrix[i, i])
        vector[i] /= matrix[i, i]
        total += vector[i] * vector[i]
    return total


@inner
def distance_in_plane(x: float, y: float, by_x: Array, by_y: Array, variance: float) -> float:
    """Return the squared Mahalanobis distance of a point x, y (m).

    by_x, by_y (errors,) m: one sigma of each error; variance (m^2): of both coordinates.
    """
    variance_x, variance_y, covariance_xy = variance, variance, 0.0
    for error in range(by_x.size):
        variance_x += by_x[error] * by_x[error]
        variance_y += by_y[error] * by_y[error]
        covariance_xy += by_x[error] * by_y[error]
    area = variance_x * variance_y - covariance_xy * covariance_xy
    return (variance_y * x * x - 2.0 * covariance_xy * x * y + variance_x * y * y) / area


@inner
def tip_distance(
    residuals: Array,
    white: Array,
    seen: Indices,
    placed: Array,
    placed_std: Array,
    errors: Array,
    share: Array,
) -> float:
    """Return the squared Mahalanobis distance of the tip from its prediction; 2 coordinates.

    Arguments as in `compare_targets`. A smooth curve through all targets determines the tip better
    than a single target does: chi squared hides an error of the tip that is smaller than the noise
    of a target, even if it is in every frame. The tip is relative to the clamp, so that the camera
    position does not matter. NaN for fewer than three targets beyond the clamp.
    """
    count, sources, beyond = seen.size, len(errors), 0
    normal, tip = np.zeros((3, 3)), np.ones((3, 1))
    tip[0, 0] = 0.0  # an offset of the whole row is due to the camera
    for i in range(count):
        target = seen[i]
        position = share[target]
        beyond += position > 0.0
        std = max(math.hypot(white[target], placed_std[target]), SMALLEST_STD)
        for j in range(3):
            for k in range(3):
                normal[j, k] += bend(position, j) * bend(position, k) / std**2
    if beyond < FEWEST_BEYOND_CLAMP:
        return math.nan
    solve_small(normal, tip)
    x, y, noise = 0.0, 0.0, 0.0
    by_x, by_y = np.zeros(sources), np.zeros(sources)
    for i in range(count):
        target = seen[i]
        position = share[target]
        std = max(math.hypot(white[target], placed_std[target]), SMALLEST_STD)
        weight = 0.0
        for j in range(3):
            weight += bend(position, j) * tip[j, 0] / std**2
        x += weight * (residuals[0, target] - placed[0, target])
        y += weight * (residuals[1, target] - placed[1, target])
        noise += (weight * std) ** 2
        for source in range(sources):
            by_x[source] += weight * errors[source, 0, target]
            by_y[source] += weight * errors[source, 1, target]
    return distance_in_plane(x, y, by_x, by_y, noise)


@inlined
def bend(share: float, shape: int) -> float:
    """Return a shape of the row at a share of its length: shifted, bent, bent more at its end."""
    if shape == 0:
        return 1.0
    return share**2 if shape == 1 else share**3

"""Distance of the targets of one frame from their prediction, relative to the expected errors."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.measurement.disturbances import SMALLEST_STD
from pneunet_ros.measurement.predicted_targets import PredictedTargets
from pneunet_ros.model.uncertainty import SensorNoise

FEWEST_BEYOND_CLAMP = 3  # targets that determine a tip: one per shape of the row


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
    are assumed to be those of the calibration, with known placement, or repainted ones, whichever
    is more likely in this frame.
    """
    (seen,) = np.nonzero(np.isfinite(sightings.x + sightings.y))
    if not seen.size:
        return None
    white = np.fmax(sightings.std, noise.target_std)[seen]
    residual = np.array([sightings.x - predicted.x, sightings.y - predicted.y])[:, seen]
    placed, errors = predicted.placed[:, seen], predicted.errors[:, :, seen]
    placed_std = np.maximum(np.hypot(white, predicted.placed_std[seen]), SMALLEST_STD)
    other_std = np.maximum(np.hypot(white, noise.placement_std), SMALLEST_STD)
    camera = math.hypot(noise.registration_std, noise.drift_std) * np.eye(2)
    columns = np.concatenate([errors, np.repeat(camera[:, :, None], seen.size, axis=2)])
    rows = columns.reshape(len(columns), -1)
    cases = []
    for apart, std in [(residual, other_std), (residual - placed, placed_std)]:
        chi_square = float(squared_distance(apart.ravel(), np.tile(std, 2), rows))
        cases.append((4.0 * float(np.log(std).sum()) + chi_square, chi_square, apart, std))
    _, chi_square, apart, std = min(cases[: 1 + placed.any()], key=lambda case: case[0])
    at_targets = np.full(sightings.x.size, np.nan)
    of_target = columns.transpose(2, 0, 1)
    at_targets[seen] = 0.5 * squared_distance(apart.T, std[:, None], of_target)
    return Innovation(
        coordinates=2 * seen.size,
        chi_square=chi_square,
        at_targets=at_targets,
        at_tip=tip_distance(residual - placed, placed_std, errors, predicted.share[seen]),
    )


def squared_distance(residual: Array, std: Array, errors: Array) -> Array:
    """Return r^T C^-1 r of residuals (..., n), (...); C = diag(std^2) + E^T E.

    E (..., errors, n): one sigma of each error that the coordinates share. Uses Woodbury's formula
    if there are more coordinates than errors (a frame may have 500 targets).
    """
    if len(errors.shape) == 2 and errors.shape[0] < residual.size:
        white, shared = residual / std, errors / std
        along = shared @ white
        inner = np.eye(len(errors)) + shared @ shared.T
        return np.asarray(white @ white - along @ np.linalg.solve(inner, along))
    covariance = np.swapaxes(errors, -1, -2) @ errors
    covariance += std[..., None] ** 2 * np.eye(residual.shape[-1])
    explained = np.linalg.solve(covariance, residual[..., None])[..., 0]
    return np.asarray((residual * explained).sum(axis=-1))


def tip_distance(residual: Array, std: Array, errors: Array, share: Array) -> float:
    """Return the squared Mahalanobis distance of the tip from its prediction; 2 coordinates.

    residual (2, targets) m, std (targets,) m, errors (n, 2, targets) m and share (targets,) of the
    targets seen. A smooth curve through all targets determines the tip better than a single target
    does; chi squared would hide a tip error that is smaller than the noise of a target, even if it
    persisted in every frame. The tip is relative to the clamp, so that the camera position does
    not matter. NaN for fewer than three targets beyond the clamp.
    """
    if np.count_nonzero(share > 0.0) < FEWEST_BEYOND_CLAMP:
        return math.nan
    row = np.stack([np.ones(share.size), share**2, share**3])  # shifted, bent, bent at its end
    tip = [0.0, 1.0, 1.0]  # the camera causes an offset of the whole row
    weights = tip @ np.linalg.pinv((row / std).T) / std
    noise = np.full(2, np.linalg.norm(weights * std))
    return float(squared_distance(residual @ weights, noise, errors @ weights))

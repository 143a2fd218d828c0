"""Predicted targets of an estimate, and the innovation of a frame.

Errors of readings, of the model and of the camera's place move all targets of a frame together:
they are columns of the covariance, not spread over its diagonal. Noise that ignores this has the
right size and raises false alarms all the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import functools
import math

import numpy as np
from pneunet_ros.core.arrays import Array, freeze
from pneunet_ros.core.readings import TargetSightings
from pneunet_ros.measurement.disturbances import SMALLEST_STD
from pneunet_ros.measurement.errors.covariance import chi_squared
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.errors.noise_model import camera_errors, target_stds
from pneunet_ros.measurement.errors.second_order import SecondOrder
from pneunet_ros.measurement.painted_targets import in_plane, painted_at
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import LOADS

KEPT = 64  # sets of targets seen, whose weights are kept


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedTargets:
    """Where the targets of the arm must be measured; x, y (targets,) m in the base frame.

    errors (sources, 2, targets) m: effect of one sigma of each independent error of reading or
    model on all of them: F1, F2, M, the pressure and the columns of the model's covariance; the
    last `own` are of this frame alone: to second order, then of motion. The place of the camera
    and the targets' own noise are not among these. by_load (3, 2, targets): how they move by F1,
    F2 (m/N), M (1/N). theta (targets,) rad. share (targets,): where they are, of the way to the
    last one. placed (2, targets) m: by how much each is painted beside its place, as the
    calibration found it, and placed_std (targets,) m how well that is known.
    """

    x: Array
    y: Array
    errors: Array
    by_load: Array
    theta: Array
    share: Array
    placed: Array
    placed_std: Array
    own: int = 1

    def moved(self, x: Array, y: Array, errors: Array) -> PredictedTargets:
        """Return the targets moved by x, y (targets,) m, with further errors (n, 2, targets) m."""
        return replace(
            self,
            x=self.x + x,
            y=self.y + y,
            errors=np.concatenate([self.errors, errors]),
            own=self.own + len(errors),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Innovation:
    """Whitened distance of the targets of one frame from their prediction.

    chi_square is that of all `coordinates` together; at_targets (targets,) the same for each
    target, per coordinate, NaN if it was not seen; at_tip that of both coordinates of the tip,
    estimated from all targets, NaN where too few were seen.
    """

    coordinates: int
    chi_square: float
    at_targets: Array
    at_tip: float


def predict_targets(
    table: PerturbationTable, noise: Array, curved: SecondOrder
) -> PredictedTargets:
    """Return where the targets must be at an estimate.

    noise (sources, causes): its noise input matrix, of the causes of the table; curved: its
    sensitivity, and what errors move to second order.
    """
    arm, sensitivity = table.arm, curved.sensitivity
    true_x, true_y, theta, curvature = sensitivity.fields(arm.target_arclength)[:4]
    moved = curved.stations(arm.target_arclength)[:2]
    jacobian = target_jacobian(table, sensitivity)[:, :2]
    linear = (noise @ jacobian.reshape(len(jacobian), -1)).reshape(-1, *jacobian.shape[1:])
    further = np.stack(arm.see_moves(true_x, true_y, *moved))
    errors = np.concatenate([linear, further[None]])
    x, y = arm.see(true_x, true_y)
    share = arm.target_arclength / max(float(arm.target_arclength[-1]), 1e-12)
    placed, placed_std = painted_beside(arm, theta, curvature)
    return PredictedTargets(
        x=x,
        y=y,
        errors=errors,
        by_load=jacobian[:LOADS],
        theta=theta,
        share=share,
        placed=placed,
        placed_std=placed_std,
    )


def seen_targets(arm: Arm, sensitivity: Sensitivity) -> tuple[Array, Array]:
    """Return where the targets of a solved rod are measured, x and y (targets,) m."""
    true_x, true_y = sensitivity.fields(arm.target_arclength)[:2]
    return arm.see(true_x, true_y)


def painted_beside(arm: Arm, theta: Array, curvature: Array) -> tuple[Array, Array]:
    """Return the misplacement of targets (.., 2, targets) m, and its std (targets,) m.

    theta (rad), curvature (1/m), both (.., targets): of the arm at their places. As the
    calibration found it, if it did.
    """
    known = None if arm.covariance is None else arm.covariance.placement
    if known is None:
        nothing = np.zeros((*theta.shape[:-1], 2, theta.shape[-1]))
        return nothing, np.full(theta.shape[-1], arm.sensors.placement_std)
    beside = painted_at(theta, curvature, known.mean.reshape(2, -1))
    std = np.sqrt(np.mean(known.std.reshape(2, -1) ** 2, axis=0))
    return in_plane(beside) + known.origin[:, None], std


def target_jacobian(table: PerturbationTable, sensitivity: Sensitivity) -> Array:
    """Return how the targets of a solved rod are measured to move, (causes, 4, targets).

    Of each x, y (m), and how the arm turns (rad) and bends (1/m) there. causes: F1, F2, M, the
    pressure in the chamber, columns of the model's covariance. A camera that distorts distorts
    errors as well, and a column may be of the camera itself.
    """
    arm = table.arm
    jacobian = measured_moves(arm, sensitivity)
    if not arm.seeing:
        return jacobian
    true_x, true_y = sensitivity.fields(arm.target_arclength)[:2]
    seen = [np.stack(side.see(true_x, true_y)) for side in table.neighbors]
    columns = len(seen) // 2
    for column, distance in enumerate(table.distance[1:]):
        jacobian[PRESSURE + 1 + column, :2] += (seen[columns + column] - seen[column]) / distance
    return jacobian


def measured_moves(arm: Arm, sensitivity: Sensitivity) -> Array:
    """Return how targets are measured to move by each change of the rod, (changes, 4, targets).

    Of each x, y (m), and how the arm turns (rad) and bends (1/m) there.
    """
    moved = sensitivity.stations(arm.target_arclength)[:, :4]
    if arm.seeing:
        true_x, true_y = sensitivity.fields(arm.target_arclength)[:2]
        seen = arm.see_moves(true_x, true_y, moved[:, 0], moved[:, 1])
        moved[:, 0], moved[:, 1] = seen
    return moved


def innovation(
    predicted: PredictedTargets, sightings: TargetSightings, noise: SensorNoise
) -> Innovation | None:
    """Compare a frame with its prediction; None if no target was seen.

    Of the white noise of a target the larger is taken, as the model has it or as the tracker says.
    The targets are those of the calibration, which knows where they are painted, or others: what
    is likelier in this frame counts.
    """
    seen = np.isfinite(sightings.x) & np.isfinite(sightings.y)
    targets = int(np.count_nonzero(seen))
    if not targets:
        return None
    beside = np.stack([sightings.x - predicted.x, sightings.y - predicted.y])[:, seen]
    white, placed = np.fmax(sightings.std[seen], noise.target_std), predicted.placed[:, seen]
    placed_std = predicted.placed_std[seen]
    camera = camera_errors(float(np.hypot(noise.registration_std, noise.drift_std)), targets)
    moved = predicted.errors[:, :, seen].reshape(-1, 2 * targets).T
    errors = np.concatenate([moved, camera], axis=1)
    rivals = [(beside, target_stds(noise, white))]
    if placed.any():
        rivals.append((beside - placed, np.maximum(np.hypot(white, placed_std), SMALLEST_STD)))
    residuals = np.stack([residual.ravel() for residual, _ in rivals])
    stds = np.stack([np.concatenate([std, std]) for _, std in rivals])
    totals = chi_squared(residuals, stds, errors)
    # Twice the negative log likelihood, with the white noise of both coordinates.
    costs = [
        total + 4.0 * float(np.log(std).sum())
        for total, (_, std) in zip(totals, rivals, strict=True)
    ]
    likelier = int(np.argmin(costs))
    residual, std = rivals[likelier]
    of_target = errors.reshape(2, targets, -1).transpose(1, 0, 2)
    at_targets = np.full(seen.size, np.nan)
    at_targets[seen] = 0.5 * chi_squared(residual.T, std[:, None], of_target)
    at_tip = tip_chi_squared(
        beside - placed,
        np.hypot(white, placed_std),
        predicted.errors[:, :, seen],
        predicted.share[seen],
    )
    return Innovation(
        coordinates=2 * targets,
        chi_square=float(totals[likelier]),
        at_targets=at_targets,
        at_tip=at_tip,
    )


def tip_chi_squared(residual: Array, std: Array, errors: Array, share: Array) -> float:
    """Return the squared Mahalanobis distance of the tip from its prediction; 2 coordinates.

    residual (2, targets) m; std (targets,) m of their own noise; errors (n, 2, targets) m; share
    (targets,): where they are along the arm. A smooth bend through all targets determines the tip
    better than a single target does: an error there below the noise of a target, in every frame,
    hides in `chi_square`. The tip is taken relative to the clamp, wherever the camera is. NaN for
    fewer than three targets beyond the clamp.
    """
    if np.count_nonzero(share > 0.0) < 3:
        return math.nan
    std = np.maximum(std, SMALLEST_STD)
    weights = tip_weights(share.tobytes(), std.tobytes())
    tip, moved = residual @ weights, errors @ weights
    covariance = moved.T @ moved + np.sum((weights * std) ** 2) * np.eye(2)
    return float(tip @ np.linalg.solve(covariance, tip))


@functools.lru_cache(maxsize=KEPT)
def tip_weights(share: bytes, std: bytes) -> Array:
    """Return the weight of each target in the tip of a smooth curve through all, (targets,).

    share and std (targets,) as the bytes of arrays: frame after frame has the same ones.
    """
    places, noise = np.frombuffer(share), np.frombuffer(std)
    shapes = np.stack([np.ones_like(places), places**2, places**3], axis=1) / noise[:, None]
    return freeze(np.linalg.pinv(shapes)[1:].sum(axis=0) / noise)

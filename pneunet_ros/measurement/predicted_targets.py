"""Predicted targets of an estimate.

Errors of readings, model and camera position move all targets of a frame together; they are
columns of the covariance, not added to its diagonal. Uncorrelated noise of the same size would
cause false alarms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pneunet_ros.core.arrays import Array
from pneunet_ros.measurement.errors.noise_jacobian import PRESSURE
from pneunet_ros.measurement.errors.second_order import SecondOrder
from pneunet_ros.measurement.painted_targets import in_plane, paint
from pneunet_ros.model.arm import Arm
from pneunet_ros.model.equilibrium import Sensitivity
from pneunet_ros.model.perturbation import PerturbationTable
from pneunet_ros.solver.columns import LOADS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PredictedTargets:
    """Predicted positions of the targets; x, y (targets,) m in the base frame.

    errors (sources, 2, targets) m: effect of one sigma of each independent error of reading or
    model on all targets: F1, F2, M, the pressure and the columns of the model's covariance; the
    last `frame_error_count` belong to this frame only: second-order errors, then motion. The
    camera position and the noise of the targets are not included. by_load (3, 2, targets):
    derivatives by F1, F2 (m/N), M (1/N). theta (targets,) rad. share (targets,): arclength
    relative to that of the last target. placed (2, targets) m: calibrated misplacement of each
    target; placed_std (targets,) m: its standard deviation.
    """

    x: Array
    y: Array
    errors: Array
    by_load: Array
    theta: Array
    share: Array
    placed: Array
    placed_std: Array
    frame_error_count: int = 1

    def displaced(self, x: Array, y: Array, errors: Array) -> PredictedTargets:
        """Return the targets moved by x, y (targets,) m, with further errors (n, 2, targets) m."""
        return replace(
            self,
            x=self.x + x,
            y=self.y + y,
            errors=np.concatenate([self.errors, errors]),
            frame_error_count=self.frame_error_count + len(errors),
        )


def predict_targets(
    table: PerturbationTable, noise: Array, curved: SecondOrder
) -> PredictedTargets:
    """Return the predicted targets of an estimate.

    noise (sources, causes): its noise input matrix, for the causes of the table; curved:
    sensitivity of the estimate, and second-order effect of errors.
    """
    arm, sensitivity = table.arm, curved.sensitivity
    true_x, true_y, theta, curvature = sensitivity.fields(arm.target_arclength)[:4]
    second_order = curved.stations(arm.target_arclength)[:2]
    jacobian = target_jacobian(table, sensitivity)[:, :2]
    linear = (noise @ jacobian.reshape(len(jacobian), -1)).reshape(-1, *jacobian.shape[1:])
    curved_errors = np.stack(arm.see_moves(true_x, true_y, *second_order))
    errors = np.concatenate([linear, curved_errors[None]])
    x, y = arm.see(true_x, true_y)
    share = arm.target_arclength / max(float(arm.target_arclength[-1]), 1e-12)
    placed, placed_std = target_displacement(arm, theta, curvature)
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
    """Return the measured positions of the targets of a solved rod, x and y (targets,) m."""
    true_x, true_y = sensitivity.fields(arm.target_arclength)[:2]
    return arm.see(true_x, true_y)


def target_displacement(arm: Arm, theta: Array, curvature: Array) -> tuple[Array, Array]:
    """Return the misplacement of targets (.., 2, targets) m, and its std (targets,) m.

    theta (rad), curvature (1/m), both (.., targets): of the arm at the targets. Misplacement and
    std are from the calibration, if it determined them.
    """
    known = None if arm.covariance is None else arm.covariance.placement
    if known is None:
        zero = np.zeros((*theta.shape[:-1], 2, theta.shape[-1]))
        return zero, np.full(theta.shape[-1], arm.sensors.placement_std)
    displacement = paint(theta, curvature, known.mean.reshape(2, -1)).displacement
    std = np.sqrt(np.mean(known.std.reshape(2, -1) ** 2, axis=0))
    return in_plane(displacement) + known.origin[:, None], std


def target_jacobian(table: PerturbationTable, sensitivity: Sensitivity) -> Array:
    """Return derivatives of the measured targets of a solved rod, (causes, 4, targets).

    For each target these are x, y (m), the heading (rad) and curvature (1/m) of the arm there.
    causes: F1, F2, M, the pressure in the chamber, columns of the model's covariance. Camera
    distortion applies to errors as well, and a column may belong to the camera.
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
    """Return derivatives of the measured targets by each change of the rod, (changes, 4, targets).

    For each target these are x, y (m), the heading (rad) and curvature (1/m) of the arm there.
    """
    moves = sensitivity.stations(arm.target_arclength)[:, :4]
    if arm.seeing:
        true_x, true_y = sensitivity.fields(arm.target_arclength)[:2]
        seen = arm.see_moves(true_x, true_y, moves[:, 0], moves[:, 1])
        moves[:, 0], moves[:, 1] = seen
    return moves

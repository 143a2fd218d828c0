"""Errors shared by all frames: placement of the dots, the camera's position, a known load.

Placement errors are constant per target along the tangent and normal of the arm, because the dots
are painted on the arm and turn with it. The camera has its own position in every recording and
drifts slowly. A known load without a sensor, such as a weight, has the same error throughout its
recording; an independent error in each frame would hide the dependence of the stiffness on the
pressure. All of these errors are unknowns with a known prior. Together with the noise of pressure
and force, they make the residuals correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.measurement.inputs import Inputs
from pneunet_ros.measurement.painted_targets import paint, PaintedTargets
from pneunet_ros.model.uncertainty import SensorNoise
from pneunet_ros.solver.columns import LOADS
import scipy

PATH_NODES = 9  # nodes of the camera path in a recording, linear in between
# of drift_std: a random walk between its nodes on a straight line, per frame
BETWEEN_NODES = 1.0 / np.sqrt(6.0 * (PATH_NODES - 1))
RUN_UNKNOWNS = 2 * PATH_NODES + LOADS  # unknowns of one recording
FEWEST_OF_ROW = 3  # targets beyond the clamp: two cannot separate spacing from scale
SMALLEST_STD = 1e-7  # m, N and N m, in place of zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbances:
    """The nuisance parameters of runs: placement (2 x targets), then those of each run.

    prior covariance (n, n) in m, N and N m; the unknowns of a run are the nodes of its path in x,
    then in y, then the error of its known load. All runs share the offset of the base frame across
    the arm: a base frame found from the row of targets has the offset of that row from the neutral
    line. clamp_angle: rad.
    """

    arclength: Array
    runs: Sequence[RecordingData]
    noise: SensorNoise
    clamp_angle: float = 0.0
    prior: Array = field(init=False)

    def __post_init__(self) -> None:
        """Assemble the prior."""
        size = 2 * self.targets + RUN_UNKNOWNS * len(self.runs)
        prior = np.zeros((size, size))
        prior[: 2 * self.targets, : 2 * self.targets] = placement_prior(self.noise, self.arclength)
        for start, run in zip(range(2 * self.targets, size, RUN_UNKNOWNS), self.runs, strict=True):
            unknowns = slice(start, start + RUN_UNKNOWNS)
            prior[unknowns, unknowns] = self.prior_of_run(run)
        origin = np.zeros(size)
        offset = origin_std(self.noise, self.arclength) * np.array(
            [-np.sin(self.clamp_angle), np.cos(self.clamp_angle)]
        )
        for start in range(2 * self.targets, size, RUN_UNKNOWNS):
            origin[start : start + 2 * PATH_NODES] = np.repeat(offset, PATH_NODES)
        prior += np.outer(origin, origin)
        object.__setattr__(self, 'prior', frozen_array(prior))

    def origin(self, disturbance: Array) -> Array:
        """Return the origin of the base frame for these unknowns (n,): (2,) m.

        The origin is the displacement common to the images of all runs; fewer runs give a smaller
        estimate.
        """
        paths = disturbance[2 * self.targets :].reshape(len(self.runs), RUN_UNKNOWNS)
        mean_shift = (
            paths[:, : 2 * PATH_NODES].reshape(len(self.runs), 2, PATH_NODES).mean(axis=(0, 2))
        )
        normal = np.array([-np.sin(self.clamp_angle), np.cos(self.clamp_angle)])
        common = origin_std(self.noise, self.arclength) ** 2
        separate = max(self.noise.registration_std, SMALLEST_STD) ** 2 / len(self.runs)
        return np.asarray(common / (common + separate) * float(mean_shift @ normal) * normal)

    def prior_of_run(self, run: RecordingData) -> Array:
        """Return the prior covariance (RUN_UNKNOWNS, RUN_UNKNOWNS) of the unknowns of one run."""
        load, path = known_load_std(self.noise, run), path_prior(self.noise)
        return np.asarray(
            scipy.linalg.block_diag(path, path, np.diag(np.maximum(load, SMALLEST_STD) ** 2))
        )

    def root_of_run(self, which: int) -> Array:
        """Return the lower root (RUN_UNKNOWNS, RUN_UNKNOWNS) of the prior with the common origin.

        The origin is included because a missing effect biases it too.
        """
        unknowns = self.of_run(which)[2 * self.targets :]
        return np.asarray(np.linalg.cholesky(self.prior[np.ix_(unknowns, unknowns)]))

    @property
    def targets(self) -> int:
        """Number of targets."""
        return self.arclength.size

    def of_run(self, which: int) -> Array:
        """Return the indices of the unknowns of a run, (n,) int."""
        start = 2 * self.targets + RUN_UNKNOWNS * which
        unknowns = np.arange(start, start + RUN_UNKNOWNS)
        return np.concatenate([np.arange(2 * self.targets), unknowns])


def placement_prior(noise: SensorNoise, arclength: Array) -> Array:
    """Return the prior covariance (2 targets, 2 targets) m^2 of the painted positions.

    arclength (targets,) m. The positions along the arm come first, then those across it. The
    errors are an independent one for each target, an offset of the whole row from the neutral
    line, and an error of its spacing.
    """
    placement_std, row = max(noise.placement_std, SMALLEST_STD), row_shifts(arclength)
    sizes = np.array([noise.row_spacing_std, noise.row_offset_std])
    return np.asarray(placement_std**2 * np.eye(2 * arclength.size) + (row * sizes**2) @ row.T)


def row_shifts(arclength: Array) -> Array:
    """Return the displacements (2 targets, 2) m of targets along and across the arm.

    The columns are for a relative error of the spacing, and for an offset of the row from the
    neutral line relative to the arclength of the last target. arclength (targets,) m. Fewer than
    three targets beyond the clamp are not a row: each was placed independently.
    """
    targets = arclength.size
    shifts = np.zeros((2 * targets, 2))
    if np.count_nonzero(arclength) >= FEWEST_OF_ROW:
        shifts[:targets, 0] = arclength
        shifts[targets:, 1] = arclength[-1]
    return shifts


def origin_std(noise: SensorNoise, arclength: Array) -> float:
    """Return one sigma (m) of the origin across the arm, if the row defines the origin."""
    _, shift = row_shifts(arclength).T
    return float(noise.row_offset_std * np.max(shift, initial=0.0))


def path_prior(noise: SensorNoise) -> Array:
    """Return the covariance (PATH_NODES, PATH_NODES) m^2 of the camera's path, in x and in y.

    The path is a constant position plus a random walk that reaches drift_std at the end.
    """
    fraction = np.linspace(0.0, 1.0, PATH_NODES)
    position_std = max(noise.registration_std, SMALLEST_STD)
    drift_std = max(noise.drift_std, SMALLEST_STD)
    path = position_std**2 + drift_std**2 * np.minimum.outer(fraction, fraction)
    return np.asarray(path + SMALLEST_STD**2 * np.eye(PATH_NODES))


def known_load_std(noise: SensorNoise, run: RecordingData) -> Array:
    """Return one sigma of F1, F2 (N) and M (N m) of a known load, (3,); zero without one.

    It is the sigma of the sensor; a load of exactly zero has no error.
    """
    if not (run.load_known and run.load.any()):
        return np.zeros(LOADS)
    return np.array([noise.force_std] * 2 + [noise.moment_std if run.moment.any() else 0.0])


def inputs_with_load_error(run: RecordingData, inputs: Inputs, disturbance: Array) -> Inputs:
    """Return the inputs with the error of a known load; disturbance: unknowns as in `of_run`."""
    return inputs.with_loads(inputs.loads + disturbance[-LOADS:]) if run.load_known else inputs


def painted_points(theta: Array, curvature: Array, disturbance: Array) -> PaintedTargets:
    """Return the targets of a run at their painted positions; disturbance: as in `of_run`.

    theta (rad), curvature (1/m), both (frames, targets) of the arm at the targets.
    """
    targets = theta.shape[1]
    return paint(theta, curvature, disturbance[: 2 * targets].reshape(2, targets))


def camera_path(run: RecordingData, disturbance: Array) -> Array:
    """Return the image shift by the camera in every frame, (frames, 2, 1) m."""
    path = disturbance[-RUN_UNKNOWNS:-LOADS].reshape(2, PATH_NODES)
    return np.asarray((path_weights(run.progress) @ path.T)[:, :, None])


def disturbance_jacobian(run: RecordingData, targets: PaintedTargets) -> Array:
    """Return the derivatives of the image by the unknowns of `of_run`, (frames, 2, targets, n).

    The derivatives by a load are zero, because a load moves the arm, not the image.
    """
    placement = targets.jacobian()
    start = placement.shape[-1]
    jacobian = np.zeros((*placement.shape[:-1], start + RUN_UNKNOWNS))
    jacobian[..., :start] = placement
    hats, middle = path_weights(run.progress), start + PATH_NODES
    jacobian[:, 0, :, start:middle] = hats[:, None]
    jacobian[:, 1, :, middle : middle + PATH_NODES] = hats[:, None]
    return jacobian


def path_weights(progress: Array) -> Array:
    """Return the weight of each node of the camera's path in each frame, (frames, PATH_NODES)."""
    at = (PATH_NODES - 1) * progress
    weights: Array = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(PATH_NODES)))
    return weights


def tilt_jacobian(points: Array, length: float) -> Array:
    """Return derivatives of points (frames, 2, targets) m by the tilt, (.., 2 targets, 2).

    To first order, the scale of a tilted plane changes in proportion to x and y; here, the scale
    is exact at the middle of the straight arm. The tilt is the change of scale over the length,
    along x and along y.
    """
    frames, _, targets = points.shape
    scale_changes = points / length - np.array([[0.5], [0.0]])
    displacements = [points * scale_changes[:, [axis]] for axis in (0, 1)]
    return np.stack(displacements, axis=-1).reshape(frames, 2 * targets, 2)

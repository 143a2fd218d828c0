"""What moves measured targets beside the arm itself: placement of the dots, the camera's place.

Placement is constant per target in the arm's own tangent and normal: dots are painted on and turn
with it. The camera has a place of its own in every recording and drifts slowly in it. Both are
unknowns with a known prior; together with the noise of pressure and force they are what keeps
residuals from being white (METHODS: white noise of the right total size is wrong).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from pneunet_ros.core.arrays import Array, frozen_array
from pneunet_ros.measurement.dataset import RecordingData
from pneunet_ros.model.uncertainty import SensorNoise

PATH_NODES = 9  # of the camera's path in one recording, straight lines between
# of drift_std: a random walk between its nodes on a straight line, per frame
BETWEEN_NODES = 1.0 / np.sqrt(6.0 * (PATH_NODES - 1))
SMALLEST_STD = 1e-7  # m, stands for zero


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbances:
    """The unknown disturbances of runs: first placement (2 x targets), then a path per run.

    std (n,) and prior covariance (n, n) in m; the path of run k are its nodes in x, then in y.
    """

    targets: int
    runs: int
    noise: SensorNoise
    prior: Array = field(init=False)

    def __post_init__(self) -> None:
        """Put the prior together."""
        size = 2 * self.targets + 2 * PATH_NODES * self.runs
        prior = np.zeros((size, size))
        placement = max(self.noise.placement_std, SMALLEST_STD)
        prior[: 2 * self.targets, : 2 * self.targets] = placement**2 * np.eye(2 * self.targets)
        # A place that is constant, and a random walk that reaches drift_std at the end.
        share = np.linspace(0.0, 1.0, PATH_NODES)
        place = max(self.noise.registration_std, SMALLEST_STD)
        drift = max(self.noise.drift_std, SMALLEST_STD)
        path = place**2 + drift**2 * np.minimum.outer(share, share)
        path += SMALLEST_STD**2 * np.eye(PATH_NODES)
        for start in range(2 * self.targets, size, PATH_NODES):
            stop = start + PATH_NODES
            prior[start:stop, start:stop] = path
        object.__setattr__(self, 'prior', frozen_array(prior))

    def of_run(self, which: int) -> Array:
        """Return the places of the unknowns that a run has a part in, (n,) int."""
        start = 2 * (self.targets + PATH_NODES * which)
        own = np.arange(start, start + 2 * PATH_NODES)
        return np.concatenate([np.arange(2 * self.targets), own])


def disturbance_jacobian(run: RecordingData, theta: Array) -> Array:
    """Return how measured targets move per unknown of `of_run`, (frames, 2, targets, n).

    theta (frames, targets) rad at the targets.
    """
    frames, targets = theta.shape
    start = 2 * targets
    out = np.zeros((frames, 2, targets, start + 2 * PATH_NODES))
    out[..., :start] = placement_jacobian(theta)
    hats = path_weights(run)
    out[:, 0, :, start : start + PATH_NODES] = hats[:, None]
    out[:, 1, :, start + PATH_NODES :] = hats[:, None]
    return out


def placement_jacobian(theta: Array) -> Array:
    """Return how measured targets move per painted place, along and across the arm.

    theta (.., targets) rad at the targets; returned (.., 2, targets, 2 targets): x and y, first of
    all places along.
    """
    targets = theta.shape[-1]
    out = np.zeros((*theta.shape[:-1], 2, targets, 2 * targets))
    cosine, sine = np.cos(theta), np.sin(theta)
    which = np.arange(targets)
    out[..., 0, which, which], out[..., 1, which, which] = cosine, sine
    out[..., 0, which, targets + which], out[..., 1, which, targets + which] = -sine, cosine
    return out


def path_weights(run: RecordingData) -> Array:
    """Weight of each node of the camera's path at the frames of a run, (frames, PATH_NODES)."""
    at = (PATH_NODES - 1) * run.progress
    weights: Array = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(PATH_NODES)))
    return weights


def tilt_jacobian(points: Array, length: float) -> Array:
    """Return how points (frames, 2, targets) m move per tilt of the picture, (.., 2 targets, 2).

    To first order a plane that is not parallel to the camera's is seen with a scale that changes
    in proportion to x and to y, here about the middle of the straight arm, where it stays. The
    tilt is the change of scale over the length, along x and along y.
    """
    frames, _, targets = points.shape
    ways = points / length - np.array([[0.5], [0.0]])
    moved = [points * ways[:, [axis]] for axis in (0, 1)]
    return np.stack(moved, axis=-1).reshape(frames, 2 * targets, 2)
